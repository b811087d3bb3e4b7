"""Reduction of the received data: a small factor of Y·Yᴴ, and the signal subspace."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import eigh
from scipy.linalg.blas import zherk

from nfbench import Incompatible

from .block_power import fix_phases, power_iteration

__all__ = ["SignalSubspace", "compress", "decompose", "signal_subspace"]

ANGLE = 1e-10  # to which a subspace agrees with that of the singular value decomposition
SMALL = 96  # least of M and T from which the power iteration is faster than the Gram matrix
SQUARED = 3.5e-15  # error of the eigenvalues of a Gram matrix, relative to λ_1
CANCELLED = 1e-8  # energy of the noise, relative to that of Y, below which it is not the difference of two energies


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

    They come from a block power iteration on Y, from the Gram matrix of its shorter side, or from the singular values
    of Y, whichever is the first to be certain to agree with the last to about 1e-10. The phase of each vector is fixed
    so that its entry of largest modulus is real and positive. Raises Incompatible if there are fewer snapshots T than
    sources K, and ValueError if there are fewer antennas M or if Y is not finite.

    Y: received data, shape (M, T).
    sources: number K of sources.
    """
    M, T = Y.shape
    if sources > T:
        text = f"snapshots: expected at least {sources} for the signal subspace of {sources} sources, got {T}"
        raise Incompatible(text)
    if not 1 <= sources <= M:
        raise ValueError(f"sources: expected a number from 1 to M = {M}, got {sources}")
    Y = np.ascontiguousarray(Y, dtype=np.complex128)
    energy = float(np.vdot(Y, Y).real)
    if not math.isfinite(energy) and not np.isfinite(Y).all():
        raise ValueError("Y: expected finite data, got NaN or infinite entries")
    U, squares = _by_power_iteration(Y, sources) or _by_gram_matrix(Y, sources) or _by_singular_values(Y, sources)
    noise = energy - float(squares.sum())
    if noise < CANCELLED * energy:  # most digits are lost
        noise = float(np.linalg.norm(Y - U @ (U.conj().T @ Y)) ** 2)
    return SignalSubspace(fix_phases(U), squares / T, noise / T / max(M - sources, 1))


_Found: TypeAlias = tuple[ndarray, ndarray] | None  # vectors (M, K) and squared singular values of Y (K,), descending


def _by_power_iteration(Y: Complex[ndarray, "m t"], K: int) -> _Found:
    """Block power iteration with Rayleigh–Ritz (Rutishauser 1969) on K + 2 vectors; None where it converges slowly."""
    M, T = Y.shape
    if min(M, T) < max(SMALL, K + 2):
        return None
    converged, vectors, squares = power_iteration(Y, _start(K + 2, T), K, ANGLE)
    return (vectors.T, squares) if converged else None


def _by_gram_matrix(Y: Complex[ndarray, "m t"], K: int) -> _Found:
    """Eigenvectors of YYᴴ, or of YᴴY if it is smaller; None where squaring Y costs too many digits."""
    M, T = Y.shape
    n = min(M, T)
    # zherk reads the row-major Y as its transpose: it returns conj(YYᴴ) or conj(YᴴY), one triangle of each
    G = zherk(1.0, Y.T, trans=2 if M <= T else 0)
    values, vectors = eigh(G, lower=False, subset_by_index=[max(n - K - 1, 0), n - 1], check_finite=False)
    values, vectors = values[::-1], vectors[:, ::-1].conj()
    following = values[K] if n > K else 0.0
    if not SQUARED * values[0] <= ANGLE * (values[K - 1] - following):
        return None
    vectors = vectors[:, :K]
    return (vectors if M <= T else np.linalg.qr(Y @ vectors).Q), values[:K]


def _by_singular_values(Y: Complex[ndarray, "m t"], K: int) -> tuple[ndarray, ndarray]:
    """Left singular vectors of Y, without squaring its condition number."""
    vectors, values, _ = np.linalg.svd(compress(Y), full_matrices=False)
    return vectors[:, :K], values[:K] ** 2


@lru_cache(maxsize=16)
def _start(p: int, T: int) -> Complex[ndarray, "p t"]:
    """Random phases, always the same ones: almost surely no signal is orthogonal to them."""
    turns = np.random.PCG64(0).random_raw(p * T) / 2.0**64
    return np.exp(2j * np.pi * turns).reshape(p, T)
