"""What an estimator knows of the impairments of an array: data and responses after calibration and prewhitening."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import solve_triangular

from .bands import Band
from .wavefronts import Amplitude, Manifold, Wavefront

__all__ = ["ALL", "Impaired", "Knowledge", "calibrated", "true_bands"]

EQUAL = 1e-12  # relative difference of moduli that counts as none


@runtime_checkable
class Impaired(Protocol):
    """What is known about the array of an instance; None or nothing stands for the nominal value.

    manifold: nominal array and wavefront model. Y: data, shape (M, T). bands: data of all frequency bins. gains: gains
    with phases of the elements, shape (M,). coupling: matrix of mutual coupling, shape (M, M). noise_covariance:
    covariance of the noise, up to a factor, shape (M, M). failed: indices of elements that receive noise only.
    element_positions: true positions of the elements relative to the origin [m], shape (M, 3).
    """

    @property
    def manifold(self) -> Manifold: ...
    @property
    def Y(self) -> Complex[ndarray, "m t"]: ...  # noqa: N802  # the paper's symbol
    @property
    def bands(self) -> tuple[Band, ...]: ...
    @property
    def gains(self) -> Complex[ndarray, " m"] | None: ...
    @property
    def coupling(self) -> Complex[ndarray, "m m"] | None: ...
    @property
    def noise_covariance(self) -> Complex[ndarray, "m m"] | None: ...
    @property
    def failed(self) -> tuple[int, ...]: ...
    @property
    def element_positions(self) -> Float[ndarray, "m 3"] | None: ...


@runtime_checkable
class Knowledge(Protocol):
    """The options of a formulation that say what it knows."""

    @property
    def wavefront(self) -> Wavefront | None: ...
    @property
    def amplitude(self) -> Amplitude: ...
    @property
    def known_gains(self) -> bool: ...
    @property
    def known_coupling(self) -> bool: ...
    @property
    def known_noise(self) -> bool: ...
    @property
    def known_failed(self) -> bool: ...
    @property
    def known_positions(self) -> bool: ...


@dataclass(frozen=True)
class Everything:
    """The knowledge of an estimator that knows all impairments."""

    amplitude: Amplitude = "constant"
    wavefront: Wavefront | None = None
    known_gains: bool = True
    known_coupling: bool = True
    known_noise: bool = True
    known_failed: bool = True
    known_positions: bool = True


ALL = Everything()


def true_bands(instance: Impaired, amplitude: Amplitude) -> list[Band]:
    """Return the bins with the responses in white noise of unit power for an estimator that knows all impairments."""
    knows = Everything(amplitude)
    return [replace(band, manifold=_informed(band, instance, knows)[1]) for band in instance.bands]


def calibrated(instance: Impaired, knows: Knowledge) -> list[Band]:
    """Return the data and the responses W·a(θ) of each frequency bin after removing what an estimator knows.

    Rows of failed elements are left out, unless their noise is known to be correlated with that of others: then it says
    something about it. With the covariance R = L·Lᴴ of the noise, the data are L⁻¹Y and the weights W = L⁻¹ΓC. Where
    the weights are diagonal and of one modulus, the data are turned instead, Y ← W*Y/|w|, and responses keep the
    modulus 1, which makes no difference to the misfit. Gains, coupling and noise are the same in all bins.
    """
    return [_calibrated(band, instance, knows) for band in instance.bands]


def _calibrated(band: Band, instance: Impaired, knows: Knowledge) -> Band:
    Y, manifold = _informed(band, instance, knows)
    w = manifold.weights
    if w is not None and w.ndim == 1 and np.ptp(np.abs(w)) <= EQUAL * np.abs(w).max():
        return Band(w.conj()[:, None] / np.abs(w).max() * Y, replace(manifold, weights=None))
    return Band(Y, manifold)


def _informed(band: Band, instance: Impaired, knows: Knowledge) -> tuple[Complex[ndarray, "rows t"], Manifold]:
    """Return L⁻¹Y and the responses L⁻¹ΓC·a(θ) of one bin, as far as an estimator knows these."""
    Y, manifold = band.Y, band.manifold.under(knows.wavefront)
    if knows.amplitude != manifold.amplitude:
        manifold = replace(manifold, amplitude=knows.amplitude)
    if knows.known_positions and instance.element_positions is not None:
        manifold = replace(manifold, positions=instance.element_positions)
    gains = instance.gains if knows.known_gains else None
    R = instance.noise_covariance if knows.known_noise else None
    C = instance.coupling if knows.known_coupling else None
    failed = knows.known_failed and bool(instance.failed)
    if failed and R is not None and not _is_diagonal(R):
        gains = np.ones(len(Y), dtype=np.complex128) if gains is None else gains.copy()
        gains[list(instance.failed)] = 0.0
    elif failed:
        kept = np.delete(np.arange(len(Y)), instance.failed)
        Y = Y[kept]
        gains = None if gains is None else gains[kept]
        R = None if R is None else R[np.ix_(kept, kept)]
        if C is None:
            manifold = replace(manifold, positions=manifold.positions[kept])
        else:
            C = C[kept]
    weights = gains if C is None else C if gains is None else gains[:, None] * C
    if R is not None:
        Y, weights = _whitened(Y, weights, R)
    return Y, manifold if weights is None else replace(manifold, weights=weights)


def _is_diagonal(R: Complex[ndarray, "m m"]) -> bool:
    return np.count_nonzero(R) == np.count_nonzero(np.diag(R))


def _whitened(
    Y: Complex[ndarray, "m t"], weights: Complex[ndarray, "m ..."] | None, R: Complex[ndarray, "m m"]
) -> tuple[Complex[ndarray, "m t"], Complex[ndarray, "m ..."]]:
    """Return L⁻¹Y and L⁻¹W with R = L·Lᴴ; a diagonal R keeps a diagonal W diagonal."""
    if _is_diagonal(R):
        scale = 1 / np.sqrt(np.diag(R).real)
        if weights is None:
            return scale[:, None] * Y, scale.astype(np.complex128)
        return scale[:, None] * Y, weights * (scale if weights.ndim == 1 else scale[:, None])
    L = np.linalg.cholesky(R)
    W = np.eye(len(R), dtype=np.complex128) if weights is None else weights
    W = np.diag(W) if W.ndim == 1 else W
    return solve_triangular(L, Y, lower=True), solve_triangular(L, W, lower=True)
