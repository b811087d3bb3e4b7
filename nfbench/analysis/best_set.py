"""Comparisons of k methods: the table of all pairs, the set of methods that none beats, and the scenes they need.

Scores are arrays (k, k, n) of integers, antisymmetric: ``scores[i, j, s]`` is positive where method i is worse than
method j in scene s. Verdicts on several swept points that are shown together are corrected together: the functions with
a plural name take one array per point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri

from .sign_flips import holm, sign_flip_pvalues

__all__ = [
    "BestSet",
    "PairTable",
    "best_set",
    "best_sets",
    "one_sided_matrix",
    "pair_scores",
    "pair_table",
    "pair_tables",
    "scenes_for_power",
    "scenes_needed",
]

Scores = Int[ndarray, "k k n"]


@dataclass(frozen=True)
class PairTable:
    """The comparisons of all pairs at one point.

    p, holm: raw and Holm-adjusted two-sided p-values, (k, k), symmetric, 1 on the diagonal. worse: (k, k), whether
    method i is significantly worse than method j.
    """

    p: Float[ndarray, "k k"]
    holm: Float[ndarray, "k k"]
    worse: Bool[ndarray, "k k"]


@dataclass(frozen=True)
class BestSet:
    """The methods that no method beats at one point.

    inside: (k,), whether a method is in the set. p: (k,), adjusted p-values of "no method is better"; NaN for methods
    that were not candidates. beaten_by: (k, k), whether method j excludes method i, in row i. circular: whether every
    candidate was beaten, so that the set is the candidates at the top of the circular order.
    """

    inside: Bool[ndarray, " k"]
    p: Float[ndarray, " k"]
    beaten_by: Bool[ndarray, "k k"]
    circular: bool


def pair_scores(upper: Int[ndarray, "m n"], k: int) -> Scores:
    """Return the antisymmetric array (k, k, n) of scores from those of the pairs i < j, (m, n), in row-major order."""
    i, j = np.triu_indices(k, 1)
    scores = np.zeros((k, k, upper.shape[1]), dtype=np.int64)
    scores[i, j], scores[j, i] = upper, -upper
    return scores


def one_sided_matrix(scores: Scores) -> tuple[Float[ndarray, "k k"], Float[ndarray, "k k"]]:
    """Return (p, worse): two-sided p-values of all pairs, and one-sided ones of "j is better than i", both (k, k).

    The latter are p/2 where the sum of the scores favours j, and 1 elsewhere. Raises ValueError for scores that are
    not an antisymmetric array of integers.
    """
    scores = np.asarray(scores)
    if scores.ndim != 3 or scores.shape[0] != scores.shape[1] or (scores != -scores.transpose(1, 0, 2)).any():
        raise ValueError(f"scores: expected an antisymmetric array (k, k, n), got the shape {scores.shape}")
    k = len(scores)
    i, j = np.triu_indices(k, 1)
    p = np.ones((k, k))
    if len(i):
        p[i, j] = p[j, i] = sign_flip_pvalues(scores[i, j])
    return p, np.where(scores.sum(axis=2) > 0, p / 2, 1.0)


def pair_table(scores: Scores, alpha: float = 0.05) -> PairTable:
    """Compare all pairs of methods at one point, with Holm's correction over the pairs."""
    return pair_tables([scores], alpha)[0]


def pair_tables(scores: Sequence[Scores], alpha: float = 0.05) -> list[PairTable]:
    """Compare all pairs of methods at several points shown together, with Holm's correction over pairs × points."""
    return tables_of([one_sided_matrix(each) for each in scores], alpha)


def tables_of(tests: Sequence[tuple[Float[ndarray, "k k"], Float[ndarray, "k k"]]], alpha: float) -> list[PairTable]:
    """Return the tables of pairs from the results of :func:`one_sided_matrix` at each point."""
    if not tests:
        return []
    uppers = [np.triu_indices(len(p), 1) for p, _ in tests]
    adjusted = holm(np.concatenate([p[upper] for (p, _), upper in zip(tests, uppers, strict=True)]))
    parts = np.split(adjusted, np.cumsum([len(upper[0]) for upper in uppers])[:-1])
    tables = []
    for (p, worse), (i, j), part in zip(tests, uppers, parts, strict=True):
        full = np.ones_like(p)
        full[i, j] = full[j, i] = part
        tables.append(PairTable(p, full, (full <= alpha) & (worse < 1)))
    return tables


def best_set(
    scores: Scores, alpha: float = 0.05, points: int = 1, guard: Bool[ndarray, "k k"] | None = None
) -> BestSet:
    """Return the methods that none beats at one point; each of them stays with probability 1 − alpha at least.

    points: number of points whose sets are shown together; the correction is then Bonferroni's over the points, and
    :func:`best_sets` is sharper. guard: (k, k), whether method j may exclude method i, in row i; None for all.
    """
    return best_sets([scores], alpha / points, guards=None if guard is None else [guard])[0]


def best_sets(
    scores: Sequence[Scores],
    alpha: float = 0.05,
    *,
    members: Sequence[Bool[ndarray, " k"]] | None = None,
    guards: Sequence[Bool[ndarray, "k k"]] | None = None,
) -> list[BestSet]:
    """Return the methods that none beats, at each of several points shown together.

    members: the candidates at each point, (k,); only they exclude and are excluded. None for all methods. guards: see
    :func:`best_set`.

    Method i leaves the set if Holm's adjustment, over all candidates of all points, of (k − 1)·min_j p_ij is at most
    alpha. p_ij is the one-sided p-value of "j is better than i". If all candidates are excluded at a point, their order
    is circular, and the set consists of the source components of the graph of who beats whom.
    """
    return sets_of([one_sided_matrix(each) for each in scores], alpha, members, guards)


def sets_of(
    tests: Sequence[tuple[Float[ndarray, "k k"], Float[ndarray, "k k"]]],
    alpha: float,
    members: Sequence[Bool[ndarray, " k"]] | None = None,
    guards: Sequence[Bool[ndarray, "k k"]] | None = None,
) -> list[BestSet]:
    """Return the best sets from the results of :func:`one_sided_matrix` at each point."""
    candidates = list(members) if members is not None else [np.ones(len(p), dtype=bool) for p, _ in tests]
    allowed = [
        np.where(np.outer(inside, inside), worse, 1.0) for (_, worse), inside in zip(tests, candidates, strict=True)
    ]
    if guards is not None:
        allowed = [np.where(guard, worse, 1.0) for worse, guard in zip(allowed, guards, strict=True)]
    raw = [np.minimum(1.0, max(len(worse) - 1, 0) * worse.min(axis=1, initial=1.0)) for worse in allowed]
    flat = np.concatenate([each[inside] for each, inside in zip(raw, candidates, strict=True)] or [np.empty(0)])
    adjusted, factor = holm(flat), _factors(flat)
    found, start = [], 0
    for worse, inside in zip(allowed, candidates, strict=True):
        k, count = len(worse), int(inside.sum())
        p, m = np.full(k, math.nan), np.ones(k)
        p[inside], m[inside] = adjusted[start : start + count], factor[start : start + count]
        start += count
        out = inside & (np.nan_to_num(p, nan=1.0) <= alpha)
        beaten = out[:, None] & (worse * (m * max(k - 1, 1))[:, None] <= alpha)
        circular = count > 0 and bool(out[inside].all())
        left = _sources(beaten, inside) if circular else inside & ~out
        found.append(BestSet(left, p, beaten, circular))
    return found


def _factors(p: Float[ndarray, " m"]) -> Float[ndarray, " m"]:
    """Return the factor of each p-value in Holm's procedure: m for the smallest, 1 for the largest."""
    factor = np.empty(len(p))
    factor[np.argsort(p, kind="stable")] = np.arange(len(p), 0, -1)
    return factor


def _sources(beaten: Bool[ndarray, "k k"], inside: Bool[ndarray, " k"]) -> Bool[ndarray, " k"]:
    """Return the candidates in strong components of the graph that no other component beats."""
    _, component = connected_components(beaten, directed=True, connection="strong")
    other = component[:, None] != component[None]
    lost = {int(c) for c, row in zip(component, beaten & other, strict=True) if row.any()}
    return inside & np.array([int(c) not in lost for c in component])


def scenes_needed(k: int, alpha: float = 0.05, points: int = 1) -> int:
    """Return the smallest number of scenes, all with a difference, that can rank k methods at this many points."""
    pairs = points * k * (k - 1) // 2
    return 1 + math.ceil(math.log2(pairs / alpha)) if pairs else 0


def scenes_for_power(
    k: int, ratio: float, spread: float, alpha: float = 0.05, *, power: float = 0.8, points: int = 1
) -> int:
    """Return about how many scenes detect a ratio of errors in a table of k methods with this power.

    ratio: typical ratio of the errors of two methods, positive and not 1. spread: standard deviation over scenes of the
    logarithm of the ratio. The normal approximation of the signed-rank test; not below :func:`scenes_needed`.
    """
    if not ratio > 0 or ratio == 1:
        raise ValueError(f"ratio: expected a positive number other than 1, got {ratio}")
    pairs = points * k * (k - 1) // 2
    z = -float(ndtri(alpha / (2 * pairs))) + float(ndtri(power))
    scenes = math.ceil(z**2 * math.pi / 3 * (spread / math.log(ratio)) ** 2)
    return max(scenes, scenes_needed(k, alpha, points))
