"""Reduction of the received data: a small factor of Y·Yᴴ, and the signal subspace."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

from nfbench import Incompatible

__all__ = ["compress", "signal_subspace"]


def compress(Y: Complex[ndarray, "m t"]) -> Complex[ndarray, "m c"]:
    """Return a factor L with c = min(M, T) columns and L·Lᴴ = Y·Yᴴ; from Yᴴ = QR, L = Rᴴ is lower triangular."""
    L: ndarray = np.linalg.qr(Y.conj().T).R.conj().T
    return L


def signal_subspace(Y: Complex[ndarray, "m t"], sources: int) -> Complex[ndarray, "m k"]:
    """Return the eigenvectors U_s of R̂ = Y·Yᴴ/T for its K largest eigenvalues as columns, in descending order.

    They are computed as left singular vectors of Y, which avoids squaring the condition number. The phase of each
    vector is fixed so that its entry of largest modulus is real and positive. Raises Incompatible if there are fewer
    snapshots T than sources K, and ValueError if there are fewer antennas M.

    Y: received data, shape (M, T).
    sources: number K of sources.
    """
    if sources > Y.shape[1]:
        text = f"snapshots: expected at least {sources} for the signal subspace of {sources} sources, got {Y.shape[1]}"
        raise Incompatible(text)
    if not 1 <= sources <= len(Y):
        raise ValueError(f"sources: expected a number from 1 to M = {len(Y)}, got {sources}")
    U = np.linalg.svd(compress(Y), full_matrices=False)[0][:, :sources]
    pivots = U[np.argmax(np.abs(U), axis=0), np.arange(sources)]
    U_s: ndarray = U * (pivots.conj() / np.abs(pivots))
    return U_s
