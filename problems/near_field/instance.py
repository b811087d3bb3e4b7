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

from .bounds import deterministic_bound, position_bounds, stochastic_bound
from .floor import local_fit, noise_free_columns
from .geometry import cartesian
from .wavefronts import Manifold

__all__ = ["NearFieldInstance"]


@final
@dataclass(frozen=True, eq=False)
class NearFieldInstance(Instance):
    """What an array received, and where it came from.

    Y: (M, T) received data, noise of unit variance. theta: (K, d) the true sources, ``[azimuth, (elevation,) range]``
    [rad, m]. manifold: the array and the wavefront the data were made with. lower, upper: (d,) the box of one source.
    H: (1, M, K) the channel of the block, or (T, M, K) that of every snapshot. symbols: (K, T) what the sources sent,
    of power snr. snr: (K,) per source and antenna, over the noise. rician_k: κ, inf in pure line of sight.
    gospa_cutoff_m: c [m] of ``gospa_m``.
    """

    Y: Complex[ndarray, "m t"]
    theta: Float[ndarray, "k d"]
    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    H: Complex[ndarray, "draws m k"]
    symbols: Complex[ndarray, "k t"]
    snr: Float[ndarray, " k"]
    rician_k: float
    gospa_cutoff_m: float = 1.0

    @property
    def sources(self) -> int:
        """The number K of sources."""
        return len(self.theta)

    def truth(self) -> Float[ndarray, "k d"]:
        return self.theta

    def score(self, estimate: Float[ndarray, "found d"]) -> dict[str, float]:
        """Cartesian errors [m] of the assignment of estimates to sources with the least sum of squares (Kuhn 1955).

        ``rmse_m`` is the root of the mean square of those matched, min(K, K̂) of them; ``error_1_m`` … belong to the
        true sources in order, NaN where one has no partner. ``gospa_m`` counts the others too: p = α = 2, so that a
        source missed and an estimate too many add c²/2 each to its square (Rahmathullah, García-Fernández & Svensson
        2017, doi:10.23919/ICIF.2017.8009645).
        ``sources`` is K, ``sources_found`` K̂. All are NaN if the estimate is not finite, ``rmse_m`` if it is empty.
        Beside them stand the ``bounds``, which do not depend on the estimate. Raises ValueError unless the estimate is
        (K̂, d) [rad, m].
        """
        estimate = np.asarray(estimate, dtype=np.float64)
        d = self.theta.shape[1]
        if estimate.ndim != 2 or estimate.shape[1] != d:
            raise ValueError(f"estimate: expected shape (K, {d}), a row per source, got {estimate.shape}")
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.sum((cartesian(self.theta)[:, None] - cartesian(estimate)) ** 2, axis=-1)
        K, found = squares.shape
        errors = np.full(K, math.nan)
        scores = dict.fromkeys(("rmse_m", "gospa_m", "sources", "sources_found"), math.nan)
        if np.isfinite(squares).all():  # false too where an estimate is so far off that its square is infinite
            true, matched = linear_sum_assignment(squares)
            errors[true] = np.sqrt(squares[true, matched])
            rmse = math.sqrt(np.mean(squares[true, matched])) if found else math.nan
            scores = {
                "rmse_m": rmse,
                "gospa_m": _gospa(squares, self.gospa_cutoff_m),
                "sources": K,
                "sources_found": found,
            }
        scores |= {f"error_{k}_m": float(error) for k, error in enumerate(errors, start=1)}
        return scores | self.bounds()

    def positions(self, estimate: Float[ndarray, "q d"]) -> tuple[Float[ndarray, "k 3"], Float[ndarray, "k 3"]]:
        """The true positions and, row by row, the estimates assigned to them as for the score [m]."""
        truth, found = (
            cartesian(self.theta),
            cartesian(np.asarray(estimate, dtype=np.float64).reshape(-1, self.theta.shape[1])),
        )
        source, guess = linear_sum_assignment(np.sum((truth[:, None] - found) ** 2, axis=-1))
        matched = np.full_like(truth, math.nan)
        matched[source] = found[guess]
        return truth, matched

    def bounds(self) -> dict[str, float]:
        """What errors [m] of this scene are to be compared with, by column name.

        In pure line of sight the Cramér–Rao bounds of positions: ``crb_m``, the root mean square over sources of the
        stochastic ones ``crb_1_m`` …, and ``crb_deterministic_m`` of those for the symbols that were sent. They are
        inf where the sources cannot be told apart, and know nothing of the box: where they approach its size, an
        estimate within it can be better. Under Rician fading, where no such bound holds, ``floor_m``: the root mean
        square error of least squares without noise, started at the truth. It is no bound either, but tells what more
        SNR cannot mend. A planar wavefront, which hides the range, has neither.
        """
        if self.manifold.wavefront == "planar":
            return {}
        if math.isfinite(self.rician_k):
            columns = noise_free_columns(self.H, self.symbols)
            fitted = local_fit(columns, self.manifold, self.theta, self.lower, self.upper)
            errors = np.linalg.norm(cartesian(fitted) - cartesian(self.theta), axis=1)
            return {"floor_m": _root_mean_square(errors)}
        stochastic = stochastic_bound(self.manifold, self.theta, self.snr, self.symbols.shape[1])
        deterministic = deterministic_bound(self.manifold, self.theta, self.symbols)
        each = position_bounds(stochastic, self.theta)
        return {
            "crb_m": _root_mean_square(each),
            "crb_deterministic_m": _root_mean_square(position_bounds(deterministic, self.theta)),
            **{f"crb_{k}_m": float(bound) for k, bound in enumerate(each, start=1)},
        }


def _root_mean_square(lengths: Float[ndarray, " k"]) -> float:
    return math.sqrt(np.mean(lengths**2))


def _gospa(squares: Float[ndarray, "k found"], cutoff: float) -> float:
    """GOSPA of squared distances for p = α = 2: a pair beyond the cut-off costs as much as a missed and a false one."""
    near = np.minimum(squares, cutoff**2)
    unmatched = abs(squares.shape[0] - squares.shape[1])
    return math.sqrt(near[linear_sum_assignment(near)].sum() + unmatched * cutoff**2 / 2)
