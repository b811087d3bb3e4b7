"""Which method to use for what a user can spend: the methods that meet a request, and the cheapest of them.

A request is met by a method if a new scene reaches the target within the limits with at least the wanted probability,
at every swept point. A method "meets" it if an exact test rejects the opposite, corrected for all methods by Holm's
procedure; the largest p-value of the swept points counts, which needs no correction. Among the methods that meet it,
the cheapest set holds those that none beats in cost. Reliability is tested with four fifths of the error probability
1 - confidence and cost with one fifth, so that all statements hold together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray
from scipy.special import bdtrc

from .best_set import best_set, pair_scores, scenes_needed
from .choice_costs import Cell, Points, Request, Setting, settings_of, within
from .intervals import bounded_mean_interval, mean_pvalue, quantile_interval, share_interval
from .sign_flips import holm, log_ratios, signed_ranks

__all__ = [
    "COLUMNS",
    "EVERYWHERE",
    "LIKELY",
    "MEETS",
    "MISSES",
    "Verdict",
    "judge",
    "place_text",
    "price_changes",
    "share_pvalue",
]

MEETS, LIKELY, MISSES = "meets", "meets in this study", "does not"
RELIABILITY_PART = 0.8  # of the error probability; the rest is for the comparison of costs
COST_TIE = 1.1  # costs whose ratio is smaller count as equal
EVERYWHERE = "every swept point"
MOST = 60  # settings whose costs are compared
MANY = 1_000_000  # scenes beyond which no number is stated
PRICES_S = np.geomspace(1e-7, 1.0, 57)  # of one evaluation, between which rankings are compared
COLUMNS = (
    *("setting", "method", "starts", "verdict", "share", "share_low", "share_high", "worst", "p", "more_scenes"),
    *("budget", "budget_low", "budget_high", "cheapest"),
)


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a study says about one request and one target.

    frame: one row per setting, the recommended one first, then by verdict, share and budget, with the columns:
    ``setting``, ``method``, ``starts``; ``verdict``, "meets", "meets in this study" (but too few scenes to be sure) or
    "does not"; ``share`` of scenes that reach the target within the limits, at the worst swept point, its interval
    ``share_low`` to ``share_high``, and that point, ``worst``, "every swept point" if all have the same share; ``p``,
    the adjusted p-value; ``more_scenes``, about how
    many more scenes would be needed to be sure if the share stays the same, NaN if none would do; ``budget``, what
    the wanted share of scenes needs at most to reach the target, at the dearest swept point, with its interval
    ``budget_low`` to ``budget_high``, ∞ or NaN where it is not known; ``cheapest``, whether it is in the cheapest set.
    scenes: number of scenes at a swept point. tested: number of settings.
    """

    request: Request
    frame: pd.DataFrame
    scenes: int
    tested: int
    ranked: bool

    @property
    def first(self) -> dict[str, Any] | None:
        """The recommended row; None if no setting meets the request."""
        if self.frame.empty or self.frame["verdict"].iloc[0] == MISSES:
            return None
        return {str(name): value for name, value in self.frame.iloc[0].items()}


def share_pvalue(values: Float[ndarray, " n"], limit: float) -> float:
    """Return the one-sided p-value for a mean above ``limit`` of one value in [0, 1] per scene, (n,).

    Exact for hits and misses; for shares of several runs, that of a bounded mean.
    """
    if ((values == 0) | (values == 1)).all():
        hits = int(values.sum())
        return float(bdtrc(hits - 1, len(values), limit)) if hits else 1.0
    return mean_pvalue(values, limit)


def judge(points: Points, request: Request) -> Verdict:
    """Return which settings meet the request. points: as ``cells_of`` returns them, all of which must be met."""
    settings = settings_of(points) if points else []
    found = [_measured(points, setting, request) for setting in settings]
    alpha = 1.0 - request.confidence
    adjusted = holm(np.array([row["p"] for row in found]))
    for row, p in zip(found, adjusted, strict=True):
        row["p"] = float(p)
        sure = p <= RELIABILITY_PART * alpha
        row["verdict"] = MEETS if sure else LIKELY if row["share"] >= request.reliability else MISSES
        lacking = 0.0 if sure else _more_scenes(row, request.reliability, RELIABILITY_PART * alpha / len(found))
        row["more_scenes"] = lacking
    kept = _useful(found)
    frame = pd.DataFrame(kept, columns=[*COLUMNS, "scenes"])
    frame, ranked = _with_cheapest(points, frame, request, (1.0 - RELIABILITY_PART) * alpha)
    scenes = int(frame["scenes"].min()) if len(frame) else 0
    return Verdict(request, frame.drop(columns="scenes"), scenes, len(found), ranked)


def _useful(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Leave out several starts of a method that reach no more scenes than fewer starts."""
    best: dict[str, float] = {}
    kept = []
    for row in rows:
        if row["starts"] == 1 or row["share"] > best[row["method"]]:
            best[row["method"]] = row["share"]
            kept.append(row)
    return kept


def _measured(points: Points, setting: Setting, request: Request) -> dict[str, Any]:
    """The shares and budgets of a setting over all points."""
    worst: dict[str, Any] = {"share": math.inf}
    p, budget = 0.0, (-math.inf, math.nan, math.nan)
    scenes, largest = math.inf, -math.inf
    for swept, cells in points:
        hits, costs = within(cells[setting.method], setting.starts, request)
        each = hits.mean(axis=1)
        scenes = min(scenes, len(each))
        p = max(p, share_pvalue(each, request.reliability))
        if each.mean() < worst["share"]:
            low, high = _share_interval(each, request.confidence)
            worst = {"share": float(each.mean()), "share_low": low, "share_high": high, "worst": place_text(swept)}
        largest = max(largest, float(each.mean()))
        needed = budget_of(costs, request.reliability)
        if needed > budget[0] or math.isnan(budget[0]):
            budget = (needed, *_budget_interval(costs, request))
    if len(points) > 1 and largest == worst["share"]:
        worst["worst"] = EVERYWHERE
    names = {"setting": setting.label, "method": setting.method, "starts": setting.starts}
    return {
        **names, **worst, "p": p, "scenes": scenes, "cheapest": False,
        **dict(zip(("budget", "budget_low", "budget_high"), budget, strict=True)),
    }  # fmt: skip


def place_text(swept: dict[str, Any]) -> str:
    """Return the swept values in words."""
    texts = (f"{value:g}" if isinstance(value, float) else str(value) for value in swept.values())
    return ", ".join(f"{name.removeprefix('scenario.')} = {text}" for name, text in zip(swept, texts, strict=True))


def _budget_interval(costs: Float[ndarray, "n c"], request: Request) -> tuple[float, float]:
    """The interval of the budget, between order statistics; not known for several runs per scene."""
    if costs.shape[1] > 1:
        return math.nan, math.nan
    return quantile_interval(costs[:, 0], request.reliability, request.confidence)


def budget_of(costs: Float[ndarray, "n c"], share: float) -> float:
    """Return the smallest cost by which this share of runs has reached the target; ∞ if there is none."""
    ordered = np.sort(costs, axis=None)
    return float(ordered[max(math.ceil(share * len(ordered) - 1e-9) - 1, 0)])


def _share_interval(each: Float[ndarray, " n"], level: float) -> tuple[float, float]:
    if ((each == 0) | (each == 1)).all():
        return share_interval(int(each.sum()), len(each), level)
    return bounded_mean_interval(each, 0.0, 1.0, level)


def _more_scenes(row: dict[str, Any], reliability: float, alpha: float) -> float:
    """About how many more scenes a test at the level alpha needs if the share of hits stays the same."""
    share, scenes = row["share"], int(row["scenes"])

    def enough(n: int) -> bool:
        hits = math.floor(share * n + 1e-9)
        return bool(hits and bdtrc(hits - 1, n, reliability) <= alpha)

    if share <= reliability:
        return math.nan
    high = max(scenes, 1)
    while not enough(high):
        high *= 2
        if high > MANY:
            return math.nan
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return float(max(high - scenes, 1))


def _with_cheapest(points: Points, frame: pd.DataFrame, request: Request, alpha: float) -> tuple[pd.DataFrame, bool]:
    """Mark the cheapest set, and sort the rows; also whether there were enough scenes to compare costs."""
    order = {MEETS: 0, LIKELY: 1, MISSES: 2}
    rank = frame["verdict"].map(order)
    sure = bool((rank == 0).any())
    # where no method surely meets the request, the most reliable ones are recommended, not the cheapest
    by_share = np.where(rank == 0, 0.0, -frame["share"].astype(float))
    frame = frame.assign(rank=rank, by=by_share).sort_values(["rank", "by", "budget", "share"], kind="stable")
    frame = frame.drop(columns=["rank", "by"]).reset_index(drop=True)
    top = frame["verdict"] == (MEETS if sure else LIKELY)
    top &= frame["share"] == frame["share"].where(top).max() if not sure else True
    rows = np.flatnonzero(top)[:MOST]
    if len(rows) < 2:
        frame.loc[rows, "cheapest"] = True
        return frame, True
    settings = [Setting(str(frame["method"][i]), int(frame["starts"][i])) for i in rows]
    scores = sum(_cost_scores(cells, settings, request) for _, cells in points)
    inside = best_set(np.asarray(scores), alpha).inside
    frame.loc[rows[inside], "cheapest"] = True
    frame = frame.sort_values("cheapest", ascending=False, kind="stable").reset_index(drop=True)
    return frame, np.asarray(scores).shape[2] >= scenes_needed(len(rows), alpha)


def _cost_scores(cells: dict[str, Cell], settings: Sequence[Setting], request: Request) -> ndarray:
    """Signed ranks of the logarithms of the ratios of costs, on the scenes that all settings have."""
    common = set.intersection(*(set(cells[setting.method].scenes.tolist()) for setting in settings))
    costs = []
    for setting in settings:
        cell = cells[setting.method]
        own = np.isin(cell.scenes, list(common))
        costs.append(np.median(within(cell, setting.starts, request)[1][own], axis=1))
    table = np.array(costs)
    i, j = np.triu_indices(len(settings), 1)
    return pair_scores(signed_ranks(log_ratios(table[i], table[j], factor=COST_TIE)), len(settings))


def price_changes(points: Points, request: Request) -> pd.DataFrame:
    """Return which setting needs the least time, as a function of what one evaluation costs.

    One row per range of prices: ``from_us``, ``to_us`` [µs], ``setting``, and ``budget_s`` at the geometric middle of
    the range. Only settings that reach the wanted share of scenes within the evaluations of the request are compared;
    its limit on time is left out. Empty if there are none.
    """
    free = Request(request.evaluations, None, 0.0, request.reliability, request.parallel, request.confidence)
    parts = {}
    for setting in settings_of(points) if points else []:
        found = [_line(cells[setting.method], setting.starts, free) for _, cells in points]
        if all(hits >= request.reliability for hits, _, _ in found):
            parts[setting.label] = found
    labels = list(parts)

    def needed(label: str, price: float) -> float:
        return max(budget_of(base + price * slope, request.reliability) for _, base, slope in parts[label])

    def cheapest(price: float) -> int:
        return int(np.argmin([needed(label, price) for label in labels]))

    if not labels:
        return pd.DataFrame(columns=["from_us", "to_us", "setting", "budget_s"])
    winners = [cheapest(price) for price in PRICES_S]
    edges = [(PRICES_S[0], winners[0])]
    for i in range(1, len(PRICES_S)):
        low, high = PRICES_S[i - 1], PRICES_S[i]
        if winners[i] == winners[i - 1]:
            continue
        for _ in range(12):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if cheapest(middle) == winners[i - 1] else (low, middle)
        edges.append((high, winners[i]))
    ends = [*(price for price, _ in edges[1:]), PRICES_S[-1]]
    rows = []
    for (start, winner), end in zip(edges, ends, strict=True):
        middle = math.sqrt(start * end)
        rows.append((1e6 * start, 1e6 * end, labels[winner], needed(labels[winner], middle)))
    return pd.DataFrame(rows, columns=["from_us", "to_us", "setting", "budget_s"])


def _line(cell: Cell, starts: int, request: Request) -> tuple[float, ndarray, ndarray]:
    """The share of hits, and the time of each run or combination as base + price · slope; base is ∞ without a hit."""
    hits, base = within(cell, starts, request)
    one = Request(request.evaluations, None, 1.0, request.reliability, request.parallel, request.confidence)
    total = within(cell, starts, one)[1]
    with np.errstate(invalid="ignore"):
        slope = np.where(np.isfinite(base), total - base, 0.0)
    return float(hits.mean()), base, slope
