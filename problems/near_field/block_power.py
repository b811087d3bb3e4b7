"""Block power iteration on the data for their signal subspace."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

__all__ = ["fix_phases", "power_iteration"]

STEPS = 8
SLOW = 0.05  # λ_{K+1}/λ_K above which the Gram matrix is faster
SETTLED = 1e-7  # r/(λ_K − λ_{K+1}), whose square is the error of the Ritz pairs, below which they are not renewed
FAINT = 1e-12  # λ_K/λ_1 below which products with Y carry too much of the rounding errors of λ_1


def power_iteration(
    Y: Complex[ndarray, "m t"], start: Complex[ndarray, "p t"], K: int, angle: float
) -> tuple[bool, Complex[ndarray, "k m"], Float[ndarray, " k"]]:
    """Whether the iteration converged, the K leading left singular vectors of Y, one per row, and their σ² (K,).

    Each step has the Ritz pairs (λ, QV) of a block of p > K vectors. Their residuals r = ‖YYᴴQV − QVΛ‖ bound the angle
    to the eigenvectors by r over the gap of the eigenvalues; the power step that gave the residuals reduces it by up to
    4λ_{K+1}/λ_K more. If the single vectors are less accurate than their span, the Ritz pairs after it are returned.
    """
    Q = start @ Y.T  # one vector per row
    last, converged = np.inf, False
    for step in range(STEPS + 1):
        Q = np.linalg.qr(Q.T).Q.T
        Z = Q.conj() @ Y  # QᴴY
        values, V = np.linalg.eigh(Z @ Z.conj().T)
        values, V = values[::-1], V[:, ::-1]
        if converged:
            Q = V.T @ Q
            break
        Ritz, Q = V.T @ Q, V.T @ (Z.conj() @ Y.T)  # QV, and YYᴴQV
        if not (values[K] <= SLOW * values[K - 1] and values[K - 1] > FAINT * values[0]):
            break
        gap = values[K - 1] - values[K]
        residual = float(np.linalg.norm(Q[:K] - Ritz[:K] * values[:K, None]))
        if residual * min(1.0, 4.0 * values[K] / values[K - 1]) <= angle * gap:
            converged = True
            if residual <= SETTLED * gap:
                Q = np.linalg.qr(Q.T).Q.T
                break
        elif residual * (residual / last) ** (STEPS - 1 - step) > angle * gap:
            break
        last = residual
    return converged, Q[:K], values[:K]


def fix_phases(U: Complex[ndarray, "m k"]) -> Complex[ndarray, "m k"]:
    """The columns of U with phases such that the entry of largest modulus is real and positive."""
    pivots = U[np.argmax(np.abs(U), axis=0), np.arange(U.shape[1])]
    fixed: ndarray = U * (pivots.conj() / np.abs(pivots))
    return fixed
