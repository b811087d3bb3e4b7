"""The compiled heart of the objectives: responses, RLS and ESF, for any number of points through the same code.

Layout: every vector over the M elements is a row of float64, real and imaginary parts apart, padded with zeros to a
multiple of LANES, so that each inner loop is a plain sum which LLVM turns into full SIMD registers and nothing is left
over. A value does not depend on which other points are evaluated with it. Lengths are in wavelengths and phases in
turns, for which the reduction to one turn is exact.

Kernels are compiled once a machine and kept on disk; ``warm_up`` loads them, before any clock runs.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Complex, Float
from numba import types
from numpy import ndarray

from nfbench import compiled, load_kernels

__all__ = [
    "WAVEFRONTS",
    "esf",
    "esf_and_gradient",
    "esf_one",
    "pack_geometry",
    "pack_rows",
    "pack_subspace",
    "phasors",
    "projected_energy",
    "projected_energy_and_gradient",
    "projected_energy_one",
    "repulsion",
    "repulsion_one",
    "responses",
    "warm_up",
]

_Index: TypeAlias = int | np.uint64

LANES = 16  # two of the widest SIMD registers (AVX-512), which LLVM keeps in flight per sum
ROWS = 4  # rows met at once in an inner product: 8 sums in flight hide the latency of a fused multiply-add
BLOCK = 16  # candidates whose responses stay in the first-level cache while the factor streams past them
WAVEFRONTS = {"exact": 0, "fresnel": 1, "paper": 2, "planar": 3}

_u = np.uint64  # an index that is never negative, so that Numba need not ask
_CONTRACT = {"contract"}  # fused multiply-adds
_SUMS = {"contract", "reassoc", "nsz"}  # and sums in any order: their rounding is that of BLAS


def pack_geometry(positions: Float[ndarray, "m 3"], wavelength_m: float) -> Float[ndarray, "4 padded"]:
    """The rows q_x, q_y, q_z [λ] and w = ‖q‖² [λ²]; (M, 3) ``positions`` [m]."""
    q = positions.T / wavelength_m
    return _pad(np.vstack([q, np.sum(q * q, axis=0)]), 1)


def pack_rows(columns: Complex[ndarray, "m c"]) -> Float[ndarray, "2 rows padded"]:
    """The real and the imaginary parts of c columns, each a row; rows of zeros make c a multiple of ROWS."""
    return np.stack([_pad(part, ROWS) for part in (columns.real.T, columns.imag.T)])


def pack_subspace(
    U_s: Complex[ndarray, "m k"],
) -> tuple[
    Float[ndarray, "2 rows padded"], Complex[ndarray, " rows"], Complex[ndarray, "k k"], Complex[ndarray, "k k"]
]:
    """U_s with room for K responses after it, and room for h, L and W of one candidate at a time.

    A kernel holds the interpreter's lock while it writes there, so that threads may share it.
    """
    K = U_s.shape[1]
    rows = pack_rows(np.hstack([U_s, np.zeros_like(U_s)]))
    return rows, np.empty(rows.shape[1], np.complex128), *np.empty((2, K, K), np.complex128)


def _pad(rows: ndarray, multiple: int) -> ndarray:
    r, m = rows.shape
    padded = np.zeros((r + -r % multiple, m + -m % LANES))
    padded[:r, :m] = rows
    return padded


# ------------------------------------------------------------------------------------------------- response vectors


@compiled(_CONTRACT)
def _sine(g: float) -> float:
    """sin(2πg) for |g| <= 1/4: the minimax polynomial of degree 17, off by 5e-19 before rounding."""
    z = g * g
    p = 0.10064290911915101
    p = p * z - 0.7176655739661518
    p = p * z + 3.8199205370501965
    p = p * z - 15.094641230812554
    p = p * z + 42.058693910435544
    p = p * z - 76.70585975253722
    p = p * z + 81.60524927607067
    p = p * z - 41.34170224039974
    p = p * z + 6.283185307179586
    return p * g


@compiled(_CONTRACT)
def _phasor(turns: float) -> tuple[float, float]:
    """cos(2πt) and sin(2πt): both are sines of triangle waves of t, cos of 1/4 − |t| and sin of 1/4 − |1/4 − |t||."""
    t = turns - np.rint(turns)  # exact, |t| <= 1/2
    quarter = 0.25 - abs(t)
    return _sine(quarter), _sine(math.copysign(0.25 - abs(quarter), t))


@compiled(_CONTRACT)
def _respond(
    X: ndarray,
    i: int,
    first: int,
    angles: int,
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    M: int,
    a: ndarray,
    row: int,
) -> None:
    """a(θ), θ = X[i, first:], into the row of ``a``, zero beyond M: the advance [λ], then its phasor."""
    x, y = _phasor(X[i, first] * (0.5 / math.pi))  # u = [cosψ cosφ, cosψ sinφ, sinψ]
    z = 0.0
    if angles == 2:
        c, z = _phasor(X[i, first + 1] * (0.5 / math.pi))
        x, y = c * x, c * y
    r = X[i, first + angles] / wavelength
    half = 0.5 / r
    width = geometry.shape[1]
    if wavefront == 0:  # exact: r − ‖p − q‖ without the cancellation of nearly equal lengths
        for m in range(width):
            s = x * geometry[0, m] + y * geometry[1, m] + z * geometry[2, m]
            numerator = 2.0 * r * s - geometry[3, m]
            d = math.sqrt(max(r * r - numerator, 1e-300))
            a[0, row, m] = numerator / (r + d)
    elif wavefront == 1:  # fresnel
        for m in range(width):
            s = x * geometry[0, m] + y * geometry[1, m] + z * geometry[2, m]
            a[0, row, m] = s - (geometry[3, m] - s * s) * half
    elif wavefront == 2:  # paper
        for m in range(width):
            s = x * geometry[0, m] + y * geometry[1, m] + z * geometry[2, m]
            a[0, row, m] = s - geometry[3, m] * half
    else:  # planar
        for m in range(width):
            a[0, row, m] = x * geometry[0, m] + y * geometry[1, m] + z * geometry[2, m]
    for m in range(width):
        a[0, row, m], a[1, row, m] = _phasor(a[0, row, m])
    for m in range(M, width):
        a[0, row, m] = a[1, row, m] = 0.0


@compiled(_SUMS)
def _phase_gradient(
    X: ndarray,
    i: int,
    first: int,
    angles: int,
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    e: ndarray,
    row: int,
    gradient: ndarray,
) -> None:
    """Σ_m e_m·∂t_m/∂θ into ``gradient``, t_m the phase of a_m in turns, e the row of ``e``, zero beyond M."""
    cos_a, sin_a = _phasor(X[i, first] * (0.5 / math.pi))
    cos_e, sin_e = 1.0, 0.0
    if angles == 2:
        cos_e, sin_e = _phasor(X[i, first + 1] * (0.5 / math.pi))
    x, y, z = cos_e * cos_a, cos_e * sin_a, sin_e
    r = X[i, first + angles] / wavelength
    gx = gy = gz = gr = 0.0
    for m in range(geometry.shape[1]):
        s = x * geometry[0, m] + y * geometry[1, m] + z * geometry[2, m]
        w = geometry[3, m]
        by_s, by_r = 1.0, 0.0
        if wavefront == 0:  # ∂f/∂r = 1 − (r − s)/d, again without cancellation
            numerator = 2.0 * r * s - w
            d = math.sqrt(max(r * r - numerator, 1e-300))
            by_s, by_r = r / d, (w - s * numerator / (r + d)) / ((r + d) * d)
        elif wavefront == 1:
            by_s, by_r = 1.0 + s / r, (w - s * s) / (2.0 * r * r)
        elif wavefront == 2:
            by_r = w / (2.0 * r * r)
        slope = e[0, row, m] * by_s
        gx += slope * geometry[0, m]
        gy += slope * geometry[1, m]
        gz += slope * geometry[2, m]
        gr += e[0, row, m] * by_r
    gradient[first] = cos_e * (cos_a * gy - sin_a * gx)
    if angles == 2:
        gradient[first + 1] = cos_e * gz - sin_e * (cos_a * gx + sin_a * gy)
    gradient[first + angles] = gr / wavelength


@compiled()
def phasors(turns: ndarray, re: ndarray, im: ndarray) -> None:
    """cos(2πt) and sin(2πt) of a vector; by itself for the tests, and the first to be compiled."""
    for m in range(len(turns)):
        re[m], im[m] = _phasor(turns[m])


@compiled()
def responses(wavelength: float, wavefront: int, geometry: ndarray, M: int, X: ndarray) -> ndarray:
    """a(θ) of p candidates, one a row."""
    A = np.empty((len(X), M), np.complex128)
    a = np.empty((2, 1, geometry.shape[1]))
    for i in range(len(X)):
        _respond(X, i, 0, X.shape[1] - 1, wavelength, wavefront, geometry, M, a, 0)
        for m in range(M):
            A[i, m] = complex(a[0, 0, m], a[1, 0, m])
    return A


# ------------------------------------------------------------------------------------------------- inner products


@compiled(_SUMS)
def _four(
    a: ndarray, p: _Index, rows: ndarray, j: _Index, start: _Index
) -> tuple[float, float, float, float, float, float, float, float]:
    """aᴴl of response p with the four rows l from j on, from element ``start`` on."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    for m in range(start, _u(a.shape[2])):
        x, y = a[0, p, m], a[1, p, m]
        s0 += x * rows[0, j, m] + y * rows[1, j, m]
        s1 += x * rows[1, j, m] - y * rows[0, j, m]
        s2 += x * rows[0, j + _u(1), m] + y * rows[1, j + _u(1), m]
        s3 += x * rows[1, j + _u(1), m] - y * rows[0, j + _u(1), m]
        s4 += x * rows[0, j + _u(2), m] + y * rows[1, j + _u(2), m]
        s5 += x * rows[1, j + _u(2), m] - y * rows[0, j + _u(2), m]
        s6 += x * rows[0, j + _u(3), m] + y * rows[1, j + _u(3), m]
        s7 += x * rows[1, j + _u(3), m] - y * rows[0, j + _u(3), m]
    return s0, s1, s2, s3, s4, s5, s6, s7


@compiled(_SUMS)
def _one(a: ndarray, p: _Index, rows: ndarray, j: _Index) -> tuple[float, float]:
    """aᴴl of response p with row j alone."""
    s0 = s1 = 0.0
    for m in range(_u(a.shape[2])):
        s0 += a[0, p, m] * rows[0, j, m] + a[1, p, m] * rows[1, j, m]
        s1 += a[0, p, m] * rows[1, j, m] - a[1, p, m] * rows[0, j, m]
    return s0, s1


# ------------------------------------------------------------------------------------------------- RLS


@compiled()
def _projected_energy_block(
    X: ndarray,
    first: int,
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    M: int,
    L: ndarray,
    a: ndarray,
    total: ndarray,
) -> None:
    """‖aᴴL‖² of up to BLOCK candidates from ``first`` on; row j of L is zero before element j."""
    count = min(len(X) - first, BLOCK)
    for p in range(count):
        _respond(X, first + p, 0, X.shape[1] - 1, wavelength, wavefront, geometry, M, a, p)
        total[first + p] = 0.0
    for j in range(_u(0), _u(L.shape[1]), _u(ROWS)):
        start = j // _u(LANES) * _u(LANES)
        for p in range(_u(count)):
            b0, b1, b2, b3, b4, b5, b6, b7 = _four(a, p, L, j, start)
            total[_u(first) + p] += ((b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3)) + (
                (b4 * b4 + b5 * b5) + (b6 * b6 + b7 * b7)
            )


@compiled()
def projected_energy(wavelength: float, wavefront: int, geometry: ndarray, M: int, L: ndarray, X: ndarray) -> ndarray:
    """‖aᴴL‖² of p candidates."""
    a = np.empty((2, min(len(X), BLOCK), geometry.shape[1]))
    total = np.empty(len(X))
    for first in range(0, len(X), BLOCK):
        _projected_energy_block(X, first, wavelength, wavefront, geometry, M, L, a, total)
    return total


@compiled()
def projected_energy_one(wavelength: float, wavefront: int, geometry: ndarray, M: int, L: ndarray, x: ndarray) -> float:
    """‖aᴴL‖² of one candidate."""
    a = np.empty((2, 1, geometry.shape[1]))
    total = np.empty(1)
    _projected_energy_block(np.expand_dims(x, 0), 0, wavelength, wavefront, geometry, M, L, a, total)
    return total[0]


@compiled(_SUMS)
def projected_energy_and_gradient(
    wavelength: float, wavefront: int, geometry: ndarray, M: int, L: ndarray, x: ndarray
) -> tuple[float, ndarray]:
    """‖aᴴL‖² and 2Re(∂aᴴ·v), v = LLᴴa, of one candidate."""
    X = np.expand_dims(x, 0)
    a, v, total, gradient = (
        np.empty((2, 1, geometry.shape[1])),
        np.zeros((2, 1, geometry.shape[1])),
        0.0,
        np.empty(len(x)),
    )
    _respond(X, 0, 0, len(x) - 1, wavelength, wavefront, geometry, M, a, 0)
    for j in range(_u(0), _u(L.shape[1]), _u(ROWS)):
        start = j // _u(LANES) * _u(LANES)
        b0, b1, b2, b3, b4, b5, b6, b7 = _four(a, _u(0), L, j, start)
        total += ((b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3)) + ((b4 * b4 + b5 * b5) + (b6 * b6 + b7 * b7))
        for m in range(start, _u(geometry.shape[1])):
            v[0, 0, m] += (
                (L[0, j, m] * b0 + L[1, j, m] * b1)
                + (L[0, j + _u(1), m] * b2 + L[1, j + _u(1), m] * b3)
                + (L[0, j + _u(2), m] * b4 + L[1, j + _u(2), m] * b5)
                + (L[0, j + _u(3), m] * b6 + L[1, j + _u(3), m] * b7)
            )
            v[1, 0, m] += (
                (L[1, j, m] * b0 - L[0, j, m] * b1)
                + (L[1, j + _u(1), m] * b2 - L[0, j + _u(1), m] * b3)
                + (L[1, j + _u(2), m] * b4 - L[0, j + _u(2), m] * b5)
                + (L[1, j + _u(3), m] * b6 - L[0, j + _u(3), m] * b7)
            )
    for m in range(geometry.shape[1]):  # ∂a = j2π·∂t·a, so 2Re(∂aᴴv) = 4π·∂t·Im(a*v)
        v[0, 0, m] = 4.0 * math.pi * (a[0, 0, m] * v[1, 0, m] - a[1, 0, m] * v[0, 0, m])
    _phase_gradient(X, 0, 0, len(x) - 1, wavelength, wavefront, geometry, v, 0, gradient)
    return total, gradient


@compiled()
def repulsion(detected: ndarray, alpha: float, delta_min: float, X: ndarray) -> ndarray:
    """Σ_i α·max(0, δ_min − ‖θ − θ_i‖) of p candidates."""
    total = np.zeros(len(X))
    for p in range(len(X)):
        for i in range(len(detected)):
            square = 0.0
            for c in range(X.shape[1]):
                square += (X[p, c] - detected[i, c]) ** 2
            total[p] += alpha * max(0.0, delta_min - math.sqrt(square))
    return total


@compiled()
def repulsion_one(detected: ndarray, alpha: float, delta_min: float, x: ndarray) -> float:
    """The same of one candidate."""
    return repulsion(detected, alpha, delta_min, np.expand_dims(x, 0))[0]


# ------------------------------------------------------------------------------------------------- ESF


@compiled()
def _esf_point(
    X: ndarray,
    i: int,
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    M: int,
    K: int,
    least: float,
    rows: ndarray,
    h: ndarray,
    L: ndarray,
    W: ndarray,
) -> float:
    """K − ‖W‖²_F with W = L⁻¹B and G = LLᴴ, pivots at least ``least``; ``rows`` holds U_s and takes the responses.

    Row j of ``h`` is a_jᴴ[U_s, a_0 … a_{j−1}]: row j of B, then that of G left of its diagonal, which is M.
    """
    d = X.shape[1] // K
    explained = 0.0
    for j in range(K):
        _respond(X, i, j * d, d - 1, wavelength, wavefront, geometry, M, rows, K + j)
        for k in range(_u(0), _u(K + j), _u(ROWS)):
            if k + _u(1) == _u(K + j):  # as for K = 3, of which 12 products are asked
                s0, s1 = _one(rows, _u(K + j), rows, k)
                h[k] = complex(s0, s1)
                break
            s0, s1, s2, s3, s4, s5, s6, s7 = _four(rows, _u(K + j), rows, k, _u(0))
            h[k] = complex(s0, s1)
            h[k + _u(1)] = complex(s2, s3)
            h[k + _u(2)] = complex(s4, s5)
            h[k + _u(3)] = complex(s6, s7)
        pivot = float(M)
        for k in range(j):
            g = h[K + k]
            for c in range(k):
                g -= L[j, c] * L[k, c].conjugate()
            g = g * (1.0 / L[k, k].real)
            L[j, k] = g
            pivot -= g.real * g.real + g.imag * g.imag
            for c in range(K):
                h[c] -= g * W[k, c]
        root = math.sqrt(max(pivot, least))
        L[j, j] = root
        for c in range(K):
            w = h[c] * (1.0 / root)
            W[j, c] = w
            explained += w.real * w.real + w.imag * w.imag
    return max(K - explained, 0.0)


@compiled()
def esf(
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    M: int,
    K: int,
    least: float,
    rows: ndarray,
    h: ndarray,
    L: ndarray,
    W: ndarray,
    X: ndarray,
) -> ndarray:
    """J of p candidates."""
    J = np.empty(len(X))
    for i in range(len(X)):
        J[i] = _esf_point(X, i, wavelength, wavefront, geometry, M, K, least, rows, h, L, W)
    return J


@compiled()
def esf_one(
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    M: int,
    K: int,
    least: float,
    rows: ndarray,
    h: ndarray,
    L: ndarray,
    W: ndarray,
    x: ndarray,
) -> float:
    """J of one candidate."""
    return _esf_point(np.expand_dims(x, 0), 0, wavelength, wavefront, geometry, M, K, least, rows, h, L, W)


@compiled(_SUMS)
def esf_and_gradient(
    wavelength: float,
    wavefront: int,
    geometry: ndarray,
    M: int,
    K: int,
    least: float,
    rows: ndarray,
    h: ndarray,
    L: ndarray,
    W: ndarray,
    x: ndarray,
) -> tuple[float, ndarray]:
    """J and ∂J = −2Re tr(Vᴴ·∂A·C) of one candidate: C = A⁺U_s, V = U_s − AC, and θ_k moves column k of A alone."""
    X = np.expand_dims(x, 0)
    J = _esf_point(X, 0, wavelength, wavefront, geometry, M, K, least, rows, h, L, W)
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
        for c in range(_u(2 * K)):
            re, im = h[c].real, h[c].imag
            for m in range(_u(geometry.shape[1])):
                z[0, 0, m] += rows[0, c, m] * re + rows[1, c, m] * im
                z[1, 0, m] += rows[0, c, m] * im - rows[1, c, m] * re
        for m in range(geometry.shape[1]):  # ∂a = j2π·∂t·a, so −2Re(∂a·z) = 4π·∂t·Im(a·z)
            z[0, 0, m] = 4.0 * math.pi * (rows[0, K + k, m] * z[1, 0, m] + rows[1, K + k, m] * z[0, 0, m])
        _phase_gradient(X, 0, k * d, d - 1, wavelength, wavefront, geometry, z, 0, gradient)
    return J, gradient


# ------------------------------------------------------------------------------------------------- compilation

_MANIFOLD = (types.float64, types.int64, types.float64[:, ::1], types.int64)  # λ, wavefront, geometry, M
_ROWS = types.float64[:, :, ::1]
_ONE, _MANY = (types.Array(types.float64, n, "A", readonly=True, aligned=False) for n in (1, 2))  # any float64 array
_C1, _C2 = types.complex128[::1], types.complex128[:, ::1]
_ESF = (*_MANIFOLD, types.int64, types.float64, _ROWS, _C1, _C2, _C2)
_REPULSION = (_MANY, types.float64, types.float64)
_SIGNATURES: list[tuple[Any, tuple[Any, ...]]] = [
    (phasors, (types.float64[::1],) * 3),  # the quickest to compile
    (responses, (*_MANIFOLD, _MANY)),
    (projected_energy, (*_MANIFOLD, _ROWS, _MANY)),
    (projected_energy_one, (*_MANIFOLD, _ROWS, _ONE)),
    (projected_energy_and_gradient, (*_MANIFOLD, _ROWS, _ONE)),
    (repulsion, (*_REPULSION, _MANY)),
    (repulsion_one, (*_REPULSION, _ONE)),
    (esf, (*_ESF, _MANY)),
    (esf_one, (*_ESF, _ONE)),
    (esf_and_gradient, (*_ESF, _ONE)),
]


@cache
def warm_up() -> None:
    """Load every kernel from the cache, or compile it, saying so on stderr; nothing is ever compiled after this."""
    load_kernels(_SIGNATURES, "compiling kernels (once a machine, some 15 s)")
