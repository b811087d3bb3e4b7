"""Intervals of shares, quantiles, ratios, means and expected running times, each over scenes; nominally 95 %.

``docs/intervals.md`` has the measured coverage of each. NaN stands for an end that the data do not bound.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.special import bdtr, betaincinv, ndtri
from scipy.stats import kstwo

from .sign_flips import EXACT

__all__ = [
    "LEVEL",
    "Estimate",
    "bounded_mean_interval",
    "ecdf_band",
    "ecdf_pointwise",
    "ert",
    "ert_interval",
    "mean_pvalue",
    "quantile_interval",
    "ratio_interval",
    "rms_of_solved_interval",
    "share_interval",
    "variance_components",
]

LEVEL = 0.95
DRAWS = 20_000  # of weights, for means and expected running times
SEED = 0
MANY = 500  # scenes beyond which sums over them are taken for normal

Estimate = tuple[float, float, float]  # value, lower end, upper end


def share_interval(hits: int, n: int, level: float = LEVEL) -> tuple[float, float]:
    """Return the Clopper–Pearson interval of a share, for this many hits in n scenes of one run each.

    Raises ValueError unless 0 ≤ hits ≤ n and n ≥ 1.
    """
    if not 0 <= hits <= n or n < 1:
        raise ValueError(f"hits: expected 0 to n = {n}, and n at least 1, got {hits}")
    low, high = ecdf_pointwise(np.array([hits]), n, level)
    return float(low[0]), float(high[0])


def ecdf_pointwise(
    hits: Int[ndarray, " x"], n: int, level: float = LEVEL
) -> tuple[Float[ndarray, " x"], Float[ndarray, " x"]]:
    """Return the pointwise Clopper–Pearson band of a distribution function from counts of n scenes, (x,) each.

    At all points at once such a band covers far less than the level; see :func:`ecdf_band`.
    """
    tail, h = (1 - level) / 2, np.asarray(hits, dtype=np.float64)
    low = np.where(h == 0, 0.0, betaincinv(np.maximum(h, 1), n - h + 1, tail))
    high = np.where(h == n, 1.0, betaincinv(h + 1, np.maximum(n - h, 1), 1 - tail))
    return low, high


def ecdf_band(n: int, level: float = LEVEL) -> float:
    """Return the half width of the simultaneous band of an empirical distribution function of n scenes.

    The exact law of Kolmogorov's statistic. For one target and one run per scene.
    """
    return float(kstwo.ppf(level, n))


def quantile_interval(x: Float[ndarray, " n"], q: float = 0.5, level: float = LEVEL) -> tuple[float, float]:
    """Return the interval of the q-quantile between two order statistics of x, (n,), which may contain ∞.

    An end is NaN where n is too small to bound it. Raises ValueError for NaN in x.
    """
    x = _numbers("x", x)
    if not 0 < q < 1:
        raise ValueError(f"q: expected a number between 0 and 1, got {q}")
    first, last = _quantile_ranks(len(x), q, level)
    ordered = np.sort(x)
    low, high = (float(ordered[rank - 1]) if 1 <= rank <= len(x) else math.nan for rank in (first, last))
    return low, high


@lru_cache(maxsize=256)
def _quantile_ranks(n: int, q: float, level: float) -> tuple[int, int]:
    """Return the ranks of the order statistics, from 1; 0 or n + 1 where n is too small (David & Nagaraja 2003, § 7.1).

    They are those of SciPy's ``quantile_test``, which takes a hundred times longer.
    """
    below = bdtr(np.arange(n + 1), n, q)  # P(at most i of n values lie below the quantile)
    tail = (1 - level) / 2
    return int(np.sum(below <= tail)), 1 + int(np.sum(below < 1 - tail))


def ratio_interval(d: Float[ndarray, " n"], level: float = LEVEL) -> Estimate:
    """Return the typical ratio of two methods' errors, and the ends of its interval.

    d: logarithms of the ratios, one per scene, without ties set to 0; ±∞ where one method failed, (n,).

    The estimate is exp of the median of the Walsh averages (d_i + d_j)/2, i ≤ j (Hodges & Lehmann 1963). The ends are
    order statistics of the averages from the exact law of the signed-rank sum; NaN where n cannot give the level.
    Averages beyond the finite d count as ±∞, which gives the ratio ∞ or 0. Raises ValueError for NaN in d.
    """
    d = _numbers("d", d)
    n = len(d)
    if n == 0:
        return math.nan, math.nan, math.nan
    finite = np.abs(d[np.isfinite(d)])
    largest = float(finite.max(initial=0.0))
    x = np.clip(d, -4 * largest - 1, 4 * largest + 1)
    i, j = np.triu_indices(n)
    averages = np.sort((x[i] + x[j]) / 2)
    averages[averages > largest] = np.inf
    averages[averages < -largest] = -np.inf
    middle = averages[(len(averages) - 1) // 2], averages[len(averages) // 2]
    value = middle[0] if middle[0] == middle[1] else 0.5 * (middle[0] + middle[1])
    c = _walsh_rank(n, level)
    ends = (averages[c - 1], averages[-c]) if c else (math.nan, math.nan)
    with np.errstate(over="ignore"):
        low, high = np.exp(ends)
        return float(np.exp(value)), float(low), float(high)


@lru_cache(maxsize=256)
def _walsh_rank(n: int, level: float) -> int:
    """Return the largest c with P(c-th smallest Walsh average > pseudo-median) ≤ (1 − level)/2; 0 if there is none."""
    tail, total = (1 - level) / 2, n * (n + 1) // 2
    if n > EXACT:
        sd = math.sqrt(total * (2 * n + 1) / 12)
        return max(math.floor(total / 2 + float(ndtri(tail)) * sd), 0)
    law = np.zeros(total + 1)  # of the signed-rank sum
    law[0] = 1.0
    for rank in range(1, n + 1):
        law *= 0.5
        law[rank:] += law[: total + 1 - rank].copy()
    return int(np.searchsorted(np.cumsum(law), tail * (1 + 1e-12), side="right"))


def bounded_mean_interval(
    values: Float[ndarray, " n"], low: float = 0.0, high: float = 1.0, level: float = LEVEL
) -> tuple[float, float]:
    """Return the interval of a mean of values that lie in [low, high], (n,).

    Each scene has a random weight, Dirichlet(1, …, 1) distributed, and so has one extra scene at the worst value; the
    upper end is a quantile of the weighted mean, and the lower end follows likewise (Gaffke 2005; Learned-Miller &
    Thomas 2019). Raises ValueError for values outside the bounds.
    """
    x = _numbers("values", values)
    if len(x) == 0:
        return low, high
    if x.min() < low or x.max() > high:
        raise ValueError(f"values: expected values from {low} to {high}, got {x.min()} to {x.max()}")
    one = np.ones(len(x))
    return _bounded_ratio(x, one, best=(low, 1.0), worst=(high, 1.0), level=level)


def mean_pvalue(values: Float[ndarray, " n"], limit: float) -> float:
    """Return the one-sided p-value for a mean above ``limit``, of values in [0, 1], (n,).

    It is at most (1 − level)/2 exactly where the interval of :func:`bounded_mean_interval` lies above the limit.
    """
    x = _numbers("values", values)
    weights = _weights(len(x))
    drawn = weights[:, :-1] @ (x - limit) - weights[:, -1] * limit
    return float(1 + np.sum(drawn <= 0)) / (DRAWS + 1)


def ert(spent: Float[ndarray, "*shape"], hits: Float[ndarray, "*shape"]) -> float:
    """Return the expected running time: everything spent divided by the number of hits; ∞ without a hit.

    spent: evaluations of the runs up to their hit or end, summed over the runs of each scene. hits: number of hits.
    """
    total = float(np.sum(hits))
    return float(np.sum(spent)) / total if total else math.inf


def ert_interval(
    spent: Float[ndarray, " n"], hits: Float[ndarray, " n"], runs: float, cap: float, level: float = LEVEL
) -> tuple[float, float]:
    """Return the interval of the expected running time over scenes.

    spent, hits: as for :func:`ert`, (n,). runs: runs per scene. cap: the most that a run may spend; ∞ or NaN
    if there is no limit, which leaves the upper end infinite.

    The rule of :func:`bounded_mean_interval` for a ratio of means. The extra scene either misses in all its runs at the
    cap, or hits in all of them at the first evaluation.
    """
    spent, hits = _numbers("spent", spent), _numbers("hits", hits)
    if len(spent) == 0:
        return math.nan, math.nan
    worst = (runs * cap, 0.0) if math.isfinite(cap) else (math.inf, 0.0)
    return _bounded_ratio(spent, hits, best=(float(runs), float(runs)), worst=worst, level=level)


def rms_of_solved_interval(errors: Float[ndarray, " n"], target: float, level: float = LEVEL) -> Estimate:
    """Return the root mean square of the errors that are at most ``target``, and the ends of its interval.

    errors: of all scenes, ∞ where a method failed, (n,). All three are NaN for fewer than two solved scenes. Show it
    beside the share solved, as the scenes that were not solved are left out.
    """
    solved = _numbers("errors", errors)
    solved = solved[solved <= target]
    if len(solved) < 2:
        return math.nan, math.nan, math.nan
    low, high = bounded_mean_interval((solved / target) ** 2, level=level)
    return float(np.sqrt(np.mean(solved**2))), target * math.sqrt(low), target * math.sqrt(high)


def _bounded_ratio(
    num: Float[ndarray, " n"],
    den: Float[ndarray, " n"],
    *,
    best: tuple[float, float],
    worst: tuple[float, float],
    level: float,
) -> tuple[float, float]:
    """Return the ends of the interval of Σnum/Σden: quantiles of weighted ratios with one extra (num, den)."""
    above, below, extra = _weighted_sums(np.asarray(num, dtype=np.float64), np.asarray(den, dtype=np.float64))
    ends = []
    for (a, b), last in ((best, False), (worst, True)):
        with np.errstate(divide="ignore"):
            drawn = (above + extra * a) / (below + extra * b)
        q = (len(drawn) - 1) * ((1 + level) / 2 if last else (1 - level) / 2)
        place = math.ceil(q) if last else math.floor(q)  # towards the outside
        ends.append(float(np.partition(drawn, place)[place]))
    return ends[0], ends[1]


def _weighted_sums(num: Float[ndarray, " n"], den: Float[ndarray, " n"]) -> Float[ndarray, "3 draws"]:
    """Return Σw·num, Σw·den and the weight of the extra scene, for random weights; a ratio needs no normalization.

    With very many scenes, the sums over those with both, one or none of num and den above 0 are drawn from the normal
    law with their mean and covariance, as they are sums of many independent terms.
    """
    if len(num) <= MANY:
        weights = _weights(len(num))
        return np.vstack([(weights[:, :-1] @ np.stack([num, den], axis=1)).T, weights[:, -1]])
    rng = np.random.default_rng(SEED)
    sums = np.zeros((2, DRAWS))
    kinds = 2 * (num > 0) + (den > 0)
    for kind in range(4):
        values = np.stack([num, den], axis=1)[kinds == kind]
        if len(values) <= MANY:
            sums += (rng.standard_exponential((DRAWS, len(values))) @ values).T
        else:  # a weight has mean 1 and variance 1
            sums += rng.multivariate_normal(values.sum(axis=0), values.T @ values, DRAWS, method="eigh").T
    return np.vstack([np.maximum(sums, 0.0), rng.standard_exponential(DRAWS)])


@lru_cache(maxsize=3)
def _weights(n: int) -> Float[ndarray, "draws n1"]:
    """Return exponential weights for n scenes and one extra, (draws, n + 1)."""
    return np.random.default_rng(SEED).standard_exponential((DRAWS, n + 1))


def variance_components(logs: Float[ndarray, "n r"]) -> Estimate:
    """Return the variance of runs within scenes, the variance of scenes, and the share of the latter in both.

    logs: logarithms of finite errors, (n, r): n ≥ 2 scenes of r ≥ 2 runs each. The share is the intraclass correlation,
    NaN if nothing varies. Raises ValueError for other shapes or values that are not finite.
    """
    x = np.asarray(logs, dtype=np.float64)
    if x.ndim != 2 or min(x.shape) < 2 or not np.isfinite(x).all():
        raise ValueError(f"logs: expected finite values, (n, r) with n and r at least 2, got the shape {x.shape}")
    run = float(x.var(axis=1, ddof=1).mean())
    scene = max(float(x.mean(axis=1).var(ddof=1)) - run / x.shape[1], 0.0)
    total = run + scene
    return run, scene, scene / total if total else math.nan


def _numbers(name: str, values: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or np.isnan(x).any():
        raise ValueError(f"{name}: expected an array (n,) without NaN, got {x if x.ndim != 1 else x[np.isnan(x)][:1]}")
    return x
