"""RLS and ESF in vectorized NumPy, with which the kernels are compared in tests and benchmarks."""

from __future__ import annotations

import numpy as np
from numpy import ndarray
from scipy.linalg import solve_triangular

from nfbench import Problem
from nfbench.problems.near_field.geometry import directions
from nfbench.problems.near_field.subspace import compress
from nfbench.problems.near_field.wavefronts import Manifold

RIDGE = 1e-13  # the least pivot of Cholesky's factorization, relative to M


def respond(manifold: Manifold, theta: ndarray) -> ndarray:
    """Return the response vectors (*p, M) of sources (*p, d) [rad, m], one per row."""
    s, r, w = directions(theta) @ manifold.positions.T, theta[..., -1:], np.sum(manifold.positions**2, axis=1)
    match manifold.wavefront:
        case "exact":
            numerator = 2 * r * s - w
            advance = numerator / (r + np.sqrt(np.maximum(r * r - numerator, 0)))
        case "fresnel":
            advance = s - (w - s * s) / (2 * r)
        case "paper":
            advance = s - w / (2 * r)
        case _:
            advance = s
    phase = (2 * np.pi / manifold.wavelength_m) * advance
    a = np.empty(phase.shape, dtype=np.complex128)
    np.cos(phase, out=a.real)
    np.sin(phase, out=a.imag)
    return a


class NumPyRLS(Problem):
    """J(θ) = ‖(I − P_a)Y‖²_F + repulsion, computed with one matrix product for all points."""

    has_gradient = True

    def __init__(
        self,
        Y: ndarray,
        manifold: Manifold,
        lower: ndarray,
        upper: ndarray,
        *,
        detected: ndarray | None = None,
        alpha: float = 1000.0,
        delta_min: float = 0.08,
        alpha_relative: float | None = None,
    ) -> None:
        self.lower, self.upper = lower, upper
        self.manifold = manifold
        self.conj_L = np.ascontiguousarray(compress(Y).conj())
        self.energy = float(np.vdot(Y, Y).real)
        self.detected = np.empty((0, manifold.dimension)) if detected is None else detected
        self.alpha = alpha if alpha_relative is None else alpha_relative * self.energy / manifold.elements
        self.delta_min = delta_min

    def evaluate(self, X: ndarray) -> ndarray:
        b = respond(self.manifold, X) @ self.conj_L
        residual = np.maximum(self.energy - np.vecdot(b, b).real / self.manifold.elements, 0.0)
        return residual + self.repulsion(X) if len(self.detected) else residual

    def value(self, x: ndarray) -> float:
        b = respond(self.manifold, x) @ self.conj_L
        residual = max(self.energy - float(np.vdot(b, b).real) / self.manifold.elements, 0.0)
        return residual + float(self.repulsion(x[None])[0]) if len(self.detected) else residual

    def value_and_gradient(self, x: ndarray) -> tuple[float, ndarray]:
        a, D = self.manifold.response_and_derivatives(x[None])
        b = a[0] @ self.conj_L
        c = self.conj_L @ b.conj()  # conjugate of LLᴴa
        gradient = -2 / self.manifold.elements * (D[0] @ c).real
        away = x - self.detected
        distance = np.linalg.norm(away, axis=1)
        near = (distance > 0) & (distance < self.delta_min)
        gradient -= self.alpha * np.sum(away[near] / distance[near, None], axis=0)
        return self.value(x), gradient

    def repulsion(self, X: ndarray) -> ndarray:
        distance = np.linalg.norm(X[:, None] - self.detected, axis=-1)
        return self.alpha * np.sum(np.maximum(0.0, self.delta_min - distance), axis=1)


class NumPyESF(Problem):
    """J(x) = K − tr(BᴴG⁻¹B), computed with one batched Cholesky factorization for all points."""

    has_gradient = True

    def __init__(
        self, U_s: ndarray, manifold: Manifold, lower: ndarray, upper: ndarray, sources: int | None = None
    ) -> None:
        self.sources = U_s.shape[1]
        if sources not in (None, self.sources):
            raise ValueError(f"sources: expected as many as columns of U_s, {self.sources}, got {sources}")
        self.lower, self.upper = np.tile(lower, self.sources), np.tile(upper, self.sources)
        self.manifold = manifold
        self.U_s, self.conj_U_s = U_s, np.ascontiguousarray(U_s.conj())

    def evaluate(self, X: ndarray) -> ndarray:
        p, K, M = len(X), self.sources, self.manifold.elements
        A = respond(self.manifold, X.reshape(-1, self.manifold.dimension))  # one response per row
        B = (A @ self.conj_U_s).conj()
        _, W = whiten(A.reshape(p, K, M), B.reshape(p, K, K))
        return np.maximum(K - np.sum(W.real**2 + W.imag**2, axis=(0, 2)), 0.0)

    def value_and_gradient(self, x: ndarray) -> tuple[float, ndarray]:
        A, D = self.manifold.response_and_derivatives(x.reshape(self.sources, -1))
        L, W = whiten(A[None], (A.conj() @ self.U_s)[None])
        value = max(self.sources - float(np.vdot(W, W).real), 0.0)
        C = solve_triangular(L[:, :, 0], W[:, 0], lower=True, trans="C")  # A⁺U_s = G⁻¹B
        V = self.U_s - A.T @ C  # (I − P_A)U_s
        return value, -2 * np.einsum("kdm,mk->kd", D, V.conj() @ C.T).real.ravel()


def whiten(A: ndarray, B: ndarray) -> tuple[ndarray, ndarray]:
    """Return L (K, K, p) and W = L⁻¹B (K, p, K) with G = AᴴA = LLᴴ; A is (p, K, M), B is (p, K, K).

    Pivots are at least RIDGE·M.
    """
    p, K, M = A.shape
    L = np.zeros((K, K, p), dtype=np.complex128)
    W = np.empty((K, p, B.shape[2]), dtype=np.complex128)
    for j in range(K):
        pivot = np.full(p, float(M))
        rest = B[:, j].copy()
        for k in range(j):
            g = np.vecdot(A[:, j], A[:, k])
            L[j, k] = (g - np.sum(L[j, :k] * L[k, :k].conj(), axis=0)) / L[k, k]
            pivot -= L[j, k].real ** 2 + L[j, k].imag ** 2
            rest -= L[j, k][:, None] * W[k]
        L[j, j] = root = np.sqrt(np.maximum(pivot, RIDGE * M))
        W[j] = rest / root[:, None]
    return L, W
