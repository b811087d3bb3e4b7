"""The kernels of subspace fitting: J = K − tr(BᴴG⁻¹B) with G = AᴴA and B = AᴴU_s, and its gradient.

With Cholesky's G = LLᴴ and W = L⁻¹B, J = K − ‖W‖²_F. The K responses of a candidate are added one after another, and
each extends L and W by a row. What the kernels share, with room for one candidate at a time:

    rows    U_s, then the responses a_0 … a_{K−1}
    h       a_jᴴ[U_s, a_0 … a_{j−1}]: row j of B, then row j of G left of its diagonal
    L, W    (K, K)
    least   the least pivot L_jj²
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import compiled

from .inner_products import SUMS, inner_product, inner_products_of_four, uint
from .packing import ROWS, ArrayModel
from .response_vectors import phase_gradient, respond, source_at

__all__ = ["esf", "esf_and_gradient", "esf_one"]


@compiled(inline=True)
def gram_row(rows: Float[ndarray, "2 rows padded"], K: int, j: int, h: Complex[ndarray, " rows"]) -> None:
    """h = a_jᴴ[U_s, a_0 … a_{j−1}]: row j of B, then row j of G left of its diagonal."""
    for k in range(uint(0), uint(K + j), uint(ROWS)):
        if k + uint(1) == uint(K + j):  # one is left over, as for K = 3
            s0, s1 = inner_product(rows, uint(K + j), rows, k)
            h[k] = complex(s0, s1)
            break
        s0, s1, s2, s3, s4, s5, s6, s7 = inner_products_of_four(rows, uint(K + j), rows, k, uint(0))
        h[k] = complex(s0, s1)
        h[k + uint(1)] = complex(s2, s3)
        h[k + uint(2)] = complex(s4, s5)
        h[k + uint(3)] = complex(s6, s7)


@compiled(inline=True)
def extend_cholesky(h: Complex[ndarray, " rows"], j: int, M: int, least: float, L: Complex[ndarray, "k k"]) -> float:
    """L_jk = (G_jk − Σ_{c<k} L_jc·L_kc*)/L_kk and L_jj = √(M − Σ_{k<j} |L_jk|²), which is returned; G_jj = M."""
    K, pivot = len(L), float(M)
    for k in range(j):
        g = h[K + k]
        for c in range(k):
            g -= L[j, c] * L[k, c].conjugate()
        g = g * (1.0 / L[k, k].real)
        L[j, k] = g
        pivot -= g.real * g.real + g.imag * g.imag
    root = math.sqrt(max(pivot, least))
    L[j, j] = root
    return root


@compiled(inline=True)
def project(
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    j: int,
    root: float,
    W: Complex[ndarray, "k k"],
    energy: float,
) -> float:
    """W_j = (B_j − Σ_{k<j} L_jk·W_k)/L_jj; returns ``energy`` + ‖W_j‖²."""
    for c in range(len(W)):
        w = h[c]
        for k in range(j):
            w -= L[j, k] * W[k, c]
        w = w * (1.0 / root)
        W[j, c] = w
        energy += w.real * w.real + w.imag * w.imag
    return energy


@compiled()
def _misfit(
    array: ArrayModel,
    least: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k k"],
    X: Float[ndarray, "p n"],
    i: int,
) -> float:
    """J of candidate i; leaves its responses in ``rows``, and L and W."""
    K = len(W)
    d = X.shape[1] // K
    energy = 0.0
    for j in range(K):
        respond(array, source_at(X, i, j * d, d, array.wavelength), rows, K + j)
        gram_row(rows, K, j, h)
        root = extend_cholesky(h, j, array.M, least, L)
        energy = project(h, L, j, root, W, energy)
    return max(K - energy, 0.0)


@compiled()
def esf(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    least: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k k"],
    X: Float[ndarray, "p n"],
) -> Float[ndarray, " p"]:
    """J of p candidates (p, n) [rad, m]."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    J = np.empty(len(X))
    for i in range(len(X)):
        J[i] = _misfit(array, least, rows, h, L, W, X, i)
    return J


@compiled()
def esf_one(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    least: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k k"],
    x: Float[ndarray, " n"],
) -> float:
    """J of one candidate (n,) [rad, m]."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    return _misfit(array, least, rows, h, L, W, np.expand_dims(x, 0), 0)


@compiled(SUMS)
def esf_and_gradient(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    least: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k k"],
    x: Float[ndarray, " n"],
) -> tuple[float, Float[ndarray, " n"]]:
    """J and ∂J = −2Re tr(Vᴴ·∂A·C) of one candidate: C = A⁺U_s, V = U_s − AC, and θ_k moves column k of A alone."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    X, K = np.expand_dims(x, 0), len(W)
    J = _misfit(array, least, rows, h, L, W, X, 0)
    for j in range(K - 1, -1, -1):  # C = L⁻ᴴW, in the place of W
        for c in range(K):
            w = W[j, c]
            for k in range(j + 1, K):
                w -= L[k, j].conjugate() * W[k, c]
            W[j, c] = w * (1.0 / L[j, j].real)
    d = len(x) // K
    gradient = np.empty(len(x))
    z = np.empty((2, 1, geometry.shape[1]))
    for k in range(K):
        for c in range(K):  # z = V*·C_k = [U_s, A]*·[C_k, −C*C_k]
            h[c] = W[k, c]
            h[K + c] = 0.0
            for i in range(K):
                h[K + c] -= W[c, i].conjugate() * W[k, i]
        z[:] = 0.0
        for c in range(uint(2 * K)):
            re, im = h[c].real, h[c].imag
            for m in range(uint(geometry.shape[1])):
                z[0, 0, m] += rows[0, c, m] * re + rows[1, c, m] * im
                z[1, 0, m] += rows[0, c, m] * im - rows[1, c, m] * re
        for m in range(geometry.shape[1]):  # ∂a = j2π·∂t·a, so −2Re(∂a·z) = 4π·∂t·Im(a·z)
            z[0, 0, m] = 4.0 * math.pi * (rows[0, K + k, m] * z[1, 0, m] + rows[1, K + k, m] * z[0, 0, m])
        phase_gradient(array, source_at(X, 0, k * d, d, wavelength), z, gradient[k * d : (k + 1) * d])
    return J, gradient
