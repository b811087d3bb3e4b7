"""Cramér–Rao bounds: the smallest error that an unbiased estimator of the sources can have.

Both bounds are C = (σ²/2T)·{Re[(DᴴΠ⊥D) ⊙ Xᵀ]}⁻¹ with σ² = 1, where D contains the derivatives of the responses,
Π⊥ = I − A(AᴴA)⁻¹Aᴴ, and element (k, l) of the K×K matrix X is used for every pair of parameters of sources k and l.
They hold for data Y = A·S + N in pure line of sight with a known number of sources and white noise of unit power. A
contains what the estimator knows of gains, coupling and a whitening filter (``calibration``). They do not take into
account the box in which estimates are searched.

A bound is finite only if its rounding error is below about 1 %: the remainder of each projected derivative must exceed
its rounding error by the factor ``rounding.CERTAIN``. All elements are inf otherwise, which is the case

* if two sources coincide. At the size of the paper's array they are then about 1e-7 rad apart, and the bound is far
  larger than any range;
* if the data do not determine a parameter, as the azimuth and the range of a source on the axis of a line of elements;
* if a source lies on an element (``rounding.undefined``), where the exact wavefront has no derivatives. At any larger
  distance the bound is finite and right, although it depends on the side from which the source approaches the element.

A position has a bound also at a pole, where its azimuth has none, and next to the origin, where its angles have none.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import solve_triangular

from .rounding import CERTAIN, magnitudes, undefined
from .wavefronts import Manifold

__all__ = [
    "deterministic_bound",
    "information_root",
    "invert_information",
    "position_bounds",
    "root_of_deterministic",
    "root_of_stochastic",
    "stochastic_bound",
]


def stochastic_bound(
    manifold: Manifold,
    theta: Float[ndarray, "k d"],
    snr: Float[ndarray, " k"],
    snapshots: int,
    correlation: Complex[ndarray, "k k"] | None = None,
) -> Float[ndarray, "kd kd"]:
    """Return the bound on the covariance of θ̂, in the order of ``theta.ravel()`` [rad, m], for random symbols.

    The symbols are circular Gaussian; the estimator knows neither their covariance nor the power of the noise.
    X = PAᴴR⁻¹AP with R = APAᴴ + I and P = diag(√snr)·C·diag(√snr), C their correlation (Stoica & Nehorai 1990,
    doi:10.1109/29.60109; direct derivation by Stoica, Larsson & Gershman 2001). All elements are inf if the data do not
    determine the sources, for example if two sources coincide, if the wavefront is planar, so that the range is
    undetermined, or if a source lies on an element.

    manifold: array and wavefront model.
    theta: sources [rad, m], shape (K, d).
    snr: signal-to-noise power ratio per source at each antenna, shape (K,).
    snapshots: number T of snapshots.
    correlation: correlation matrix of the symbols, shape (K, K), which is singular for coherent sources; None: they are
        uncorrelated.
    """
    return invert_information(*root_of_stochastic(manifold, theta, snr, correlation), snapshots)


def deterministic_bound(
    manifold: Manifold, theta: Float[ndarray, "k d"], symbols: Complex[ndarray, "k t"]
) -> Float[ndarray, "kd kd"]:
    """Return the bound on the covariance of θ̂, in the order of ``theta.ravel()`` [rad, m], for given symbols.

    The estimator does not know the symbols. X = SSᴴ/T (Stoica & Nehorai 1989, doi:10.1109/29.17564). All elements are
    inf if the data do not determine the sources, or if a source lies on an element.

    manifold: array and wavefront model.
    theta: sources [rad, m], shape (K, d).
    symbols: symbols S including their amplitudes, √snr_k times a symbol of unit variance, shape (K, T).
    """
    return invert_information(*root_of_deterministic(manifold, theta, symbols), symbols.shape[1])


def position_bounds(covariance: Float[ndarray, "kd kd"], theta: Float[ndarray, "k d"]) -> Float[ndarray, " k"]:
    """Return the bound √(r²cos²ψ·C_φφ + r²·C_ψψ + C_rr) [m] on the Cartesian RMS error of each source.

    covariance: bound on the covariance of θ̂ [rad, m], shape (Kd, Kd).
    theta: sources [rad, m], shape (K, d).
    """
    variance = np.diag(covariance).reshape(theta.shape)
    metres = np.ones_like(theta)  # metres per unit of each parameter
    metres[:, :-1] = theta[:, -1:]
    if theta.shape[1] == 3:
        metres[:, 0] *= np.cos(theta[:, 1])
    bounds: ndarray = np.sqrt(np.sum(metres**2 * variance, axis=1))
    return bounds


def root_of_stochastic(
    manifold: Manifold,
    theta: Float[ndarray, "k d"],
    snr: Float[ndarray, " k"],
    correlation: Complex[ndarray, "k k"] | None = None,
) -> tuple[Float[ndarray, "rows kd"], Float[ndarray, " kd"]]:
    """Return the ``information_root`` of ``stochastic_bound``."""
    amplitude = np.sqrt(snr)
    A = manifold.response(theta).T
    # with P = B·Bᴴ and AB = U·s·Vᴴ, X = BV·s²/(1 + s²)·VᴴBᴴ = factor·factorᴴ; this form avoids cancellation
    if correlation is None:
        _, s, Vh = np.linalg.svd(A * amplitude, full_matrices=False)
        factor = amplitude[:, None] * Vh.conj().T * (s / np.sqrt(1 + s * s))
    else:
        values, vectors = np.linalg.eigh(correlation)
        B = amplitude[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        _, s, Vh = np.linalg.svd(A @ B, full_matrices=False)
        factor = B @ Vh.conj().T * (s / np.sqrt(1 + s * s))
    return information_root(manifold, theta, factor)


def root_of_deterministic(
    manifold: Manifold, theta: Float[ndarray, "k d"], symbols: Complex[ndarray, "k t"]
) -> tuple[Float[ndarray, "rows kd"], Float[ndarray, " kd"]]:
    """Return the ``information_root`` of ``deterministic_bound``."""
    T = symbols.shape[1]
    return information_root(manifold, theta, np.linalg.qr(symbols.conj().T).R.conj().T / math.sqrt(T))


def information_root(
    manifold: Manifold, theta: Float[ndarray, "k d"], factor: Complex[ndarray, "k c"]
) -> tuple[Float[ndarray, "rows kd"], Float[ndarray, " kd"]]:
    """Return J with JᵀJ = Re[(DᴴΠ⊥D) ⊙ Xᵀ] for X = ``factor``·``factor``ᴴ, and the rounding errors of its columns.

    Neither Π⊥ nor a product DᴴΠ⊥D is formed: with [A D] = QR, the lower right block of R is a factor of DᴴΠ⊥D. The
    errors grow as the smallest pivot of A decreases, which happens when two sources approach each other. They are inf
    if a source lies on an element.
    """
    K, d = theta.shape
    a, derivatives = manifold.response_and_derivatives(theta)
    D = derivatives.reshape(K * d, -1).T
    R = np.linalg.qr(np.hstack([a.T, D])).R
    per_parameter = np.repeat(factor, d, axis=0)  # X_kl for every pair of parameters of sources k and l
    J = (R[K:, K:] * per_parameter.T[:, None]).reshape(-1, K * d)
    pivots = np.abs(np.diag(R)[:K])
    with np.errstate(divide="ignore"):
        rounding = np.finfo(np.float64).eps * pivots.max() / pivots.min()
    size = np.maximum(np.linalg.norm(D, axis=0), magnitudes(manifold, theta).ravel())
    errors: ndarray = rounding * size * np.linalg.norm(per_parameter, axis=1)
    if undefined(manifold, theta):
        errors[:] = math.inf
    return np.vstack([J.real, J.imag]), errors


def invert_information(
    J: Float[ndarray, "rows kd"], rounding: Float[ndarray, " kd"], snapshots: int
) -> Float[ndarray, "kd kd"]:
    """Return (2T·JᵀJ)⁻¹; all elements are inf if a column of J is not certain to be independent of the others.

    J: root of the information per snapshot, as ``information_root`` returns it.
    rounding: rounding errors of its columns.
    snapshots: number T of snapshots.
    """
    R = np.linalg.qr(J).R
    n = len(rounding)
    if len(R) < n or not (np.abs(np.diag(R)) > CERTAIN * rounding).all():
        return np.full((n, n), math.inf)
    inverse = solve_triangular(R, np.eye(n))
    covariance: ndarray = inverse @ inverse.T / (2 * snapshots)
    return covariance
