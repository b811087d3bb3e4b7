"""The misfit J = ‖F − AC‖², C = A⁺F, of K sources, its gradient, and the curvature of its Gauss–Newton model.

The coordinates z of a source are its angles in beamwidths and its inverse range in depths of focus. Column k of A moves
with its own coordinates only, so that ∂a_k/∂z_i = D_ki = j·t_ki ⊙ a_k with real slopes t_ki of the phases [rad]. With
Kaufman's Jacobian (1975, doi:10.1007/BF01932995), ∂R/∂z_ki ≈ −P⊥·D_ki·c_k for R = F − AC and row c_k of C,

    g_ki    = ½∂J/∂z_ki = Im Σ_m t_ki·a_k·z_k, z_k = R*·c_kᵀ                       (exact)
    H_ki,lj = Re[N_ki,lj·(CCᴴ)_lk], N = DᴴP⊥D = DᴴD − VᴴV, V = L⁻¹AᴴD, AᴴA = LLᴴ   (half of the model's Hessian)

All products of A and D are sums of a_k*·a_l with real weights, so that M-vectors are read there only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import compiled

from ...objectives.kernels.inner_products import SUMS, inner_product, inner_products_of_four, uint
from ...objectives.kernels.packing import ROWS, ArrayModel
from ...objectives.kernels.response_vectors import respond, slopes, source_at

__all__ = ["Fit", "derivatives", "factorize", "fit_of", "misfit", "misfit_and_derivatives", "pack"]

LEAST = 1e-13  # least pivot of Cholesky's factorization of AᴴA, relative to M: that of two sources at one position


class Fit(NamedTuple):
    """The factor that is fitted, and room for one candidate; rows are padded as ``packing`` describes."""

    F: Float[ndarray, "2 rows padded"]
    R: Float[ndarray, "2 rows padded"]  # F − AC
    A: Float[ndarray, "2 sources padded"]
    C: Complex[ndarray, "k rows"]
    L: Complex[ndarray, "k k"]
    t: Float[ndarray, "n padded"]  # slopes of the phases [rad] per unit of each coordinate
    w: Float[ndarray, "2 1 padded"]  # scratch
    V: Complex[ndarray, "k n"]
    N: Complex[ndarray, "n n"]
    T: Complex[ndarray, "k k"]  # CCᴴ


@compiled()
def pack(F: Complex[ndarray, "m c"], width: int) -> Float[ndarray, "2 rows padded"]:
    """The columns of F as rows of zeros-padded real and imaginary parts."""
    M, c = F.shape
    rows = np.zeros((2, -(-c // ROWS) * ROWS, width))
    for m in range(M):
        for j in range(c):
            rows[0, j, m], rows[1, j, m] = F[m, j].real, F[m, j].imag
    return rows


@compiled()
def fit_of(F: Float[ndarray, "2 rows padded"], K: int, d: int) -> Fit:
    rows, width, n = F.shape[1], F.shape[2], K * d
    return Fit(
        F,
        np.empty((2, rows, width)),
        np.zeros((2, -(-K // ROWS) * ROWS, width)),
        np.empty((K, rows), np.complex128),
        np.empty((K, K), np.complex128),
        np.empty((n, width)),
        np.empty((2, 1, width)),
        np.empty((K, n), np.complex128),
        np.empty((n, n), np.complex128),
        np.empty((K, K), np.complex128),
    )


# ------------------------------------------------------------------------------------------------- the value


@compiled()
def factorize(G: Complex[ndarray, "k k"], M: int) -> float:
    """Cholesky's factorization of AᴴA in place, from its lower triangle; returns the least pivot relative to M."""
    smallest = 1.0
    for k in range(len(G)):
        pivot = float(M)
        for o in range(k):
            g = G[k, o]
            for i in range(o):
                g -= G[k, i] * G[o, i].conjugate()
            g = g * (1.0 / G[o, o].real)
            G[k, o] = g
            pivot -= g.real * g.real + g.imag * g.imag
        smallest = min(smallest, pivot / M)
        G[k, k] = math.sqrt(max(pivot, LEAST * M))
    return smallest


@compiled()
def _coefficients(fit: Fit, M: int) -> float:
    """L, and C = A⁺F = L⁻ᴴL⁻¹AᴴF, from the responses A; returns the least pivot relative to M."""
    F, A, C, L = fit.F, fit.A, fit.C, fit.L
    K = len(L)
    for k in range(K):
        for j in range(uint(0), uint(F.shape[1]), uint(ROWS)):
            s0, s1, s2, s3, s4, s5, s6, s7 = inner_products_of_four(A, uint(k), F, j, uint(0))
            C[k, j], C[k, j + uint(1)] = complex(s0, s1), complex(s2, s3)
            C[k, j + uint(2)], C[k, j + uint(3)] = complex(s4, s5), complex(s6, s7)
        for o in range(k):
            re, im = inner_product(A, uint(k), A, uint(o))
            L[k, o] = complex(re, im)
    smallest = factorize(L, M)
    for k in range(K):
        for i in range(k):
            for j in range(C.shape[1]):
                C[k, j] -= L[k, i] * C[i, j]
        for j in range(C.shape[1]):
            C[k, j] *= 1.0 / L[k, k].real
    for k in range(K - 1, -1, -1):
        for i in range(k + 1, K):
            for j in range(C.shape[1]):
                C[k, j] -= L[i, k].conjugate() * C[i, j]
        for j in range(C.shape[1]):
            C[k, j] *= 1.0 / L[k, k].real
    return smallest


@compiled(SUMS)
def _residual(fit: Fit) -> float:
    """R = F − AC row by row; returns J = ‖R‖², which has its digits even where J is far below ‖F‖²."""
    F, R, A, C = fit.F, fit.R, fit.A, fit.C
    J = 0.0
    for j in range(uint(F.shape[1])):
        for m in range(uint(F.shape[2])):
            R[0, j, m], R[1, j, m] = F[0, j, m], F[1, j, m]
        for k in range(uint(len(C))):
            re, im = C[k, j].real, C[k, j].imag
            for m in range(uint(F.shape[2])):
                R[0, j, m] -= A[0, k, m] * re - A[1, k, m] * im
                R[1, j, m] -= A[0, k, m] * im + A[1, k, m] * re
        for m in range(uint(F.shape[2])):
            J += R[0, j, m] * R[0, j, m] + R[1, j, m] * R[1, j, m]
    return J


@compiled()
def misfit(array: ArrayModel, fit: Fit, X: Float[ndarray, "1 n"]) -> tuple[float, float]:
    """J of the candidate and the least pivot of AᴴA relative to M; leaves A, L, C and R in ``fit``."""
    K = len(fit.L)
    d = X.shape[1] // K
    for k in range(K):
        respond(array, source_at(X, 0, k * d, d, array.wavelength), fit.A, k)
    pivot = _coefficients(fit, array.M)
    return _residual(fit), pivot


# ------------------------------------------------------------------------------------------------- its derivatives


@compiled({"contract"})
def _phase_slopes(
    array: ArrayModel, X: Float[ndarray, "1 n"], k: int, unit: Float[ndarray, " d"], t: Float[ndarray, "n padded"]
) -> None:
    """t_ki [rad] of source k per unit of its coordinates: angles [beamwidths], inverse range [depths of focus]."""
    d, q = len(unit), array.geometry
    cos_a, sin_a, cos_e, sin_e, r, _, _ = source_at(X, 0, k * d, d, array.wavelength)
    x, y, z = cos_e * cos_a, cos_e * sin_a, sin_e
    by_azimuth = 2.0 * math.pi * unit[0]
    by_elevation = 2.0 * math.pi * unit[1]
    metres = X[0, k * d + d - 1]
    by_range = -2.0 * math.pi / array.wavelength * metres * metres * unit[d - 1]  # ∂r/∂z = −r²·depth
    for m in range(q.shape[1]):
        s = x * q[0, m] + y * q[1, m] + z * q[2, m]
        by_s, by_r = slopes(array.wavefront, s, r, q[3, m])
        t[k * d, m] = by_azimuth * by_s * cos_e * (cos_a * q[1, m] - sin_a * q[0, m])
        t[k * d + d - 1, m] = by_range * by_r
        if d == 3:
            t[k * d + 1, m] = by_elevation * by_s * (cos_e * q[2, m] - sin_e * (cos_a * q[0, m] + sin_a * q[1, m]))


@compiled(SUMS)
def _gradient(fit: Fit, k: int, d: int, g: Float[ndarray, " n"]) -> None:
    """g_ki = Im Σ_m t_ki·a_k·z_k with z_k = R*·c_kᵀ."""
    R, A, w = fit.R, fit.A, fit.w
    for m in range(uint(R.shape[2])):
        w[0, 0, m] = w[1, 0, m] = 0.0
    for j in range(uint(R.shape[1])):
        re, im = fit.C[k, j].real, fit.C[k, j].imag
        for m in range(uint(R.shape[2])):
            w[0, 0, m] += R[0, j, m] * re + R[1, j, m] * im
            w[1, 0, m] += R[0, j, m] * im - R[1, j, m] * re
    for m in range(uint(R.shape[2])):
        w[0, 0, m] = A[0, k, m] * w[1, 0, m] + A[1, k, m] * w[0, 0, m]
    for i in range(d):
        total = 0.0
        for m in range(uint(R.shape[2])):
            total += fit.t[k * d + i, m] * w[0, 0, m]
        g[k * d + i] = total


@compiled(SUMS)
def _own_products(fit: Fit, k: int, d: int) -> None:
    """The products of source k with itself: row k of AᴴD and the block (k, k) of DᴴD, sums of its slopes."""
    t = fit.t
    for i in range(d):
        total = 0.0
        for m in range(uint(t.shape[1])):
            total += t[k * d + i, m]
        fit.V[k, k * d + i] = complex(0.0, total)
        for j in range(i + 1):
            total = 0.0
            for m in range(uint(t.shape[1])):
                total += t[k * d + i, m] * t[k * d + j, m]
            fit.N[k * d + j, k * d + i] = total


@compiled(SUMS)
def _cross_products(fit: Fit, o: int, k: int, d: int) -> None:
    """The products of sources o < k: with p = a_o*·a_k, those of AᴴD are Σ t·p, and those of DᴴD are Σ t·t·p."""
    A, t, w = fit.A, fit.t, fit.w
    for m in range(uint(t.shape[1])):
        w[0, 0, m] = A[0, o, m] * A[0, k, m] + A[1, o, m] * A[1, k, m]
        w[1, 0, m] = A[0, o, m] * A[1, k, m] - A[1, o, m] * A[0, k, m]
    for i in range(d):
        s0 = s1 = s2 = s3 = 0.0
        for m in range(uint(t.shape[1])):
            s0 += t[k * d + i, m] * w[0, 0, m]
            s1 += t[k * d + i, m] * w[1, 0, m]
            s2 += t[o * d + i, m] * w[0, 0, m]
            s3 += t[o * d + i, m] * w[1, 0, m]
        fit.V[o, k * d + i] = complex(-s1, s0)  # j·Σ t_k·p
        fit.V[k, o * d + i] = complex(s3, s2)  # j·Σ t_o·p*
        last = o * d + d - 1
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        for m in range(uint(t.shape[1])):
            re, im = t[k * d + i, m] * w[0, 0, m], t[k * d + i, m] * w[1, 0, m]
            s0 += t[o * d, m] * re
            s1 += t[o * d, m] * im
            s2 += t[last, m] * re
            s3 += t[last, m] * im
            if d == 3:
                s4 += t[o * d + 1, m] * re
                s5 += t[o * d + 1, m] * im
        fit.N[o * d, k * d + i] = complex(s0, s1)
        fit.N[last, k * d + i] = complex(s2, s3)
        if d == 3:
            fit.N[o * d + 1, k * d + i] = complex(s4, s5)


@compiled()
def _curvature(fit: Fit, d: int, H: Float[ndarray, "n n"]) -> None:
    """H from AᴴD in V and the upper triangle of DᴴD in N."""
    C, L, V, N, T = fit.C, fit.L, fit.V, fit.N, fit.T
    K, n = V.shape
    for k in range(K):
        for i in range(k):
            for q in range(n):
                V[k, q] -= L[k, i] * V[i, q]
        for q in range(n):
            V[k, q] *= 1.0 / L[k, k].real
        for o in range(k + 1):
            total = complex(0.0, 0.0)
            for j in range(C.shape[1]):
                total += C[k, j] * C[o, j].conjugate()
            T[k, o] = total
    for p in range(n):
        for q in range(p, n):
            value = N[p, q]
            for i in range(K):
                value -= V[i, p].conjugate() * V[i, q]
            H[p, q] = H[q, p] = (value * T[q // d, p // d]).real


@compiled()
def derivatives(
    array: ArrayModel,
    fit: Fit,
    X: Float[ndarray, "1 n"],
    unit: Float[ndarray, " d"],
    g: Float[ndarray, " n"],
    H: Float[ndarray, "n n"],
) -> None:
    """g and H of the candidate whose ``misfit`` was computed last."""
    K, d = len(fit.L), len(unit)
    for k in range(K):
        _phase_slopes(array, X, k, unit, fit.t)
        _gradient(fit, k, d, g)
        _own_products(fit, k, d)
    for k in range(K):
        for o in range(k):
            _cross_products(fit, o, k, d)
    _curvature(fit, d, H)


@compiled()
def misfit_and_derivatives(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    F: Complex[ndarray, "m c"],
    unit: Float[ndarray, " d"],
    x: Float[ndarray, " n"],
) -> tuple[float, Float[ndarray, " n"], Float[ndarray, "n n"], float]:
    """J, g, H, and the least pivot of AᴴA relative to M, of one candidate (n,) [rad, m]."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    fit = fit_of(pack(F, geometry.shape[1]), len(x) // len(unit), len(unit))
    X = np.empty((1, len(x)))
    for i in range(len(x)):
        X[0, i] = x[i]
    J, pivot = misfit(array, fit, X)
    g, H = np.empty(len(x)), np.empty((len(x), len(x)))
    derivatives(array, fit, X, unit, g, H)
    return J, g, H, pivot
