"""Reduction of the received data: a small factor of Y·Yᴴ, and the signal subspace."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Incompatible

__all__ = ["SignalSubspace", "compress", "decompose", "signal_subspace"]


class SignalSubspace(NamedTuple):
    """The K largest eigenvalues λ_i of R̂ = Y·Yᴴ/T, their eigenvectors, and the power of the noise.

    U_s: orthonormal columns, shape (M, K), in descending order of their eigenvalues.
    eigenvalues: λ_1 >= … >= λ_K, shape (K,).
    noise: σ̂² = (‖Y‖²/T − Σ_{k<=K} λ_k)/(M − K), the mean of the other M − K eigenvalues; 0 if M = K.
    """

    U_s: Complex[ndarray, "m k"]
    eigenvalues: Float[ndarray, " k"]
    noise: float


def compress(Y: Complex[ndarray, "m t"]) -> Complex[ndarray, "m c"]:
    """Return a factor L with c = min(M, T) columns and L·Lᴴ = Y·Yᴴ; from Yᴴ = QR, L = Rᴴ is lower triangular."""
    L: ndarray = np.linalg.qr(Y.conj().T).R.conj().T
    return L


def signal_subspace(Y: Complex[ndarray, "m t"], sources: int) -> Complex[ndarray, "m k"]:
    """Return the eigenvectors U_s of R̂ = Y·Yᴴ/T for its K largest eigenvalues; see ``decompose``."""
    return decompose(Y, sources).U_s


def decompose(Y: Complex[ndarray, "m t"], sources: int) -> SignalSubspace:
    """Return the K largest eigenvalues of R̂ = Y·Yᴴ/T and their eigenvectors.

    They are computed from the singular values of Y, which avoids squaring the condition number. The phase of each
    vector is fixed so that its entry of largest modulus is real and positive. Raises Incompatible if there are fewer
    snapshots T than sources K, and ValueError if there are fewer antennas M or if Y is not finite.

    Y: received data, shape (M, T).
    sources: number K of sources.
    """
    M, T = Y.shape
    if sources > T:
        text = f"snapshots: expected at least {sources} for the signal subspace of {sources} sources, got {T}"
        raise Incompatible(text)
    if not 1 <= sources <= M:
        raise ValueError(f"sources: expected a number from 1 to M = {M}, got {sources}")
    if not np.isfinite(Y).all():
        raise ValueError("Y: expected finite data, got NaN or infinite entries")
    vectors, values, _ = np.linalg.svd(compress(Y), full_matrices=False)
    U, eigenvalues = vectors[:, :sources], values[:sources] ** 2 / T
    pivots = U[np.argmax(np.abs(U), axis=0), np.arange(sources)]
    noise = float(np.sum(values[sources:] ** 2)) / T / max(M - sources, 1)
    return SignalSubspace(U * (pivots.conj() / np.abs(pivots)), eigenvalues, noise)
