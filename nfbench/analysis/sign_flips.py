"""The one test of nfbench: the exact sign-flip test of integer scores, one score per scene.

Under the hypothesis that two methods do not differ, the score of each scene is as likely positive as negative. The test
compares the sum of the scores with all sums that flips of the signs can give. With signed ranks as the scores it is
Wilcoxon's signed-rank test with Pratt's zeros, exact also with ties; with differences of single hits it is McNemar's
exact test.

Scores and ratios of methods a and b are positive where a is worse, except for hits, where a is better.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.special import ndtr
from scipy.stats import rankdata

__all__ = [
    "EXACT",
    "TIE",
    "hit_scores",
    "holm",
    "log_ratios",
    "mean_over_points",
    "one_sided",
    "one_sided_pvalues",
    "sign_flip_pvalue",
    "sign_flip_pvalues",
    "signed_ranks",
]

EXACT = 200  # largest number of non-zero scores for the exact law; the normal law beyond
TIE = 1.01  # errors whose ratio is smaller count as equal


def sign_flip_pvalue(v: Int[ndarray, " n"]) -> float:
    """Return the two-sided p-value of the sum of the scores v, (n,), over independent fair signs.

    The value is exact for at most 200 non-zero scores, and that of the normal law without continuity correction
    beyond. It is 1 if no score differs from 0. Raises ValueError if a score is NaN or not an integer.
    """
    return float(sign_flip_pvalues(np.asarray(v)[None])[0])


def sign_flip_pvalues(v: Int[ndarray, "m n"]) -> Float[ndarray, " m"]:
    """Return the two-sided p-value of each row of scores v, (m, n), as :func:`sign_flip_pvalue` does.

    Rows with the same absolute scores share one computation of the law, as all rows without ties and zeros do.
    """
    v = _integers("v", v)
    if v.ndim != 2:
        raise ValueError(f"v: expected an array (m, n), got the shape {v.shape}")
    sums = np.abs(v.sum(axis=1))
    p = np.ones(len(v))
    magnitudes, which = np.unique(np.sort(np.abs(v), axis=1), axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    for a, rows in zip(magnitudes, np.split(order, np.cumsum(np.bincount(which.ravel()))[:-1]), strict=True):
        a = a[a > 0]
        if len(a) == 0:
            continue
        if len(a) > EXACT:
            p[rows] = 2 * ndtr(-sums[rows] / math.sqrt(float(np.sum(a.astype(np.float64) ** 2))))
        else:
            p[rows] = _exact(a, sums[rows])
    return np.minimum(p, 1.0)


def _exact(a: Int[ndarray, " q"], sums: Int[ndarray, " rows"]) -> Float[ndarray, " rows"]:
    """Return P(|Σ ± a| ≥ sum) for several sums, without the bound 1. a is sorted, (q,), and positive."""
    unit = int(np.gcd.reduce(a))
    a, sums = a // unit, sums // unit
    total = int(a.sum())
    lower = (total - sums) // 2  # t: a sum of −|Σv| means that the flipped subset adds up to t at most
    f = np.zeros(int(lower.max()) + 1)  # f[s] = P(Σ of a random subset of the first scores = s)
    f[0] = 1.0
    reach = 0  # f is zero beyond
    for q in a.tolist():
        end = min(reach + q, len(f) - 1)
        half = 0.5 * f[: reach + 1]
        f[: reach + 1] = half
        if q <= end:
            f[q : end + 1] += half[: end + 1 - q]
        reach = end
    return 2 * np.cumsum(f)[lower]


def one_sided(v: Int[ndarray, " n"]) -> float:
    """Return the one-sided p-value of the scores v, (n,), for the alternative that they tend to be positive.

    It is p/2 where the sum is positive, 1 − p/2 where it is negative, and 1 where it is 0.
    """
    return float(one_sided_pvalues(np.asarray(v)[None])[0])


def one_sided_pvalues(v: Int[ndarray, "m n"]) -> Float[ndarray, " m"]:
    """Return the one-sided p-value of each row of scores v, (m, n), as :func:`one_sided` does."""
    half = sign_flip_pvalues(v) / 2
    total = np.asarray(v).sum(axis=1)
    return np.where(total > 0, half, np.where(total < 0, 1 - half, 1.0))


def log_ratios(
    a: Float[ndarray, "*shape"], b: Float[ndarray, "*shape"], *, ties: bool = True, factor: float = TIE
) -> Float[ndarray, "*shape"]:
    """Return ln a − ln b, elementwise, for errors or costs that may be infinite.

    a, b: values of two methods, at least 0, ∞ where a method failed; of any shapes that broadcast.
    ties: whether ratios closer to 1 than ``factor`` count as ties and give 0.

    Two equal values give 0, also two infinite ones; one infinite value gives ±∞, and so does one zero. Raises
    ValueError for NaN or negative values.
    """
    a, b = _not_negative("a", a), _not_negative("b", b)
    with np.errstate(divide="ignore", invalid="ignore"):
        d = np.log(a) - np.log(b)
    d = np.where(a == b, 0.0, d)
    return np.where(np.abs(d) < math.log(factor), 0.0, d) if ties else d


def mean_over_points(d: Float[ndarray, "points n"]) -> Float[ndarray, " n"]:
    """Return the mean over points of logarithms of ratios; it is ±∞ by the majority of infinities, which may cancel."""
    d = np.asarray(d, dtype=np.float64)
    infinite = np.where(np.isinf(d), np.sign(d), 0.0).sum(axis=0)
    finite = np.where(np.isinf(d), 0.0, d).mean(axis=0)
    return np.where(infinite > 0, np.inf, np.where(infinite < 0, -np.inf, finite))


def signed_ranks(d: Float[ndarray, "*pairs n"]) -> Int[ndarray, "*pairs n"]:
    """Return the scores 2·midrank(|d|)·sign(d) over the last axis of d, (…, n); zeros are ranked and then score 0.

    d may contain ±∞, which share the last ranks. Raises ValueError for NaN.
    """
    d = np.asarray(d, dtype=np.float64)
    if np.isnan(d).any():
        raise ValueError("d: expected numbers or ±∞, got NaN")
    if d.size == 0:
        return np.zeros(d.shape, dtype=np.int64)
    return np.rint(2 * rankdata(np.abs(d), axis=-1)).astype(np.int64) * np.sign(d).astype(np.int64)


def hit_scores(h_a: Any, r_a: Any, h_b: Any, r_b: Any) -> Int[ndarray, "*shape"]:
    """Return h_a·r_b − h_b·r_a: the difference in the share of hits, as an integer; positive where a hits more often.

    h_a, h_b: number of runs that hit, per scene. r_a, r_b: number of runs per scene. All broadcast.
    """
    h_a, r_a, h_b, r_b = (
        _integers(name, value) for name, value in (("h_a", h_a), ("r_a", r_a), ("h_b", h_b), ("r_b", r_b))
    )
    return h_a * r_b - h_b * r_a


def holm(p: Float[ndarray, "*shape"]) -> Float[ndarray, "*shape"]:
    """Return Holm's adjusted p-values of all elements of p, in the shape of p.

    Holm 1979, "A simple sequentially rejective multiple test procedure". Raises ValueError for NaN.
    """
    p = np.asarray(p, dtype=np.float64)
    if np.isnan(p).any():
        raise ValueError("p: expected p-values, got NaN")
    flat = p.ravel()
    order = np.argsort(flat, kind="stable")
    stepped = np.maximum.accumulate(flat[order] * np.arange(len(flat), 0, -1))
    adjusted = np.empty_like(flat)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted.reshape(p.shape)


def _integers(name: str, value: Any) -> Int[ndarray, "*shape"]:
    array = np.asarray(value)
    if array.dtype.kind in "iub":
        return array.astype(np.int64)
    rounded = np.asarray(array, dtype=np.float64)
    if not np.isfinite(rounded).all() or (rounded != np.rint(rounded)).any():
        raise ValueError(f"{name}: expected integers, got {array[rounded != np.rint(rounded)][:3]}")
    return rounded.astype(np.int64)


def _not_negative(name: str, value: Any) -> Float[ndarray, "*shape"]:
    array = np.asarray(value, dtype=np.float64)
    if np.isnan(array).any() or (array < 0).any():
        wrong = array[np.isnan(array) | (array < 0)].ravel()
        raise ValueError(f"{name}: expected values of at least 0 or ∞, got {wrong[0]}")
    return array
