"""The kernels of subspace fitting: J = ‖F‖² − tr(BᴴG⁻¹B) with G = AᴴA and B = AᴴF, and its gradient.

With Cholesky's G = LLᴴ and W = L⁻¹B, J = ‖F‖² − ‖W‖²_F. The K responses of a candidate are added one after another,
and each extends L and W by a row. Candidates with a nearly singular G are left to ``singular``. What the kernels share,
with room for one candidate at a time:

    energy  ‖F‖²
    rows    F, then the responses a_0 … a_{K−1}
    h       a_jᴴ[F, a_0 … a_{j−1}]: row j of B, then row j of G left of its diagonal
    L       (K, K)
    W       (K, c)

If c > LANES, F is lower triangular and c a multiple of ROWS, as ``pack_factor`` lays it out.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import compiled

from .inner_products import SUMS, gram_row, uint
from .packing import LANES, ROWS, ArrayModel
from .response_vectors import Source, phase_gradient, respond, source_at
from .singular import singular_fit

__all__ = ["SINGULAR", "fill_singular", "misfit", "misfit_and_gradient"]

SINGULAR = 1e-5
"""The value of det(G)/M^K below which a candidate is left to ``singular``.

It does not depend on the order of the sources. As the diagonal of G/M is 1, cond(G) <= e·K·M^K/det(G). Measured over
arrays of 8 to 256 elements and K = 2 to 12, Cholesky's J is off by less than 1e-15·‖F‖²·M^K/det(G)."""


@compiled(inline=True)
def extend_cholesky(h: Complex[ndarray, " rows"], c: int, j: int, M: int, L: Complex[ndarray, "k k"]) -> float:
    """L_jk = (G_jk − Σ_{i<k} L_ji·L_ki*)/L_kk; returns the pivot L_jj² = M − Σ_{k<j} |L_jk|², as G_jj = M."""
    pivot = float(M)
    for k in range(j):
        g = h[c + k]
        for i in range(k):
            g -= L[j, i] * L[k, i].conjugate()
        g = g * (1.0 / L[k, k].real)
        L[j, k] = g
        pivot -= g.real * g.real + g.imag * g.imag
    return pivot


@compiled(inline=True)
def project(
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    j: int,
    root: float,
    W: Complex[ndarray, "k c"],
    explained: float,
) -> float:
    """W_j = (B_j − Σ_{k<j} L_jk·W_k)/L_jj with L_jj = ``root``; returns ``explained`` + ‖W_j‖²."""
    for c in range(W.shape[1]):
        w = h[c]
        for k in range(j):
            w -= L[j, k] * W[k, c]
        w = w * (1.0 / root)
        W[j, c] = w
        explained += w.real * w.real + w.imag * w.imag
    return explained


@compiled()
def _misfit(
    array: ArrayModel,
    energy: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k c"],
    X: Float[ndarray, "p n"],
    i: int,
) -> float:
    """J of candidate i, or −1 if it is left to ``singular``; leaves its responses in ``rows``, and L and W."""
    K, c = W.shape
    d = X.shape[1] // K
    explained, determinant, scale = 0.0, 1.0, 1.0 / array.M
    for j in range(K):
        respond(array, source_at(X, i, j * d, d, array.wavelength), rows, c + j)
        gram_row(rows, c, j, h)
        pivot = extend_cholesky(h, c, j, array.M, L)
        determinant *= pivot * scale
        if determinant < SINGULAR:
            return -1.0
        root = math.sqrt(pivot)
        L[j, j] = root
        explained = project(h, L, j, root, W, explained)
    return max(energy - explained, 0.0)


@compiled()
def misfit(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    energy: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k c"],
    X: Float[ndarray, "p n"],
) -> Float[ndarray, " p"]:
    """J of p candidates (p, n) [rad, m]; −1 for those that are left to ``fill_singular``."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    J = np.empty(len(X))
    for i in range(len(X)):
        J[i] = _misfit(array, energy, rows, h, L, W, X, i)
    return J


@compiled(SUMS)
def _add_triangular(
    rows: Float[ndarray, "2 rows padded"], h: Complex[ndarray, " rows"], columns: int, z: Float[ndarray, "2 1 padded"]
) -> None:
    """z += Σ_c F_c*·h_c, where column c of F is zero before element c."""
    for c in range(uint(0), uint(columns), uint(ROWS)):
        h0, h1, h2, h3 = h[c], h[c + uint(1)], h[c + uint(2)], h[c + uint(3)]
        for m in range(c // uint(LANES) * uint(LANES), uint(z.shape[2])):
            z[0, 0, m] += (
                (rows[0, c, m] * h0.real + rows[1, c, m] * h0.imag)
                + (rows[0, c + uint(1), m] * h1.real + rows[1, c + uint(1), m] * h1.imag)
                + (rows[0, c + uint(2), m] * h2.real + rows[1, c + uint(2), m] * h2.imag)
                + (rows[0, c + uint(3), m] * h3.real + rows[1, c + uint(3), m] * h3.imag)
            )
            z[1, 0, m] += (
                (rows[0, c, m] * h0.imag - rows[1, c, m] * h0.real)
                + (rows[0, c + uint(1), m] * h1.imag - rows[1, c + uint(1), m] * h1.real)
                + (rows[0, c + uint(2), m] * h2.imag - rows[1, c + uint(2), m] * h2.real)
                + (rows[0, c + uint(3), m] * h3.imag - rows[1, c + uint(3), m] * h3.real)
            )


@compiled(SUMS, inline=True)
def _slope(
    array: ArrayModel,
    source: Source,
    a: Float[ndarray, "2 rows padded"],
    row: int,
    rows: Float[ndarray, "2 rows padded"],
    W: Complex[ndarray, "k c"],
    C: Complex[ndarray, "k c"],
    k: int,
    h: Complex[ndarray, " rows"],
    z: Float[ndarray, "2 1 padded"],
    gradient: Float[ndarray, " d"],
) -> None:
    """∂J/∂θ of one source into ``gradient``, with its response in row ``row`` of ``a`` and its row k of C = A⁺F.

    ``rows`` holds [F, S] with F − S·W = (I − P_A)F: S = A and W = C, or S orthonormal and W = SᴴF. Takes h and z.
    """
    K, columns = W.shape
    first = 0
    for i in range(K):  # z = ((I − P_A)F)*·C_k = [F, S]*·[C_k, −W*·C_k]
        g = 0.0j
        for c in range(columns):
            g -= W[i, c].conjugate() * C[k, c]
        h[columns + i] = g
    for c in range(columns):
        h[c] = C[k, c]
    z[:] = 0.0
    if columns > LANES:
        first = columns
        _add_triangular(rows, h, columns, z)
    for c in range(uint(first), uint(columns + K)):
        re, im = h[c].real, h[c].imag
        for m in range(uint(z.shape[2])):
            z[0, 0, m] += rows[0, c, m] * re + rows[1, c, m] * im
            z[1, 0, m] += rows[0, c, m] * im - rows[1, c, m] * re
    for m in range(z.shape[2]):  # ∂a = j2π·∂t·a, so −2Re(∂a·z) = 4π·∂t·Im(a·z)
        z[0, 0, m] = 4.0 * math.pi * (a[0, row, m] * z[1, 0, m] + a[1, row, m] * z[0, 0, m])
    phase_gradient(array, source, z, gradient)


@compiled(SUMS)
def misfit_and_gradient(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    energy: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k c"],
    x: Float[ndarray, " n"],
) -> tuple[float, Float[ndarray, " n"]]:
    """J and ∂J = −2Re tr(Vᴴ·∂A·C) of one candidate: C = A⁺F, V = F − AC, and θ_k moves column k of A alone.

    J = −1 if the candidate is left to ``fill_singular``.
    """
    array = ArrayModel(wavelength, wavefront, geometry, M)
    X = np.expand_dims(x, 0)
    K, columns = W.shape
    d = len(x) // K
    gradient = np.empty(len(x))
    z = np.empty((2, 1, geometry.shape[1]))
    J = _misfit(array, energy, rows, h, L, W, X, 0)
    if J < 0.0:
        K = 0
    for j in range(K - 1, -1, -1):  # C = L⁻ᴴW, in the place of W
        for c in range(columns):
            w = W[j, c]
            for k in range(j + 1, K):
                w -= L[k, j].conjugate() * W[k, c]
            W[j, c] = w * (1.0 / L[j, j].real)
    for k in range(K):
        source = source_at(X, 0, k * d, d, wavelength)
        _slope(array, source, rows, columns + k, rows, W, W, k, h, z, gradient[k * d : (k + 1) * d])
    return J, gradient


@compiled(SUMS)
def fill_singular(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    energy: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    L: Complex[ndarray, "k k"],
    W: Complex[ndarray, "k c"],
    X: Float[ndarray, "p n"],
    J: Float[ndarray, " p"],
    gradients: Float[ndarray, "q n"],
) -> None:
    """Put J of the candidates left to this kernel in the place of −1, and ∂J of the first q of them into ``gradients``.

    One kernel for values and gradients, because it takes seconds to compile.
    """
    array = ArrayModel(wavelength, wavefront, geometry, M)
    a = np.empty((2, 1, geometry.shape[1]))
    z, d = np.empty_like(a), X.shape[1] // len(W)
    for i in range(len(X)):
        if J[i] < 0.0:
            J[i], C, order = singular_fit(array, energy, rows, h, W, X, i, i < len(gradients))
            for j in range(len(C)):
                first = order[j] * d
                source = source_at(X, i, first, d, wavelength)
                respond(array, source, a, 0)
                _slope(array, source, a, 0, rows, W, C, j, h, z, gradients[i, first : first + d])
