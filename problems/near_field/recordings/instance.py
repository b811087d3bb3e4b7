"""The data of a recording, and what can be said about an estimate of the sources in them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..array_instance import ArrayInstance
from ..bands import Band
from ..diagnosis import Reading
from ..floor import local_fit
from ..geometry import Frame, cartesian
from ..instance import assigned_positions, position_errors, position_scores, positions_of
from ..wavefronts import Manifold

__all__ = ["RecordedInstance"]


@final
@dataclass(frozen=True, eq=False)
class RecordedInstance(ArrayInstance):
    """The data of a recording, with or without the true sources.

    Y: received data, shape (M, T), scaled so that what K sources cannot explain has unit variance.
    manifold: array, without the elements that failed, and wavefront model that the formulations assume.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    expected: number K of sources that formulations with ``sources = "known"`` search for.
    frame: coordinates in which the array, the truth and the estimates are described.
    theta: true sources ``[azimuth, (elevation,) range]`` [rad, m]; None: not known.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``.
    gains: known complex gains of the elements, shape (M,); None: not known.
    noise_covariance: known covariance of the noise in the units of Y, shape (M, M); None: not known, or white.
    notes: sentences that say how the data were read.
    noiseless: measured responses of the sources, shape (M, K); None: not known.
    further: frequency bins besides that of Y, scaled in the same way.
    reading: how the data were read, as far as warnings depend on it.
    """

    is_measured: ClassVar[bool] = True

    Y: Complex[ndarray, "m t"]
    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    expected: int
    frame: Frame
    theta: Float[ndarray, "k d"] | None = None
    gospa_cutoff_m: float = 1.0
    gains: Complex[ndarray, " m"] | None = None
    noise_covariance: Complex[ndarray, "m m"] | None = None
    notes: tuple[str, ...] = ()
    noiseless: Complex[ndarray, "m k"] | None = None
    further: tuple[Band, ...] = ()
    reading: Reading = field(default_factory=Reading)

    @property
    def sources(self) -> int:
        """The number K of sources that is assumed to be known."""
        return self.expected

    def truth(self) -> Float[ndarray, "k d"] | None:
        return self.theta

    def score(self, estimate: Float[ndarray, "found d"]) -> dict[str, float]:
        """Return how well an estimate (K̂, d) [rad, m] explains the data and, where the truth is known, its errors.

        misfit: share of the energy of the data that the estimate does not explain, ‖(I − P_A)Y‖²_F/‖Y‖²_F.
        misfit_limit: smallest misfit that any K̂ response vectors could have, those of the signal subspace.
        sources_found: number K̂ of estimates.

        Where the truth is known, there are also the errors of a simulated scene (see ``NearFieldInstance.score``) and

        range_bias_m: mean of the differences between estimated and true ranges, negative if estimates are too near.
        cross_range_m: root mean square distance from the estimates to the lines through the origin and the sources.
        floor_m: root mean square error of a least-squares fit to measured responses without noise, started at the true
            sources; what the model cannot explain leaves this error at any signal-to-noise ratio.

        There are no bounds, as they assume a model that measured data do not follow. Raises ValueError if the estimate
        has the wrong shape.
        """
        estimate = np.asarray(estimate, dtype=np.float64)
        d = self.manifold.dimension
        if estimate.ndim != 2 or estimate.shape[1] != d:
            raise ValueError(f"estimate: expected shape (K, {d}), one row per source, got {estimate.shape}")
        found = len(estimate)
        scores = {
            "misfit": self.misfit(estimate),
            "misfit_limit": self._limit(found),
            "sources_found": float(found),
        }
        if self.theta is None:
            return scores
        scores |= position_scores(self.theta, estimate, self.gospa_cutoff_m)
        return scores | _along_and_across(self.theta, estimate) | self._floor

    def misfit(self, estimate: Float[ndarray, "found d"]) -> float:
        """Return ‖(I − P_A)Y‖²_F/‖Y‖²_F, both summed over the frequency bins.

        P_A projects onto the response vectors of an estimate (K̂, d).
        """
        if not np.isfinite(estimate).all():
            return float("nan")
        if not len(estimate):
            return 1.0
        unexplained = [_unexplained(band, estimate) for band in self.bands]
        return sum(unexplained) / sum(float(np.linalg.norm(band.Y)) ** 2 for band in self.bands)

    def errors(self, measure: str, estimates: Float[ndarray, "r found d"]) -> Float[ndarray, " r"]:
        errors = position_errors(self.theta, estimates) if self.theta is not None and measure == "rmse_m" else None
        return super().errors(measure, estimates) if errors is None else errors

    def positions(
        self, estimate: Float[ndarray, "q d"]
    ) -> tuple[Float[ndarray, "k columns"], Float[ndarray, "_ columns"]]:
        theta = np.empty((0, self.manifold.dimension)) if self.theta is None else self.theta
        return positions_of(theta, estimate, self.frame)

    @cached_property
    def _floor(self) -> dict[str, float]:
        if self.noiseless is None or self.theta is None or self.manifold.wavefront == "planar":
            return {}
        fitted = local_fit(self.noiseless, self.manifold, self.theta, self.lower, self.upper)
        errors = np.sum((cartesian(fitted) - cartesian(self.theta)) ** 2, axis=1)
        return {"floor_m": math.sqrt(np.mean(errors))}

    def _limit(self, found: int) -> float:
        energies = [np.linalg.svd(band.Y, compute_uv=False) ** 2 for band in self.bands]
        return sum(float(each[found:].sum()) for each in energies) / sum(float(each.sum()) for each in energies)


def _unexplained(band: Band, estimate: Float[ndarray, "found d"]) -> float:
    """Return ‖(I − P_A)Y‖²_F of one frequency bin."""
    A = band.manifold.response(estimate).T
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    U = U[:, s > 1e-12 * s[0]]  # coincident sources span one direction
    return float(np.linalg.norm(band.Y - U @ (U.conj().T @ band.Y)) ** 2)


def _along_and_across(theta: Float[ndarray, "k d"], estimate: Float[ndarray, "found d"]) -> dict[str, float]:
    """Return the errors along the lines of sight, with their sign, and perpendicular to them [m]."""
    if not len(estimate) or not np.isfinite(estimate).all():
        return {"range_bias_m": math.nan, "cross_range_m": math.nan}
    truth, matched = assigned_positions(theta, estimate)
    matched = matched[: len(truth)]
    paired = np.isfinite(matched).all(axis=1)
    truth, matched = truth[paired], matched[paired]
    r = np.linalg.norm(truth, axis=1)
    across = np.linalg.norm(np.cross(truth / r[:, None], matched), axis=1)
    bias = np.mean(np.linalg.norm(matched, axis=1) - r)
    return {"range_bias_m": float(bias), "cross_range_m": math.sqrt(np.mean(across**2))}
