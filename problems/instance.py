"""One draw of a near-field scenario: the data, the truth, and how an estimate is scored."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from nfbench import Instance

from .geometry import cartesian
from .wavefronts import Manifold

__all__ = ["NearFieldInstance"]


@final
@dataclass(frozen=True, eq=False)
class NearFieldInstance(Instance):
    """What an array received, and where it came from.

    Y: (M, T) received data, noise of unit variance. theta: (K, d) the true sources, ``[azimuth, (elevation,) range]``
    [rad, m]. manifold: the array and the wavefront the data were made with. lower, upper: (d,) the box of one source.
    """

    Y: Complex[ndarray, "m t"]
    theta: Float[ndarray, "k d"]
    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]

    @property
    def sources(self) -> int:
        """The number K of sources."""
        return len(self.theta)

    def score(self, estimate: Float[ndarray, "k d"]) -> dict[str, float]:
        """Cartesian errors [m] of the assignment of estimates to sources with the least sum of squares (Kuhn 1955).

        ``rmse_m`` is the root of their mean square, ``error_1_m`` … belong to the true sources in order. All are NaN
        if the estimate is not finite. Raises ValueError unless the estimate is (K, d) [rad, m].
        """
        estimate = np.asarray(estimate, dtype=np.float64)
        if estimate.shape != self.theta.shape:
            raise ValueError(f"estimate: expected shape {self.theta.shape}, a row per source, got {estimate.shape}")
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.sum((cartesian(self.theta)[:, None] - cartesian(estimate)) ** 2, axis=-1)
        matched = np.full(self.sources, math.nan)
        if np.isfinite(squares).all():  # false too where an estimate is so far off that its square is infinite
            matched = squares[linear_sum_assignment(squares)]
        errors = np.sqrt(matched)
        scores = {"rmse_m": math.sqrt(np.mean(matched))}
        return scores | {f"error_{k}_m": float(error) for k, error in enumerate(errors, start=1)}
