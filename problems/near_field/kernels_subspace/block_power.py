"""Block power iteration on the data for their signal subspace."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import compiled

__all__ = ["fix_phases", "power_iteration"]

STEPS = 8
SLOW = 0.05  # λ_{K+1}/λ_K above which the Gram matrix is faster
SETTLED = 1e-7  # r/(λ_K − λ_{K+1}), whose square is the error of the Ritz pairs, below which they are not renewed
FAINT = 1e-12  # λ_K/λ_1 below which products with Y carry too much of the rounding errors of λ_1


@compiled()
def _orthonormalize(Q: Complex[ndarray, "p m"]) -> None:
    """The rows of Q by Gram–Schmidt, twice; a row of zeros stays one."""
    for i in range(len(Q)):
        for repeated in range(3):
            square = 0.0
            for m in range(Q.shape[1]):
                square += Q[i, m].real * Q[i, m].real + Q[i, m].imag * Q[i, m].imag
            scale = 1.0 / np.sqrt(square) if square > 0.0 else 0.0
            for m in range(Q.shape[1]):
                Q[i, m] *= scale
            if repeated == 2:
                break
            for k in range(i):
                s = complex(0.0, 0.0)
                for m in range(Q.shape[1]):
                    s += Q[k, m].conjugate() * Q[i, m]
                for m in range(Q.shape[1]):
                    Q[i, m] -= s * Q[k, m]


@compiled()
def _conjugate(a: Complex[ndarray, "i j"], out: Complex[ndarray, "i j"]) -> None:
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j].conjugate()


@compiled()
def _combine(V: Complex[ndarray, "p p"], a: Complex[ndarray, "p m"], out: Complex[ndarray, "p m"]) -> None:
    """Row i of ``out`` is Σ_j V_{j,p−1−i}·a_j: the combination of the i-th largest eigenvalue."""
    p = len(a)
    for i in range(p):
        for m in range(a.shape[1]):
            out[i, m] = V[0, p - 1 - i] * a[0, m]
        for j in range(1, p):
            v = V[j, p - 1 - i]
            for m in range(a.shape[1]):
                out[i, m] += v * a[j, m]


@compiled()
def _residual(W: Complex[ndarray, "p m"], Q: Complex[ndarray, "p m"], values: Float[ndarray, " p"], K: int) -> float:
    """‖W − QΛ‖ of the first K rows; ``values`` are in ascending order."""
    total = 0.0
    for k in range(K):
        for m in range(W.shape[1]):
            e = W[k, m] - Q[k, m] * values[len(values) - 1 - k]
            total += e.real * e.real + e.imag * e.imag
    return np.sqrt(total)


@compiled()
def power_iteration(
    Y: Complex[ndarray, "m t"], start: Complex[ndarray, "p t"], K: int, angle: float
) -> tuple[bool, Complex[ndarray, "k m"], Float[ndarray, " k"]]:
    """Whether the iteration converged, the K leading left singular vectors of Y, one per row, and their σ² (K,).

    Each step has the Ritz pairs (λ, QV) of a block of p > K vectors. Their residuals r = ‖YYᴴQV − QVΛ‖ bound the angle
    to the eigenvectors by r over the gap of the eigenvalues; the power step that gave the residuals reduces it by up to
    4λ_{K+1}/λ_K more. If the single vectors are less accurate than their span, the Ritz pairs after it are returned.
    """
    M, p = len(Y), len(start)
    Q, W, conjugate = np.dot(start, Y.T), np.empty((p, M), np.complex128), np.empty((p, M), np.complex128)
    Z, Zc = np.empty((p, Y.shape[1]), np.complex128), np.empty((p, Y.shape[1]), np.complex128)
    last, converged = np.inf, False
    values, V = np.empty(p), np.empty((p, p), np.complex128)
    for step in range(STEPS + 1):
        _orthonormalize(Q)
        _conjugate(Q, conjugate)
        np.dot(conjugate, Y, Z)  # Z = QᴴY
        _conjugate(Z, Zc)
        values, V = np.linalg.eigh(np.dot(Z, Zc.T))
        if converged:
            _combine(V, Q, W)
            break
        np.dot(Zc, Y.T, W)  # Wᵀ with W = YZᴴ = YYᴴQ
        _combine(V, Q, conjugate)
        _combine(V, W, Q)
        if not (values[p - K - 1] <= SLOW * values[p - K] and values[p - K] > FAINT * values[p - 1]):
            break
        residual = _residual(Q, conjugate, values, K)
        allowed = angle * (values[p - K] - values[p - K - 1])
        if residual * min(1.0, 4.0 * values[p - K - 1] / values[p - K]) <= allowed:
            converged = True
            if residual <= SETTLED * (values[p - K] - values[p - K - 1]):
                _orthonormalize(Q)
                W[:K] = Q[:K]
                break
        elif residual * (residual / last) ** (STEPS - 1 - step) > allowed:
            break
        last = residual
    found = np.empty(K)
    for k in range(K):
        found[k] = values[p - 1 - k]
    return converged, W[:K], found


@compiled()
def fix_phases(U: Complex[ndarray, "m k"]) -> Complex[ndarray, "m k"]:
    """The columns of U with phases such that the entry of largest modulus is real and positive."""
    fixed = np.empty(U.shape, np.complex128)
    for k in range(U.shape[1]):
        largest, pivot = -1.0, complex(1.0, 0.0)
        for m in range(len(U)):
            square = U[m, k].real * U[m, k].real + U[m, k].imag * U[m, k].imag
            if square > largest:
                largest, pivot = square, U[m, k]
        turn = pivot.conjugate() * (1.0 / abs(pivot))
        for m in range(len(U)):
            fixed[m, k] = U[m, k] * turn
    return fixed
