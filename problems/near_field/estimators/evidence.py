"""The evidence of sparse Bayesian learning: powers on a grid, and positions off the grid."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray
from scipy.linalg import solve_triangular

from ..objectives.rls import RLS
from ..wavefronts import Manifold
from .refinement import refine

__all__ = ["Evidence", "evidence", "refine_evidence"]

LEAST_NOISE = 1e-10  # power of the noise relative to that of the data, below which it is not estimated
SWEEPS = 100  # of the refinement
GAIN = 1e-7  # of the evidence in a sweep, per snapshot, below which the refinement ends


@final
class Evidence:
    """The powers γ of the points of a grid, updated towards a maximum of −ln|Σ| − tr(Σ⁻¹R̂), Σ = σ²I + AΓAᴴ.

    L: factor of the sample covariance, R̂ = L·Lᴴ, shape (M, c).
    A: responses of the points, shape (M, P).
    sources: number K of peaks.
    coherence: coherence of neighbours on the grid.

    kept: indices of the points that are left. gamma: their powers. peaks: indices of the K highest peaks in these.
    noise: σ².
    """

    def __init__(self, L: Complex[ndarray, "m c"], A: Complex[ndarray, "m p"], sources: int, coherence: float) -> None:
        self._L, self._A, self._sources, self._same = L, A, sources, coherence**2
        self._power = float(np.vdot(L, L).real) / len(L) or 1.0  # of an element
        self._sizes = np.sum(A.real**2 + A.imag**2, axis=0)
        beams = np.sum(np.abs(A.conj().T @ L) ** 2, axis=1)  # a_pᴴR̂a_p
        self.kept: Int[ndarray, " n"] = np.flatnonzero(self._sizes > 0)
        self.gamma: Float[ndarray, " n"] = beams[self.kept] / self._sizes[self.kept] ** 2
        shares = self.gamma * self._sizes[self.kept]
        self.gamma *= float(np.vdot(L, L).real) / max(float(shares.sum()), np.finfo(float).tiny)
        self.noise = 0.1 * self._power
        self.peaks: Int[ndarray, " k"] = np.argsort(-self.gamma, kind="stable")[:sources]

    def update(self, prune: float) -> float:
        """Update all powers and σ² once, and drop weak points; return the change relative to the sum of the powers."""
        A, gamma = self._A[:, self.kept], self.gamma
        q, s = _quality_and_sparsity(_covariance(A, gamma, self.noise), self._L, A)
        new = gamma * np.divide(q, s, out=np.zeros_like(q), where=s > 0)
        total = float(new.sum())
        change = float(np.abs(new - gamma).sum()) / total if total > 0 else 0.0
        strong = new >= prune * new.max()
        self.kept, self.gamma = self.kept[strong], new[strong]
        self.peaks = self._find_peaks()
        Q = np.linalg.qr(self._A[:, self.kept[self.peaks]]).Q
        left = self._L - Q @ (Q.conj().T @ self._L)  # σ² = tr((I − P_A)R̂)/(M − K)
        free = max(len(left) - Q.shape[1], 1)
        self.noise = max(float(np.vdot(left, left).real) / free, LEAST_NOISE * self._power)
        return change

    def _find_peaks(self) -> Int[ndarray, " k"]:
        """Return the points that are not lower than any neighbour, the highest first, completed by the others."""
        order = np.argsort(-self.gamma, kind="stable")
        A = self._A[:, self.kept] / np.sqrt(self._sizes[self.kept])
        peaks: list[int] = []
        for i in order:
            if len(peaks) == self._sources:
                break
            alike = np.abs(A[:, i].conj() @ A) >= self._same
            if self.gamma[i] >= self.gamma[alike].max():
                peaks.append(int(i))
        rest = [int(i) for i in order if i not in set(peaks)]
        return np.array(peaks + rest[: self._sources - len(peaks)], dtype=np.int64)


def evidence(
    L: Complex[ndarray, "m c"], A: Complex[ndarray, "m n"], gamma: Float[ndarray, " n"], noise: float
) -> float:
    """Return −ln|Σ| − tr(Σ⁻¹R̂), the logarithm of the evidence per snapshot, up to a constant."""
    C = np.linalg.cholesky(_covariance(A, gamma, noise))
    return -2 * float(np.sum(np.log(np.diag(C).real))) - float(np.linalg.norm(solve_triangular(C, L, lower=True))) ** 2


def refine_evidence(
    L: Complex[ndarray, "m c"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, "k d"],
    gamma: Float[ndarray, " k"],
    noise: float,
) -> Float[ndarray, "k d"]:
    """Return sources (K, d) of a local maximum of the evidence over positions, powers and σ², found from ``theta``.

    With Σ₋ the covariance without a source, q = aᴴΣ₋⁻¹R̂Σ₋⁻¹a and s = aᴴΣ₋⁻¹a, its best power is (q − s)/s², or 0, and
    the evidence rises with q/s. With Σ₋ = C·Cᴴ, q/s is ‖ãᴴL̃‖²/‖ã‖² of whitened responses ã = C⁻¹a and data L̃ = C⁻¹L,
    which RLS of these minimizes (Tipping & Faul 2003).
    """
    theta, gamma = theta.copy(), gamma.copy()
    power = float(np.vdot(L, L).real) / len(L) or 1.0
    before = -np.inf
    for _ in range(SWEEPS):
        for k in range(len(theta)):
            others = np.delete(theta, k, axis=0)
            S = _covariance(manifold.response(others).T, np.delete(gamma, k), noise)
            C = np.linalg.cholesky(S)
            whitened, seen = solve_triangular(C, L, lower=True), _seen_through(C, manifold)
            theta[k] = refine(RLS(whitened, seen, lower, upper), theta[k], seen)
            q, s = _quality_and_sparsity(S, L, manifold.response(theta[k])[:, None])
            gamma[k] = max(float(q[0] - s[0]), 0.0) / float(s[0]) ** 2
        A = manifold.response(theta).T
        Q = np.linalg.qr(A).Q
        left = L - Q @ (Q.conj().T @ L)
        free = max(len(left) - Q.shape[1], 1)
        noise = max(float(np.vdot(left, left).real) / free, LEAST_NOISE * power)
        after = evidence(L, A, gamma, noise)
        if not after - before > GAIN:
            break
        before = after
    return theta


def _covariance(A: Complex[ndarray, "m n"], gamma: Float[ndarray, " n"], noise: float) -> Complex[ndarray, "m m"]:
    """Return Σ = σ²I + AΓAᴴ."""
    S: Complex[ndarray, "m m"] = (A * gamma) @ A.conj().T
    S[np.diag_indices(len(S))] += noise
    return S


def _quality_and_sparsity(
    S: Complex[ndarray, "m m"], L: Complex[ndarray, "m c"], A: Complex[ndarray, "m n"]
) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Return q = aᴴΣ⁻¹R̂Σ⁻¹a and s = aᴴΣ⁻¹a of each response a, a column of A."""
    C = np.linalg.cholesky(S)
    B = solve_triangular(C, A, lower=True)  # C⁻¹a
    D = B.conj().T @ solve_triangular(C, L, lower=True)
    return np.sum(D.real**2 + D.imag**2, axis=1), np.sum(B.real**2 + B.imag**2, axis=0)


def _seen_through(C: Complex[ndarray, "m m"], manifold: Manifold) -> Manifold:
    """Return the manifold of the responses C⁻¹a."""
    W = np.eye(len(C), dtype=np.complex128) if manifold.weights is None else manifold.weights
    W = np.diag(W) if W.ndim == 1 else W
    return replace(manifold, weights=solve_triangular(C, W, lower=True))
