"""The ranking of methods in three stages: the share of scenes solved, then the error, then the cost.

Each stage keeps the methods that no other beats, with its own share of the 5 % for all comparisons shown together: all
swept points and, if there are several, the block over all of them. Stages that do not apply give their share to none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.stats import binom, rankdata

from .best_set import BestSet, one_sided_matrix, pair_scores, scenes_needed, sets_of, tables_of
from .intervals import bounded_mean_interval, ert, ratio_interval, share_interval
from .outcomes import Outcomes, Point, common
from .sign_flips import hit_scores, log_ratios, mean_over_points, signed_ranks

__all__ = ["ALL", "SHARES", "Block", "Ranking", "Stage", "rank", "typical_seconds"]

SHARES = {"reliability": 0.02, "error": 0.02, "cost": 0.01}  # of the 5 % for one verdict
COST_TIE = 1.1  # costs whose ratio is smaller count as equal
ERROR_TIE = 1.25  # errors whose ratio is smaller count as equal for the recommendation
DOUBT = 0.25  # a method is visibly less reliable if one-sided p of the discordant scenes is at most this
ALL = "all"  # the swept value of the block over all points

COLUMNS = (  # after the swept keys
    *("method", "runs", "solved_share", "solved_low", "solved_high", "error_ratio", "ratio_low", "ratio_high"),
    *("in_reliable_set", "in_best_set", "worse_than", "mean_rank"),
)
Covered = tuple[dict[str, Any], tuple[Outcomes, ...]]  # swept values, and the points of a block


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage at one point.

    best: the set of methods that none beats, among the candidates of the stage. worse: (k, k), whether method i is
    marked as worse than method j in the table of pairs. traded: (k, k), whether j would have excluded i by its error,
    but is visibly less reliable.
    """

    name: str
    best: BestSet
    worse: Bool[ndarray, "k k"]
    traded: Bool[ndarray, "k k"]


@dataclass(frozen=True, eq=False)
class Block:
    """The ranking at one swept point, or over all of them.

    swept: the swept values. points: the outcomes, one per point that the block covers, on the same methods and scenes.
    stages: empty if there are too few scenes. order: positions of the methods in the final set, the recommended
    first: by share solved, then by error, then by cost;
    empty if there are too few scenes. needed: the fewest scenes that could rank these methods. ert: expected running
    times, (k,).
    """

    swept: dict[str, Any]
    points: tuple[Outcomes, ...]
    stages: tuple[Stage, ...]
    order: tuple[int, ...]
    needed: int
    ert: Float[ndarray, " k"]

    @property
    def methods(self) -> tuple[str, ...]:
        """Labels of the methods, (k,)."""
        return self.points[0].methods

    @property
    def n(self) -> int:
        """Number of scenes."""
        return len(self.points[0].scenes)

    def stage(self, name: str) -> Stage | None:
        """Return the stage of this name; None if it was not carried out."""
        return next((stage for stage in self.stages if stage.name == name), None)


@dataclass(frozen=True, eq=False)
class Ranking:
    """The blocks of a study and their table, one row per block and method.

    The columns of ``frame`` are the swept keys, method, runs, solved_share, solved_low, solved_high, error_ratio,
    ratio_low, ratio_high, in_reliable_set, in_best_set, worse_than and mean_rank. error_ratio is the typical ratio of
    the error to that of the best set's first method. The columns about sets are missing values where there are too few
    scenes to rank. worse_than lists the methods that are significantly better in the share solved or in the error or,
    where the runs stopped at a target, in cost. stopped: whether the runs stopped at a target, so that cost was ranked
    and error was not.
    """

    frame: pd.DataFrame
    blocks: tuple[Block, ...]
    stopped: bool = False


def rank(points: Sequence[Point], overall: bool = True, *, stopped_at_target: bool = False) -> Ranking:
    """Rank the methods at each swept point and, if there are several points, over all of them.

    points: swept values and outcomes. overall: whether to add the block over all points. In it the scores of a scene
    are summed over the points, for the methods and scenes that all points have. stopped_at_target: whether the runs
    stopped at the first target. The error then says how far a run overshot, so that only reliability and cost count.
    """
    covered: list[Covered] = [(swept, (each,)) for swept, each in points]
    shared = common(points) if overall and len(points) > 1 else []
    if shared and shared[0][1].methods:
        covered.append((dict.fromkeys(points[0][0], ALL), tuple(each for _, each in shared)))
    blocks = _blocks(covered, stopped_at_target)
    rows = [row for block in blocks for row in _rows(block, len(blocks))]
    frame = pd.DataFrame(rows) if rows else pd.DataFrame(columns=list(COLUMNS))
    for name in ("in_reliable_set", "in_best_set"):
        if len(frame):
            frame[name] = frame[name].astype("boolean")
    return Ranking(frame, tuple(blocks), stopped_at_target)


def _blocks(covered: Sequence[Covered], stopped: bool) -> list[Block]:
    """Carry out the stages at all blocks that have enough scenes, together."""
    needed = [scenes_needed(len(part[0].methods), SHARES["error"], len(covered)) for _, part in covered]
    ranked = [i for i, (_, part) in enumerate(covered) if len(part[0].scenes) >= max(needed[i], 1)]
    stages = dict(zip(ranked, _stages([covered[i][1] for i in ranked], stopped), strict=True))
    blocks = []
    for i, (swept, part) in enumerate(covered):
        own, costs = stages.get(i, ()), _erts(part)
        order: tuple[int, ...] = ()
        if own:
            order = _recommended_first(part, own[-1].best.inside, costs, stopped)
        blocks.append(Block(swept, part, own, order, needed[i], costs))
    return blocks


def _recommended_first(
    part: Sequence[Outcomes], inside: Bool[ndarray, " k"], costs: Float[ndarray, " k"], stopped: bool
) -> tuple[int, ...]:
    """Return the members of the final set: by share solved, then by typical error, then by cost.

    The tests do not distinguish them, so this is an order of estimates. Errors within ERROR_TIE of the lowest one,
    among the methods with the highest share, count as equal. Seconds, then mean ranks decide between equal costs.
    """
    shares = np.array([share_solved(part, m) for m in range(len(costs))])
    error = typical_errors(part)
    lowest = np.min(error[inside & (shares == shares[inside].max())])
    error = np.where(stopped | (error <= ERROR_TIE * lowest), 0.0, error)
    seconds = np.array([typical_seconds(part, m) for m in range(len(costs))])
    none = np.any([_makes_none(each) for each in part], axis=0)
    cost = seconds if none[inside].any() else costs
    best = np.lexsort((_mean_ranks(part), seconds, cost, error, -shares))
    return tuple(int(m) for m in best if inside[m])


def share_solved(part: Sequence[Outcomes], i: int) -> float:
    """Return the mean over scenes and points of the share of a method's runs that hit the first target."""
    return round(float(np.mean([(each.hits[:, i] / each.runs[i]).mean() for each in part])), 12)


def typical_errors(part: Sequence[Outcomes]) -> Float[ndarray, " k"]:
    """Return the geometric mean over the points of the median errors over scenes; ∞ where most runs failed."""
    medians = [np.median(np.where(np.isnan(each.error), np.inf, each.error), axis=0) for each in part]
    with np.errstate(divide="ignore"):
        found: ndarray = np.exp(np.mean(np.log(medians), axis=0))
    return found


def _k(each: Outcomes) -> int:
    return len(each.methods)


def _erts(part: Sequence[Outcomes]) -> Float[ndarray, " k"]:
    """Return the expected running times over all scenes and points."""
    spent, hits = (np.concatenate([getattr(each, name) for each in part]) for name in ("spent", "hits"))
    return np.array([ert(spent[:, i], hits[:, i]) for i in range(_k(part[0]))])


def typical_seconds(part: Sequence[Outcomes], i: int) -> float:
    """Return the median over scenes and points of the seconds to the hit; ∞ if not known."""
    seconds = [each.columns["seconds"][:, i] for each in part if "seconds" in each.columns]
    return float(np.median(np.concatenate(seconds))) if seconds and sum(map(len, seconds)) else math.inf


def _stages(parts: Sequence[tuple[Outcomes, ...]], stopped: bool) -> list[tuple[Stage, ...]]:
    """Return the stages of each block. Only members of a stage's set are candidates of the next."""
    names = [name for name in SHARES if not (stopped and name == "error")]
    scores = {"reliability": _reliability, "error": _error, "cost": cost_scores}
    members = [np.ones(_k(part[0]), dtype=bool) for part in parts]
    marked = [np.zeros((_k(part[0]),) * 2, dtype=bool) for part in parts]
    reliability = [_summed(part, _reliability) for part in parts]
    doubtful = [_less_reliable(each) for each in reliability]
    found: list[list[Stage]] = [[] for _ in parts]
    for name in names:
        summed = reliability if name == "reliability" else [_summed(part, scores[name]) for part in parts]
        tests = [one_sided_matrix(each) for each in summed]
        free = [np.ones_like(each) for each in marked]
        guards = free if name == "reliability" else [_wins(each) for each in summed]
        guarded = free if name == "reliability" else [g & ~bad for g, bad in zip(guards, doubtful, strict=True)]
        sets = sets_of(tests, SHARES[name], members, guarded)
        unguarded = sets_of(tests, SHARES[name], members, guards)
        for i, table in enumerate(tables_of(tests, SHARES[name])):
            worse = table.worse & guarded[i] & ~marked[i].T  # a mark of an earlier stage is not reversed
            traded = unguarded[i].beaten_by & doubtful[i] & sets[i].inside[:, None]
            found[i].append(Stage(name, sets[i], worse, traded))
            marked[i] = marked[i] | worse
        members = [each.inside for each in sets]
    return [tuple(each) for each in found]


def _summed(part: Sequence[Outcomes], scores: Any) -> Int[ndarray, "k k n"]:
    """Return the scores of all pairs, summed over the points within each scene."""
    i, j = np.triu_indices(_k(part[0]), 1)
    return pair_scores(np.sum([scores(each, i, j) for each in part], axis=0), _k(part[0]))


def _reliability(each: Outcomes, i: Int[ndarray, " m"], j: Int[ndarray, " m"]) -> Int[ndarray, "m n"]:
    h, runs = each.hits.T, each.runs[:, None]
    return hit_scores(h[j], runs[j], h[i], runs[i])


def _error(each: Outcomes, i: Int[ndarray, " m"], j: Int[ndarray, " m"]) -> Int[ndarray, "m n"]:
    return signed_ranks(log_ratios(each.error.T[i], each.error.T[j]))


def cost_scores(each: Outcomes, i: Int[ndarray, " m"], j: Int[ndarray, " m"]) -> Int[ndarray, "m n"]:
    """Return the scores of the costs of methods i against j, (m,) each, both censored at the smaller of their caps."""
    """Scores of the evaluations to the hit; of seconds for pairs in which a method makes no evaluations."""
    cap = np.minimum(each.cap[i], each.cap[j])[:, None]
    a, b = each.cost.T[i], each.cost.T[j]
    a, b = np.where(a > cap, np.inf, a), np.where(b > cap, np.inf, b)
    timed = (_makes_none(each)[i] | _makes_none(each)[j])[:, None]
    if "seconds" in each.columns:
        seconds = each.columns["seconds"].T
        a, b = np.where(timed, seconds[i], a), np.where(timed, seconds[j], b)
    return signed_ranks(log_ratios(a, b, factor=COST_TIE))


def _makes_none(each: Outcomes) -> Bool[ndarray, " k"]:
    """Return which methods make no evaluations, as those without a solver."""
    return np.asarray((each.spent == 0).all(axis=0))


def _wins(scores: Int[ndarray, "k k n"]) -> Bool[ndarray, "k k"]:
    """Return whether method j wins at least as many scenes against i as it loses, in row i."""
    return (scores > 0).sum(axis=2) >= (scores < 0).sum(axis=2)


def _less_reliable(scores: Int[ndarray, "k k n"]) -> Bool[ndarray, "k k"]:
    """Return whether method j is visibly less reliable than i, in row i; scores as of the first stage."""
    only_i, only_j = (scores < 0).sum(axis=2), (scores > 0).sum(axis=2)
    p = binom.sf(only_i - 1, only_i + only_j, 0.5)
    return (only_i > only_j) & (p <= DOUBT)


def _mean_ranks(part: Sequence[Outcomes]) -> Float[ndarray, " k"]:
    """Return the mean over scenes and points of the ranks of the errors within a scene; NaN without scenes."""
    ranks = [rankdata(each.error, axis=1) for each in part if len(each.scenes)]
    return np.mean(np.concatenate(ranks), axis=0) if ranks else np.full(_k(part[0]), math.nan)


def _rows(block: Block, blocks: int) -> list[dict[str, Any]]:
    """Return the rows of one block; the ratios' intervals share their 5 % with all others shown."""
    k, n, first = len(block.methods), block.n, (block.order or (0,))[0]
    mean = _mean_ranks(block.points)
    level = 1 - 0.05 / max((k - 1) * blocks, 1)
    reliable = block.stage("reliability")
    rows = []
    for i, method in enumerate(block.methods):
        share, low, high = _share(block.points, i)
        ratio = (math.nan,) * 3
        if block.order and i != first:
            ratio = ratio_interval(_mean_logs(block.points, i, first), level)
        elif block.order:
            ratio = 1.0, math.nan, math.nan
        compared = [stage for stage in block.stages if stage.name != "cost" or block.stage("error") is None]
        worse = [j for j in range(k) if any(stage.worse[i, j] for stage in compared)]
        rows.append(
            {
                **block.swept,
                "method": method,
                "runs": int(sum(each.runs[i] for each in block.points)) * n,
                **dict(zip(("solved_share", "solved_low", "solved_high"), (share, low, high), strict=True)),
                **dict(zip(("error_ratio", "ratio_low", "ratio_high"), ratio, strict=True)),
                "in_reliable_set": bool(reliable.best.inside[i]) if reliable else None,
                "in_best_set": i in block.order if block.stages else None,
                "worse_than": "; ".join(block.methods[j] for j in worse),
                "mean_rank": float(mean[i]),
            }
        )
    return rows


def _share(points: Sequence[Outcomes], i: int) -> tuple[float, float, float]:
    """Return the share of runs of method i that hit the first target, and its interval over scenes."""
    n = len(points[0].scenes)
    if n == 0:
        return math.nan, math.nan, math.nan
    if len(points) == 1 and points[0].runs[i] == 1:
        hits = int(points[0].hits[:, i].sum())
        return hits / n, *share_interval(hits, n)
    shares = np.mean([each.hits[:, i] / each.runs[i] for each in points], axis=0)
    return float(shares.mean()), *bounded_mean_interval(shares)


def _mean_logs(points: Sequence[Outcomes], i: int, j: int) -> Float[ndarray, " n"]:
    """Return ln of the ratio of the errors of i and j, averaged over the points."""
    return mean_over_points(np.array([log_ratios(each.error[:, i], each.error[:, j], ties=False) for each in points]))
