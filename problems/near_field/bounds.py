"""Cramér–Rao bounds: the least error that an unbiased estimator of the sources can have.

Both are C = (σ²/2T)·{Re[(DᴴΠ⊥D) ⊙ Xᵀ]}⁻¹ with σ² = 1, D the derivatives of the responses, Π⊥ = I − A(AᴴA)⁻¹Aᴴ, and
element (k, l) of the K×K matrix X at each pair of parameters of sources k and l. They hold for data Y = A·S + N, pure
line of sight, with the number of sources known, and know nothing of a box that estimates are searched in.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import solve_triangular

from .wavefronts import Manifold

__all__ = ["deterministic_bound", "information_root", "position_bounds", "stochastic_bound"]

CERTAIN = 100
"""How many times its rounding error the rest of a projected derivative must be, or the bound is infinite.

So sources count as coincident once their bound would be off by more than about 1 %, when it has long exceeded any
range: at the paper's size, some 1e-7 rad apart."""


def stochastic_bound(
    manifold: Manifold, theta: Float[ndarray, "k d"], snr: Float[ndarray, " k"], snapshots: int
) -> Float[ndarray, "kd kd"]:
    """The bound on the covariance of θ̂, in the order of ``theta.ravel()`` [rad, m], for random symbols.

    Symbols are circular Gaussian and uncorrelated, of power ``snr`` over the noise, but neither this nor the power of
    the noise is known to the estimator: X = PAᴴR⁻¹AP with R = APAᴴ + I, P = diag(snr) (Stoica & Nehorai 1990,
    doi:10.1109/29.60109; derived directly by Stoica, Larsson & Gershman 2001). All is inf where
    the sources cannot be told from the data, as where two coincide, or the range in a planar wavefront.
    """
    amplitude = np.sqrt(snr)
    _, s, Vh = np.linalg.svd(manifold.response(theta).T * amplitude, full_matrices=False)
    # with AP½ = U·s·Vᴴ: X = P½V·s²/(1 + s²)·VᴴP½, the square of this factor, which subtracts nothing
    factor = amplitude[:, None] * Vh.conj().T * (s / np.sqrt(1 + s * s))
    return _covariance(manifold, theta, factor, snapshots)


def deterministic_bound(
    manifold: Manifold, theta: Float[ndarray, "k d"], symbols: Complex[ndarray, "k t"]
) -> Float[ndarray, "kd kd"]:
    """The bound on the covariance of θ̂, in the order of ``theta.ravel()`` [rad, m], for these symbols, unknown.

    symbols: S with its amplitudes, √snr_k times a unit-variance symbol: X = SSᴴ/T (Stoica & Nehorai 1989,
    doi:10.1109/29.17564). All is inf where the sources cannot be told from the data.
    """
    T = symbols.shape[1]
    return _covariance(manifold, theta, np.linalg.qr(symbols.conj().T).R.conj().T / math.sqrt(T), T)


def position_bounds(covariance: Float[ndarray, "kd kd"], theta: Float[ndarray, "k d"]) -> Float[ndarray, " k"]:
    """√(r²cos²ψ·C_φφ + r²·C_ψψ + C_rr) [m] of each source: the bound on its Cartesian root mean square error."""
    variance = np.diag(covariance).reshape(theta.shape)
    metres = np.ones_like(theta)  # per unit of each parameter
    metres[:, :-1] = theta[:, -1:]
    if theta.shape[1] == 3:
        metres[:, 0] *= np.cos(theta[:, 1])
    bounds: ndarray = np.sqrt(np.sum(metres**2 * variance, axis=1))
    return bounds


def information_root(
    manifold: Manifold, theta: Float[ndarray, "k d"], factor: Complex[ndarray, "k c"]
) -> tuple[Float[ndarray, "rows kd"], Float[ndarray, " kd"]]:
    """J with JᵀJ = Re[(DᴴΠ⊥D) ⊙ Xᵀ] for X = ``factor``·``factor``ᴴ, and the rounding errors of its columns.

    Π⊥ is never formed and nothing is squared: in [A D] = QR, the lower right block of R is a factor of DᴴΠ⊥D. The
    errors grow as the least pivot of A shrinks, as two sources approach.
    """
    K, d = theta.shape
    a, derivatives = manifold.response_and_derivatives(theta)
    D = derivatives.reshape(K * d, -1).T
    R = np.linalg.qr(np.hstack([a.T, D])).R
    per_parameter = np.repeat(factor, d, axis=0)  # X_kl at each pair of parameters of sources k and l
    J = (R[K:, K:] * per_parameter.T[:, None]).reshape(-1, K * d)
    pivots = np.abs(np.diag(R)[:K])
    with np.errstate(divide="ignore"):
        rounding = np.finfo(np.float64).eps * pivots.max() / pivots.min()
    size = np.linalg.norm(D, axis=0) * np.linalg.norm(per_parameter, axis=1)
    return np.vstack([J.real, J.imag]), rounding * size


def _covariance(
    manifold: Manifold, theta: Float[ndarray, "k d"], factor: Complex[ndarray, "k c"], snapshots: int
) -> Float[ndarray, "kd kd"]:
    J, rounding = information_root(manifold, theta, factor)
    R = np.linalg.qr(J).R
    n = len(rounding)
    if len(R) < n or not (np.abs(np.diag(R)) > CERTAIN * rounding).all():
        return np.full((n, n), math.inf)
    inverse = solve_triangular(R, np.eye(n))
    covariance: ndarray = inverse @ inverse.T / (2 * snapshots)
    return covariance
