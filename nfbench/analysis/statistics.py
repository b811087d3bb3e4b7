"""Intervals from resampled and from ordered rows; every interval that nfbench prints is computed here."""

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
CHUNK = 2**20  # numbers resampled at once
MIN_RUNS = 6  # fewer runs are not resampled, and fewer pairs cannot differ at 5 %: 2·(1/2)⁶ = 0.03


def rms(values: Float[ndarray, "*groups runs"]) -> Float[ndarray, "*groups"]:
    """The root of the mean square over the last axis."""
    return np.sqrt(np.mean(values**2, axis=-1))


def mean(values: Float[ndarray, "*groups runs"]) -> Float[ndarray, "*groups"]:
    """The mean over the last axis."""
    return np.mean(values, axis=-1)


def bootstrap(
    statistic: Callable[..., Float[ndarray, " r"]],
    *samples: Float[ndarray, " runs"],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    paired: bool = True,
) -> Float[ndarray, " resamples"]:
    """The statistic of resampled samples (Efron & Tibshirani 1993, ch. 13); it reduces the last axis of each sample.

    paired: the samples belong to the same scenes, in order, and every resample takes the same scenes from each;
    otherwise each sample is resampled by itself.
    """
    rows = max(CHUNK // max(map(len, samples)), 1)  # resampled together: a long study must fit in memory
    found = []
    for first in range(0, resamples, rows):
        count = min(rows, resamples - first)
        index = [rng.integers(len(s), size=(count, len(s))) for s in (samples[:1] if paired else samples)]
        index *= len(samples) if paired else 1
        found.append(statistic(*(sample[each] for sample, each in zip(samples, index, strict=True))))
    return np.concatenate(found)


def percentile_interval(
    values: Float[ndarray, " resamples"], method: Literal["linear", "nearest"] = "linear"
) -> tuple[float, float]:
    """The interval that leaves out equal shares of the values at both ends."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, [tail, 1 - tail], method=method)
    return float(low), float(high)


def rms_interval(errors: Float[ndarray, " runs"], rng: np.random.Generator) -> tuple[float, float]:
    """A percentile bootstrap interval of the root mean square; NaN for fewer than 6 runs."""
    if len(errors) < MIN_RUNS:
        return math.nan, math.nan
    low, high = np.sqrt(percentile_interval(bootstrap(mean, errors**2, rng=rng)))
    return float(low), float(high)


def mean_interval(values: Float[ndarray, " runs"]) -> tuple[float, float]:
    """A percentile bootstrap interval of the mean; NaN for fewer than 6 runs."""
    if len(values) < MIN_RUNS:
        return math.nan, math.nan
    return percentile_interval(bootstrap(mean, values, rng=np.random.default_rng(0)))


def median_interval(values: Float[ndarray, " runs"]) -> tuple[float, float]:
    """An interval of the median between two order statistics, whatever the distribution (David & Nagaraja 2003, § 7.1).

    NaN where there are too few values.
    """
    n = len(values)
    rank = int(np.sum(bdtr(np.arange(n), n, 0.5) <= (1 - CONFIDENCE) / 2))  # values left out on either side
    if rank < 1:
        return math.nan, math.nan
    ordered = np.sort(values)
    return float(ordered[rank - 1]), float(ordered[-rank])
