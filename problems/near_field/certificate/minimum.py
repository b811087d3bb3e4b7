"""T6: where J has one minimum only, from its Hessian and a bound of its third derivative."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from .balls import BallBounds, Charted
from .couplings import Couplings

__all__ = ["Expansion", "distance_expansion", "distance_third", "misfit_expansion", "misfit_third"]


@dataclass(frozen=True, eq=False)
class Expansion:
    """The value, the gradient (n,) and the Hessian (n, n) of J, or of D, at t = 0."""

    value: float
    gradient: Float[ndarray, " n"]
    hessian: Float[ndarray, "n n"]


def misfit_expansion(sources: Charted, U: Complex[ndarray, "m k"]) -> Expansion:
    """Return J = ‖(I − P_A)U‖² with its derivatives by the t of all sources."""
    K, d, M = sources.g.shape
    A, D = sources.a.T, sources.first.reshape(K * d, M).T
    Gamma = np.linalg.inv(A.conj().T @ A)
    pinv = Gamma @ A.conj().T  # A⁺, row c_k for each source
    residual = U - A @ (pinv @ U)
    P_D = D - A @ (pinv @ D)  # d_i = P⊥D_i
    W = P_D - U @ (U.conj().T @ P_D)  # P⊥_U d_i
    c_W, c_D = pinv @ W, pinv @ D  # (K, n): c_k P⊥_U d_i and c_k D_i
    k = np.repeat(np.arange(K), d)
    gradient = 2 * c_W[k, np.arange(K * d)].real
    c_U = pinv - (pinv @ U) @ U.conj().T  # c_k P⊥_U
    H = -c_W[k] * c_D[k].T - c_W[k].T * c_D[k]
    H += (P_D.conj().T @ W).T * Gamma[k][:, k]
    H -= (P_D.conj().T @ P_D).T * (c_U @ pinv.conj().T)[k][:, k]
    z = c_U - (c_U @ A) @ pinv  # c_k P⊥_U P⊥
    own = np.einsum("km,kijm->kij", z, sources.second)
    for j in range(K):
        block = slice(j * d, (j + 1) * d)
        H[block, block] += own[j]
    return Expansion(float(np.vdot(residual, residual).real), gradient, 2 * H.real)


def misfit_third(bounds: BallBounds, found: Couplings, limits: tuple[float, float], J: float, r: float) -> float:
    """Return a bound of |J'''| within ‖t‖ <= r of the centres along unit directions; inf if there is none.

    limits: of the eigenvalues of G. J: its value at the centres; √J grows by no more than ∫‖X‖.
    """
    smallest, largest = limits
    if smallest <= 0:
        return math.inf
    mu = 1 / math.sqrt(smallest)
    gamma = max(1 / smallest - 1, 1 - 1 / largest)
    n1, m2, n2, n3 = (float(np.max(bound)) for bound in (bounds.n1, bounds.m2, bounds.n2, bounds.n3))
    y = mu * math.sqrt(np.max(np.sum(found.first**2, axis=0)))
    v2 = math.sqrt(np.max(np.sum(found.second**2, axis=0))) + float(np.max(found.mixed))
    X, N = mu * n1, mu * n2 + 2 * mu**2 * n1 * y
    Omega = (
        mu * n3 + 3 * mu**3 * n1 * (v2 + y**2) + 3 * mu**2 * n2 * y + 6 * mu**3 * n1 * y**2 + 3 * mu**3 * n1**3
    )  # ‖O‖
    XN = min(X * N, n1 * m2 + gamma * n1 * n2 + y * n2 + 2 * mu**3 * n1**2 * y)
    root = math.sqrt(J) + r * X
    return 6 * XN + 12 * root**2 * X * N + 2 * root * Omega


def distance_expansion(sources: Charted, U: Complex[ndarray, "m k"]) -> list[Expansion]:
    """Return D = 1 − ‖Uᴴâ‖² of each source with its derivatives by t."""
    b = sources.a @ U.conj()
    b1, b2 = sources.first @ U.conj(), sources.second @ U.conj()
    D = 1 - np.sum(np.abs(b) ** 2, axis=1)
    gradient = -2 * np.einsum("bk,bik->bi", b.conj(), b1).real
    H = -2 * (b1.conj() @ b1.swapaxes(1, 2) + np.einsum("bk,bijk->bij", b.conj(), b2)).real
    return [Expansion(*parts) for parts in zip(D.tolist(), gradient, H, strict=True)]


def distance_third(bounds: BallBounds, D: Float[ndarray, " b"], rho: Float[ndarray, " b"]) -> Float[ndarray, " b"]:
    """Return bounds of |D'''| within ρ of the centres along unit directions.

    D''' = 2Re(3â'ᴴP⊥_U â'' + âᴴP⊥_U â'''), Re â'ᴴâ'' = mean(ψ'ψ''), and ‖P⊥_U â‖ <= √D + ρn₁.
    """
    root = np.sqrt(np.maximum(D, 0.0)) + rho * bounds.n1
    third: ndarray = 6 * (bounds.n1 * bounds.m2 + bounds.u1 * bounds.n2) + 2 * root * bounds.n3
    return third
