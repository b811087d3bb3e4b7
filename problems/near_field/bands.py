"""Frequency bins of wideband data: each has its own data and its own wavelength, and the sources are the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Incompatible

from .bounds import invert_information, root_of_deterministic, root_of_stochastic
from .wavefronts import Manifold, Wavefront

__all__ = ["Band", "bounds_of_bands", "one_band", "spread_bins"]


@final
@dataclass(frozen=True, eq=False)
class Band:
    """The data of one frequency bin.

    Y: received data, shape (M, T), with noise of unit variance where they are simulated.
    manifold: array and wavefront model at the wavelength of the bin.
    H: channel of the whole block, shape (1, M, K), or of each snapshot, shape (T, M, K); None: not known.
    symbols: symbols sent by the sources, shape (K, T), with the powers of the sources; None: not known.
    """

    Y: Complex[ndarray, "m t"]
    manifold: Manifold
    H: Complex[ndarray, "draws m k"] | None = None
    symbols: Complex[ndarray, "k t"] | None = None

    @property
    def received(self) -> tuple[Complex[ndarray, "m t"], Manifold]:
        """The data and the manifold."""
        return self.Y, self.manifold

    def under(self, wavefront: Wavefront | None) -> Band:
        """Return the same data with another model of the wavefront; None keeps the one it has."""
        return replace(self, manifold=self.manifold.under(wavefront))


def spread_bins(bins: int, bandwidth_relative: float) -> list[float]:
    """Return the frequencies of the bins as multiples of the carrier, the nearest to the carrier first.

    They divide the bandwidth, whose ends are the outermost bins, into equal parts; a single bin is the carrier.
    """
    steps = sorted((2 * i - (bins - 1) for i in range(bins)), key=lambda step: (abs(step), step))
    return [1 + bandwidth_relative * step / (2 * max(bins - 1, 1)) for step in steps]


def one_band(bands: Sequence[Band], name: str, reason: str) -> None:
    """Raise Incompatible, with the reason why the formulation ``name`` needs one bin, if there are more."""
    if len(bands) > 1:
        raise Incompatible(
            f"bins: expected 1 for {name}, {reason}, got {len(bands)}; use neef or alternating-projection"
        )


def bounds_of_bands(
    bands: Sequence[Band],
    theta: Float[ndarray, "k d"],
    snr: Float[ndarray, " k"],
    correlation: Complex[ndarray, "k k"] | None = None,
) -> tuple[Float[ndarray, "kd kd"], Float[ndarray, "kd kd"]]:
    """Return the stochastic and the deterministic bound on the covariance of θ̂ [rad, m] from all bins together.

    The data of different bins are independent, and only the positions are common to them: symbols, their covariance
    and the power of the noise are unknown in each bin. The Fisher information of the positions is then the sum of that
    of the bins.

    bands: bins with known symbols.
    theta: sources [rad, m], shape (K, d).
    snr: signal-to-noise power ratio per source at each antenna, the same in all bins, shape (K,).
    correlation: correlation matrix of the symbols in each bin, shape (K, K); None: they are uncorrelated.
    """
    stochastic = [root_of_stochastic(band.manifold, theta, snr, correlation) for band in bands]
    known = [(band.manifold, band.symbols) for band in bands if band.symbols is not None]
    deterministic = [root_of_deterministic(manifold, theta, symbols) for manifold, symbols in known]
    snapshots = [band.Y.shape[1] for band in bands]
    return _sum(stochastic, snapshots), _sum(deterministic, snapshots)


def _sum(roots: list[tuple[ndarray, ndarray]], snapshots: list[int]) -> Float[ndarray, "kd kd"]:
    """Return the bound whose information is Σ 2T_f·J_fᵀJ_f."""
    weights = np.sqrt(np.array(snapshots) / snapshots[0])
    J = np.vstack([weight * root for weight, (root, _) in zip(weights, roots, strict=True)])
    rounding = np.linalg.norm([w * error for w, (_, error) in zip(weights, roots, strict=True)], axis=0)
    return invert_information(J, rounding, snapshots[0])
