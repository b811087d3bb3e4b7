"""Received data, made small: the factor that keeps its energy, and the subspace that holds its signals."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

from nfbench import Incompatible

__all__ = ["compress", "signal_subspace"]


def compress(Y: Complex[ndarray, "m t"]) -> Complex[ndarray, "m c"]:
    """A factor L of c = min(M, T) columns with L·Lᴴ = Y·Yᴴ, from Yᴴ = QR: L = Rᴴ, zero above its diagonal."""
    L: ndarray = np.linalg.qr(Y.conj().T).R.conj().T
    return L


def signal_subspace(Y: Complex[ndarray, "m t"], sources: int) -> Complex[ndarray, "m k"]:
    """The eigenvectors U_s of R̂ = Y·Yᴴ/T to its K greatest eigenvalues, as columns, greatest first.

    Computed as left singular vectors of Y, which do not square its condition. The phase of each is fixed: its entry
    of greatest modulus is real and positive. Raises Incompatible with fewer snapshots T than sources K, ValueError
    with fewer antennas M.
    """
    if sources > Y.shape[1]:
        text = f"snapshots: expected at least {sources} for the signal subspace of {sources} sources, got {Y.shape[1]}"
        raise Incompatible(text)
    if not 1 <= sources <= len(Y):
        raise ValueError(f"sources: expected 1 to M = {len(Y)}, got {sources}")
    U = np.linalg.svd(compress(Y), full_matrices=False)[0][:, :sources]
    pivots = U[np.argmax(np.abs(U), axis=0), np.arange(sources)]
    U_s: ndarray = U * (pivots.conj() / np.abs(pivots))
    return U_s
