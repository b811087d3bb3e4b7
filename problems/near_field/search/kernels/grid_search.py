"""Greedy choice of sources on a grid: orthogonal least squares, and the best replacement of each source.

With b_p = a_pᴴF, a source of response a_p lowers J by ‖a_pᴴP⊥F‖²/‖P⊥a_p‖², where P⊥ projects the chosen sources off.
Each of these, as an orthonormal vector q, lowers the denominator by |t_p|², t_p = a_pᴴq, and b_p by t_p·(qᴴF). All
quantities of the grid are rows over its points, so that one product a_pᴴq per point and source is all that reads the
responses.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray

from nfbench import compiled

from ...objectives.kernels.inner_products import SUMS, inner_product, inner_products_of_four, uint
from ...objectives.kernels.packing import ROWS, ArrayModel
from ...objectives.kernels.response_vectors import respond, source_at
from .misfit import factorize, pack

__all__ = ["choose_greedily", "choose_replacements", "respond_all"]

BLOCK = 16  # points whose responses are computed at once if they are not stored
SPANNED = 1e-6  # ‖P⊥a‖²/M below which a point counts as a position of a chosen source, where nothing is gained


@compiled()
def respond_all(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    points: Float[ndarray, "p d"],
) -> Float[ndarray, "2 p padded"]:
    """The responses of all points, one per row."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    table = np.empty((2, len(points), geometry.shape[1]))
    for p in range(len(points)):
        respond(array, source_at(points, p, 0, points.shape[1], wavelength), table, p)
    return table


@compiled()
def _row_products(
    a: Float[ndarray, "2 p padded"],
    p: int,
    rows: Float[ndarray, "2 rows padded"],
    first: int,
    count: int,
    q: int,
    out: Float[ndarray, "2 rows p"],
) -> None:
    """aᴴl of response p with ``count`` rows from ``first`` on, as column q of ``out``."""
    for j in range(first, first + count, ROWS):
        if j + 1 == first + count:
            out[0, j - first, q], out[1, j - first, q] = inner_product(a, uint(p), rows, uint(j))
            break
        s = inner_products_of_four(a, uint(p), rows, uint(j), uint(0))
        for i in range(min(ROWS, first + count - j)):
            out[0, j - first + i, q], out[1, j - first + i, q] = s[2 * i], s[2 * i + 1]


@compiled()
def _products(
    array: ArrayModel,
    points: Float[ndarray, "p d"],
    table: Float[ndarray, "2 p padded"],
    rows: Float[ndarray, "2 rows padded"],
    first: int,
    count: int,
    out: Float[ndarray, "2 rows p"],
) -> None:
    """a_pᴴl of all points with ``count`` rows; the responses are computed again if ``table`` does not hold them."""
    if table.shape[1]:
        for p in range(len(points)):
            _row_products(table, p, rows, first, count, p, out)
        return
    block = np.empty((2, 1, table.shape[2]))
    for p in range(len(points)):
        respond(array, source_at(points, p, 0, points.shape[1], array.wavelength), block, 0)
        _row_products(block, 0, rows, first, count, p, out)


@compiled()
def _start(b: Float[ndarray, "2 c p"], M: int, remaining: Float[ndarray, "2 c p"], left: Float[ndarray, " p"]) -> None:
    """The state in which no source is chosen: a_pᴴF is b, and ‖a_p‖² is M."""
    for p in range(len(left)):
        left[p] = M
    for j in range(b.shape[1]):
        for p in range(len(left)):
            remaining[0, j, p], remaining[1, j, p] = b[0, j, p], b[1, j, p]


@compiled(SUMS)
def _remove(
    t: Float[ndarray, "2 rows p"],
    i: int,
    w: Complex[ndarray, " c"],
    b: Float[ndarray, "2 c p"],
    left: Float[ndarray, " p"],
) -> None:
    """Project q off: ``left`` −= |t|² and b −= t·w with t = a_pᴴq in row i, w = qᴴF."""
    for p in range(uint(len(left))):
        left[p] -= t[0, i, p] * t[0, i, p] + t[1, i, p] * t[1, i, p]
    for c in range(len(w)):
        re, im = w[c].real, w[c].imag
        for p in range(uint(len(left))):
            b[0, c, p] -= t[0, i, p] * re - t[1, i, p] * im
            b[1, c, p] -= t[0, i, p] * im + t[1, i, p] * re


@compiled(SUMS)
def _best(
    b: Float[ndarray, "2 c p"], columns: int, left: Float[ndarray, " p"], least: float, gain: Float[ndarray, " p"]
) -> int:
    """The point of the greatest gain ‖b‖²/left; it is 0 where ``left`` is below ``least``."""
    for p in range(uint(len(left))):
        gain[p] = 0.0
    for c in range(columns):
        for p in range(uint(len(left))):
            gain[p] += b[0, c, p] * b[0, c, p] + b[1, c, p] * b[1, c, p]
    for p in range(uint(len(left))):
        gain[p] = gain[p] / left[p] if left[p] > least else 0.0
    best = 0
    for p in range(len(left)):
        if gain[p] > gain[best]:
            best = p
    return best


@compiled()
def _orthonormalize(Q: Float[ndarray, "2 rows padded"], k: int) -> None:
    """Row k of Q, orthogonal to the rows before it and of length one; by Gram–Schmidt, twice."""
    for _ in range(2):
        for i in range(k):
            re, im = inner_product(Q, uint(i), Q, uint(k))
            for m in range(Q.shape[2]):
                x, y = Q[0, i, m], Q[1, i, m]
                Q[0, k, m] -= x * re - y * im
                Q[1, k, m] -= x * im + y * re
    square, _ = inner_product(Q, uint(k), Q, uint(k))
    scale = 1.0 / math.sqrt(square) if square > 0.0 else 1.0
    for m in range(Q.shape[2]):
        Q[0, k, m] *= scale
        Q[1, k, m] *= scale


@compiled()
def choose_greedily(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    points: Float[ndarray, "p d"],
    table: Float[ndarray, "2 p padded"],
    F: Complex[ndarray, "m c"],
    K: int,
) -> tuple[Float[ndarray, " n"], Float[ndarray, "2 c p"]]:
    """K points, each where it lowers J most given those before, one after another; and b_p = a_pᴴF of all points."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    rows, c, d = pack(F, geometry.shape[1]), F.shape[1], points.shape[1]
    P = len(points)
    b, remaining, t, left, gain = (
        np.empty((2, c, P)),
        np.empty((2, c, P)),
        np.empty((2, 1, P)),
        np.empty(P),
        np.empty(P),
    )
    _products(array, points, table, rows, 0, c, b)
    _start(b, M, remaining, left)
    Q = np.zeros((2, -(-K // ROWS) * ROWS, geometry.shape[1]))
    x, w = np.empty(K * d), np.empty(c, np.complex128)
    for k in range(K):
        best = _best(remaining, c, left, SPANNED * M, gain)
        for i in range(d):
            x[k * d + i] = points[best, i]
        if k == K - 1:
            break
        respond(array, source_at(points, best, 0, d, wavelength), Q, k)
        _orthonormalize(Q, k)
        for j in range(c):
            re, im = inner_product(Q, uint(k), rows, uint(j))
            w[j] = complex(re, im)
        _products(array, points, table, Q, k, 1, t)
        _remove(t, 0, w, remaining, left)
    return x, b


@compiled(SUMS)
def _substitute(
    h: Float[ndarray, "2 k p"],
    source: int,
    L: Complex[ndarray, "j j"],
    i: int,
    t: Float[ndarray, "2 j p"],
) -> None:
    """t_i = (h_i − Σ_{o<i} t_o·L_io*)/L_ii for all points; h_i is row ``source`` of a_pᴴA."""
    P = uint(t.shape[2])
    for p in range(P):
        t[0, i, p], t[1, i, p] = h[0, source, p], h[1, source, p]
    for o in range(i):
        re, im = L[i, o].real, -L[i, o].imag
        for p in range(P):
            t[0, i, p] -= t[0, o, p] * re - t[1, o, p] * im
            t[1, i, p] -= t[0, o, p] * im + t[1, o, p] * re
    scale = 1.0 / L[i, i].real
    for p in range(P):
        t[0, i, p] *= scale
        t[1, i, p] *= scale


@compiled()
def choose_replacements(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    points: Float[ndarray, "p d"],
    table: Float[ndarray, "2 p padded"],
    F: Complex[ndarray, "m c"],
    b: Float[ndarray, "2 c p"],
    x: Float[ndarray, " n"],
) -> tuple[Int[ndarray, " k"], Float[ndarray, " k"]]:
    """For each source of x the best point given the others, and |a_pᴴa_k|²/M² of that point p and the source."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    P, c, d = len(points), F.shape[1], points.shape[1]
    K, rows = len(x) // d, pack(F, geometry.shape[1])
    A = np.zeros((2, -(-K // ROWS) * ROWS, geometry.shape[1]))
    X = np.empty((1, len(x)))
    for i in range(len(x)):
        X[0, i] = x[i]
    for k in range(K):
        respond(array, source_at(X, 0, k * d, d, wavelength), A, k)
    h, t, left, gain = np.empty((2, K, P)), np.empty((2, max(K - 1, 1), P)), np.empty(P), np.empty(P)
    _products(array, points, table, A, 0, K, h)
    B, W = np.empty((K, c), np.complex128), np.empty((K, c), np.complex128)
    for k in range(K):
        for j in range(c):
            re, im = inner_product(A, uint(k), rows, uint(j))
            B[k, j] = complex(re, im)
    L, remaining = np.empty((K - 1, K - 1), np.complex128), np.empty_like(b)
    found, alike = np.empty(K, np.int64), np.empty(K)
    for k in range(K):
        for i in range(K - 1):  # the others: i, or i + 1 from k on
            for o in range(i):
                re, im = inner_product(A, uint(i + (i >= k)), A, uint(o + (o >= k)))
                L[i, o] = complex(re, im)
        factorize(L, M)
        _start(b, M, remaining, left)
        for i in range(K - 1):
            for j in range(c):
                W[i, j] = B[i + (i >= k), j]
                for o in range(i):
                    W[i, j] -= L[i, o] * W[o, j]
                W[i, j] *= 1.0 / L[i, i].real
            _substitute(h, i + (i >= k), L, i, t)
            _remove(t, i, W[i], remaining, left)
        best = _best(remaining, c, left, SPANNED * M, gain)
        found[k] = best
        alike[k] = (h[0, k, best] ** 2 + h[1, k, best] ** 2) / (M * M)
    return found, alike
