"""The data of a recording, and what can be said about an estimate of the sources in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..array_instance import ArrayInstance
from ..geometry import Frame
from ..instance import position_errors, position_scores, positions_of
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
    """

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

        The errors are those of a simulated scene; see ``NearFieldInstance.score``. There are no bounds, as the powers
        of the sources are not known. Raises ValueError if the estimate has the wrong shape.
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
        return scores if self.theta is None else position_scores(self.theta, estimate, self.gospa_cutoff_m) | scores

    def misfit(self, estimate: Float[ndarray, "found d"]) -> float:
        """Return ‖(I − P_A)Y‖²_F/‖Y‖²_F, where P_A projects onto the response vectors of an estimate (K̂, d)."""
        if not np.isfinite(estimate).all():
            return float("nan")
        if not len(estimate):
            return 1.0
        A = self.manifold.response(estimate).T
        U, s, _ = np.linalg.svd(A, full_matrices=False)
        U = U[:, s > 1e-12 * s[0]]  # coincident sources span one direction
        return float(np.linalg.norm(self.Y - U @ (U.conj().T @ self.Y)) ** 2 / np.linalg.norm(self.Y) ** 2)

    def errors(self, measure: str, estimates: Float[ndarray, "r found d"]) -> Float[ndarray, " r"]:
        errors = position_errors(self.theta, estimates) if self.theta is not None and measure == "rmse_m" else None
        return super().errors(measure, estimates) if errors is None else errors

    def positions(self, estimate: Float[ndarray, "q d"]) -> tuple[Float[ndarray, "k 3"], Float[ndarray, "k 3"]] | None:
        return None if self.theta is None else positions_of(self.theta, estimate)

    def _limit(self, found: int) -> float:
        energies = np.linalg.svd(self.Y, compute_uv=False) ** 2
        return float(energies[found:].sum() / energies.sum())
