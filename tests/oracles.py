"""Straightforward implementations of the printed formulas, with which the fast code must agree."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from nfbench.problems.near_field.wavefronts import Manifold


def position(theta: ndarray) -> ndarray:
    """Return p = r·u [m] of one source [azimuth, range] or [azimuth, elevation, range] [rad, m]."""
    azimuth, r = theta[0], theta[-1]
    elevation = theta[1] if len(theta) == 3 else 0.0
    return r * np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def distance(wavefront: str, theta: ndarray, q: ndarray) -> float:
    """Return d_m [m] by the printed formulas."""
    p, r = position(theta), theta[-1]
    u = p / r
    match wavefront:
        case "exact":
            return float(np.linalg.norm(p - q))
        case "fresnel":
            return float(r - u @ q + (q @ q - (u @ q) ** 2) / (2 * r))
        case "paper":
            return float(r - u @ q + q @ q / (2 * r))
    return float(r - u @ q)


def response(manifold: Manifold, theta: ndarray) -> ndarray:
    """Return a_m = exp(jk(r − d_m)), shape (M,)."""
    k = 2 * np.pi / manifold.wavelength_m
    d = np.array([distance(manifold.wavefront, theta, q) for q in manifold.positions])
    return np.exp(1j * k * (theta[-1] - d))


def rls(Y: ndarray, a: ndarray) -> float:
    """Return ‖(I − P_a)Y‖²_F with an explicit projector."""
    P = np.outer(a, a.conj()) / (a.conj() @ a)
    return float(np.linalg.norm((np.eye(len(a)) - P) @ Y) ** 2)


def esf(U_s: ndarray, A: ndarray) -> float:
    """Return ‖(I − P_A)U_s‖²_F with P_A = A·A⁺; A has shape (M, K)."""
    return float(np.linalg.norm(U_s - A @ (np.linalg.pinv(A) @ U_s)) ** 2)


def repulsion(theta: ndarray, detected: ndarray, alpha: float, delta_min: float) -> float:
    """Return Σ_i α·max(0, δ_min − ‖θ − θ_i‖)."""
    return sum(alpha * max(0.0, delta_min - float(np.linalg.norm(theta - other))) for other in detected)


def central_difference(f, x: ndarray, steps: ndarray) -> ndarray:
    """Return ∂f/∂x_i along the first axis, by central differences with the given steps."""
    rows = []
    for i, h in enumerate(steps):
        e = np.zeros(len(x))
        e[i] = h
        rows.append((f(x + e) - f(x - e)) / (2 * h))
    return np.array(rows)


def position_bounds(manifold: Manifold, theta: ndarray, snr_db: float, snapshots: int) -> ndarray:
    """Return the stochastic Cramér–Rao bound on each source's position [m] in the plane, for equal SNRs."""
    K = len(theta)
    a, derivatives = manifold.response_and_derivatives(theta)
    A, D = a.T, np.concatenate([derivatives[:, 0], derivatives[:, 1]]).T  # all azimuths, followed by all ranges
    M = len(A)
    projector = np.eye(M) - A @ np.linalg.inv(A.conj().T @ A) @ A.conj().T
    P = 10 ** (snr_db / 10) * np.eye(K)
    R = A @ P @ A.conj().T + np.eye(M)
    X = P @ A.conj().T @ np.linalg.inv(R) @ A @ P
    C = np.linalg.inv(((D.conj().T @ projector @ D) * np.tile(X, (2, 2)).T).real) / (2 * snapshots)
    variance = np.diag(C)
    return np.sqrt(theta[:, 1] ** 2 * variance[:K] + variance[K:])
