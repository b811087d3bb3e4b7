"""Bootstrap intervals and intervals from order statistics. Every interval that nfbench prints is computed here."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import bdtr

__all__ = [
    "CONFIDENCE",
    "MIN_RUNS",
    "bootstrap",
    "mean",
    "mean_interval",
    "median_interval",
    "percentile_interval",
    "rms",
    "rms_interval",
]

CONFIDENCE = 0.95
RESAMPLES = 2000
CHUNK = 2**20  # how many numbers are resampled at once
MIN_RUNS = 6  # fewest runs for a bootstrap; with fewer pairs no sign test is significant: 2·(1/2)⁶ = 0.03 < 5 %


def rms(values: Float[ndarray, "*groups runs"]) -> Float[ndarray, "*groups"]:
    """Return the root mean square over the last axis."""
    return np.sqrt(np.mean(values**2, axis=-1))


def mean(values: Float[ndarray, "*groups runs"]) -> Float[ndarray, "*groups"]:
    """Return the mean over the last axis."""
    return np.mean(values, axis=-1)


def bootstrap(
    statistic: Callable[..., Float[ndarray, " r"]],
    *samples: Float[ndarray, " runs"],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    paired: bool = True,
) -> Float[ndarray, " resamples"]:
    """Return the statistic of bootstrap resamples (Efron & Tibshirani 1993, ch. 13).

    statistic: function of arrays (r, runs), one per sample, that reduces the last axis to the r statistics.
    samples: samples to resample; if ``paired``, all of the same length and in the same order of scenes.
    rng: random generator.
    resamples: number of resamples.
    paired: whether every resample takes the same scenes from each sample. Otherwise the samples are resampled
    independently.
    """
    rows = max(CHUNK // max(map(len, samples)), 1)  # how many resamples are drawn at once; bounds the memory
    results = []
    for first in range(0, resamples, rows):
        count = min(rows, resamples - first)
        index = [rng.integers(len(s), size=(count, len(s))) for s in (samples[:1] if paired else samples)]
        index *= len(samples) if paired else 1
        results.append(statistic(*(sample[rows_of] for sample, rows_of in zip(samples, index, strict=True))))
    return np.concatenate(results)


def percentile_interval(
    values: Float[ndarray, " resamples"], method: Literal["linear", "nearest"] = "linear"
) -> tuple[float, float]:
    """Return the central 95 % interval of the values, which excludes equal shares at both ends."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, [tail, 1 - tail], method=method)
    return float(low), float(high)


def rms_interval(errors: Float[ndarray, " runs"], rng: np.random.Generator) -> tuple[float, float]:
    """Return a 95 % percentile bootstrap interval of the root mean square; NaN for fewer than 6 runs."""
    if len(errors) < MIN_RUNS:
        return math.nan, math.nan
    low, high = np.sqrt(percentile_interval(bootstrap(mean, errors**2, rng=rng)))
    return float(low), float(high)


def mean_interval(values: Float[ndarray, " runs"]) -> tuple[float, float]:
    """Return a 95 % percentile bootstrap interval of the mean; NaN for fewer than 6 runs."""
    if len(values) < MIN_RUNS:
        return math.nan, math.nan
    return percentile_interval(bootstrap(mean, values, rng=np.random.default_rng(0)))


def median_interval(values: Float[ndarray, " runs"]) -> tuple[float, float]:
    """Return a distribution-free 95 % interval of the median between two order statistics; NaN for too few values.

    David & Nagaraja 2003, § 7.1.
    """
    n = len(values)
    rank = int(np.sum(bdtr(np.arange(n), n, 0.5) <= (1 - CONFIDENCE) / 2))  # of the order statistics
    if rank < 1:
        return math.nan, math.nan
    ordered = np.sort(values)
    return float(ordered[rank - 1]), float(ordered[-rank])
