"""The compiled kernels of the certificate: pruning by T3, and the components of touching boxes."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numba import types
from numpy import ndarray

from nfbench import compiled, load_kernels

from ..objectives.kernels.inner_products import inner_products_of_four, uint
from ..objectives.kernels.packing import ROWS, ArrayModel
from ..objectives.kernels.response_vectors import Source, phasor, respond

__all__ = ["bound_energy", "components", "prune", "subspace_distances", "warm_up"]

ROUNDING = 1e-11  # an upper bound of the error of D, with a margin of ten
WIDER = 1.0 + 1e-9  # factor on lengths and boxes, for their rounding
CENTRES = 1e-14  # relative rounding of the centres of boxes


@compiled()
def _source(c: Float[ndarray, " d"], is_sine: bool) -> Source:
    """The source with coordinates c; with sines, u may be outside [−1, 1]."""
    if is_sine:
        return Source(0.0, c[0], 1.0, 0.0, 1.0 / c[1], 0.0, 0.0)  # the angles are for gradients only
    cos_azimuth, sin_azimuth = phasor(c[0] * (0.5 / math.pi))
    cos_elevation, sin_elevation = 1.0, 0.0
    if len(c) == 3:
        cos_elevation, sin_elevation = phasor(c[1] * (0.5 / math.pi))
    return Source(cos_azimuth, sin_azimuth, cos_elevation, sin_elevation, 1.0 / c[-1], 0.0, 0.0)


@compiled()
def _energy(
    array: ArrayModel,
    L: Float[ndarray, "2 rows padded"],
    c: Float[ndarray, " d"],
    is_sine: bool,
    a: Float[ndarray, "2 1 padded"],
) -> float:
    """‖Lᴴa‖²."""
    respond(array, _source(c, is_sine), a, 0)
    energy = 0.0
    for j in range(uint(0), uint(L.shape[1]), uint(ROWS)):
        s0, s1, s2, s3, s4, s5, s6, s7 = inner_products_of_four(a, uint(0), L, j, uint(0))
        energy += s0 * s0 + s1 * s1 + s2 * s2 + s3 * s3 + s4 * s4 + s5 * s5 + s6 * s6 + s7 * s7
    return energy


@compiled()
def _distance(
    array: ArrayModel,
    U: Float[ndarray, "2 rows padded"],
    c: Float[ndarray, " d"],
    is_sine: bool,
    a: Float[ndarray, "2 1 padded"],
) -> float:
    """D = 1 − ‖Uᴴa‖²/M."""
    return 1.0 - _energy(array, U, c, is_sine, a) / array.M


@compiled()
def subspace_distances(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    U: Float[ndarray, "2 rows padded"],
    C: Float[ndarray, "p d"],
    is_sine: bool,
) -> Float[ndarray, " p"]:
    """D of p sources with coordinates C."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    a = np.empty((2, 1, geometry.shape[1]))
    D = np.empty(len(C))
    for p in range(len(C)):
        D[p] = _distance(array, U, C[p], is_sine, a)
    return D


@compiled()
def _square(F: Float[ndarray, "d d"], h: Float[ndarray, " d"]) -> float:
    """Σ_ij |F_ij| h_i h_j: a bound of the squared norm of every step within ± h."""
    square = 0.0
    for i in range(len(h)):
        for j in range(len(h)):
            square += abs(F[i, j]) * h[i] * h[j]
    return square


@compiled()
def _length(F: Float[ndarray, "d d"], R: Float[ndarray, " d"], h: Float[ndarray, " d"]) -> float:
    """β = √(Σ_ij |F_ij| h_i h_j) + Σ_i R_i h_i: no path from the centre of a box to one of its points is longer."""
    linear = 0.0
    for i in range(len(h)):
        linear += R[i] * h[i]
    return (math.sqrt(_square(F, h)) + linear) * WIDER


@compiled()
def _split(
    F: Float[ndarray, "d d"],
    R: Float[ndarray, " d"],
    c: Float[ndarray, " d"],
    h: Float[ndarray, " d"],
    stack_c: Float[ndarray, "n d"],
    stack_h: Float[ndarray, "n d"],
    depth: int,
) -> int:
    """Put both halves of a box, divided along its longest side, on the stack; returns the new depth."""
    side, longest = 0, 0.0
    for i in range(len(h)):
        length = h[i] * (math.sqrt(F[i, i]) + R[i])
        if length > longest:
            side, longest = i, length
    for sign in (-1.0, 1.0):
        stack_c[depth], stack_h[depth] = c, h
        stack_h[depth, side] = 0.5 * h[side]
        stack_c[depth, side] = c[side] + sign * 0.5 * h[side]
        depth += 1
    return depth


@compiled()
def prune(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    U: Float[ndarray, "2 rows padded"],
    is_sine: bool,
    shear: float,
    box: Float[ndarray, "2 d"],
    start: tuple[Float[ndarray, "n d"], Float[ndarray, "n d"], Int[ndarray, " n"]],
    metrics: tuple[Float[ndarray, "cells d d"], Float[ndarray, "cells d"]],
    threshold: Float[ndarray, " n"],
    share: float,
    most: int,
) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray, int]:
    """Depth first, the boxes that may hold a point with D <= f*, down to β <= share·α, α = arcsin √f*.

    start: centres, half-widths and cells of the boxes to begin with; threshold: f* for each of them. metrics: F and R
    of each cell. Returns centres, half-widths, cells, [D, β] and first boxes of the leaves, and the number of
    evaluations of D, which is negative if there would have been more than ``most`` leaves or 100·most evaluations.
    """
    array = ArrayModel(wavelength, wavefront, geometry, M)
    first_centres, first_halves, first_cells = start
    F, R = metrics
    d = first_centres.shape[1]
    a = np.empty((2, 1, geometry.shape[1]))
    centres, halves = np.empty((most, d)), np.empty((most, d))
    cells, values, origins = np.empty(most, np.int64), np.empty((most, 2)), np.empty(most, np.int64)
    stack_c, stack_h = np.empty((200, d)), np.empty((200, d))
    leaves, evaluations = 0, 0
    for n in range(len(first_centres)):
        cell, alpha = first_cells[n], math.asin(math.sqrt(min(threshold[n], 1.0)))
        stack_c[0], stack_h[0] = first_centres[n], first_halves[n]
        depth = 1
        while depth:
            depth -= 1
            c, h = stack_c[depth].copy(), stack_h[depth].copy()
            reach = h[0] * WIDER + abs(shear) * h[-1]
            at = c[0] + shear * c[-1]
            if at + reach < box[0, 0] or at - reach > box[1, 0]:
                continue
            if evaluations >= 100 * most or leaves >= most:
                return centres[:0], halves[:0], cells[:0], values[:0], origins[:0], -evaluations
            beta = _length(F[cell], R[cell], h)
            c[0] = at
            D = _distance(array, U, c, is_sine, a)
            evaluations += 1
            angle = beta + alpha
            if angle < 0.5 * math.pi and math.sin(angle) ** 2 < D - ROUNDING:
                continue  # T3
            c[0] -= shear * c[-1]
            if beta <= share * alpha or depth + 2 > 200:
                centres[leaves], halves[leaves], cells[leaves], origins[leaves] = c, h, cell, n
                values[leaves, 0], values[leaves, 1] = D, beta
                leaves += 1
                continue
            depth = _split(F[cell], R[cell], c, h, stack_c, stack_h, depth)
    return centres[:leaves], halves[:leaves], cells[:leaves], values[:leaves], origins[:leaves], evaluations


@compiled()
def _farthest(
    inverse: Float[ndarray, "d d"],
    centre: Float[ndarray, " d"],
    at: float,
    reach: float,
    c: Float[ndarray, " d"],
    h: Float[ndarray, " d"],
) -> float:
    """A bound of the squared distance in t from a point to any point of a box, whose first side is at ± reach."""
    farthest = 0.0
    for i in range(len(c)):
        middle, extent = 0.0, 0.0
        for j in range(len(c)):
            middle += inverse[i, j] * ((at if j == 0 else c[j]) - centre[j])
            extent += abs(inverse[i, j]) * (reach if j == 0 else h[j] * WIDER)
        farthest += (abs(middle) + extent) ** 2
    return farthest


@compiled()
def bound_energy(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    L: Float[ndarray, "2 rows padded"],
    is_sine: bool,
    shear: float,
    box: Float[ndarray, "2 d"],
    start: tuple[Float[ndarray, "n d"], Float[ndarray, "n d"]],
    metrics: tuple[Float[ndarray, "n d d"], Float[ndarray, "n d"], Float[ndarray, "n d d"], Float[ndarray, " n"]],
    ball: tuple[Float[ndarray, " d"], Float[ndarray, "d d"], float],
    largest: float,
    best: float,
    gap: float,
    most: int,
    where: Float[ndarray, " d"],
) -> tuple[float, int]:
    """T7: search the boxes ``start`` until √p, p = ‖Lᴴâ‖², is at most (1 + gap/2) times the best value known in each.

    metrics: F, R, the metric of t and n₂ of each box to begin with. ball: centre, matrix and radius of a ball within
    which p has no larger value. largest: s₁ = ‖L‖. best: √p of a known point. Returns the best √p and the number of
    evaluations, negative if there would have been more than ``most``. ``where`` becomes the best point found, if any.
    """
    array = ArrayModel(wavelength, wavefront, geometry, M)
    centres, halves = start
    F, R, Q, n2 = metrics
    centre, inverse, radius = ball
    d = centres.shape[1]
    a = np.empty((2, 1, geometry.shape[1]))
    stack_c, stack_h = np.empty((200, d)), np.empty((200, d))
    evaluations = 0
    for n in range(len(centres)):
        stack_c[0], stack_h[0] = centres[n], halves[n]
        depth = 1
        while depth:
            depth -= 1
            c, h = stack_c[depth].copy(), stack_h[depth].copy()
            at, reach = c[0] + shear * c[-1], h[0] * WIDER + abs(shear) * h[-1]
            if at + reach < box[0, 0] or at - reach > box[1, 0]:
                continue
            farthest = _farthest(inverse, centre, at, reach, c, h)
            if farthest <= radius * radius:
                continue
            if evaluations >= most or depth + 2 > 200:
                return best, -evaluations
            beta = _length(F[n], R[n], h)
            step = max(beta, math.sqrt(_square(Q[n], h)))
            c[0] = at
            g = math.sqrt(max(_energy(array, L, c, is_sine, a), 0.0) / M)
            evaluations += 1
            if g > best and box[0, 0] <= at <= box[1, 0]:
                best, where[:] = g, c
            stationary = g + 0.5 * largest * n2[n] * step * step
            turned = g * math.cos(beta) + largest * math.sin(beta) if beta < math.atan2(largest, g) else largest
            if min(stationary, turned) <= best * (1.0 + 0.5 * gap):
                continue
            c[0] -= shear * c[-1]
            depth = _split(F[n], R[n], c, h, stack_c, stack_h, depth)
    return best, evaluations


@compiled()
def components(centres: Float[ndarray, "n d"], halves: Float[ndarray, "n d"]) -> Int[ndarray, " n"]:
    """The number, from 0, of the component of touching boxes that each box belongs to."""
    n, d = centres.shape
    parent, rounding = np.arange(n), np.empty(d)  # of centres, which may exceed that of lengths
    for k in range(d):
        rounding[k] = CENTRES * np.abs(centres[:, k]).max()
    order = np.argsort(centres[:, 0] - halves[:, 0])
    for p in range(n):
        i = order[p]
        end = centres[i, 0] + halves[i, 0] * WIDER + rounding[0]
        for q in range(p + 1, n):
            j = order[q]
            if centres[j, 0] - halves[j, 0] * WIDER > end:
                break
            touching = True
            for k in range(1, d):
                if abs(centres[i, k] - centres[j, k]) > (halves[i, k] + halves[j, k]) * WIDER + rounding[k]:
                    touching = False
            if touching:
                x, y = i, j
                while parent[x] != x:
                    parent[x] = parent[parent[x]]
                    x = parent[x]
                while parent[y] != y:
                    parent[y] = parent[parent[y]]
                    y = parent[y]
                parent[max(x, y)] = min(x, y)
    names = np.full(n, -1)
    found, count = np.empty(n, np.int64), 0
    for i in range(n):
        x = i
        while parent[x] != x:
            x = parent[x]
        if names[x] < 0:
            names[x] = count
            count += 1
        found[i] = names[x]
    return found


_tuple: Any = types.Tuple
_MATRIX, _ROWS, _VECTOR = types.float64[:, ::1], types.float64[:, :, ::1], types.float64[::1]
_INTEGERS = types.int64[::1]
_ARRAY = (types.float64, types.int64, _MATRIX, types.int64)
_START, _METRICS = _tuple((_MATRIX, _MATRIX, _INTEGERS)), _tuple((_ROWS, _MATRIX))
_PRUNE = (*_ARRAY, _ROWS, types.boolean, types.float64, _MATRIX, _START, _METRICS, _VECTOR, types.float64, types.int64)
_BALL = _tuple((_VECTOR, _MATRIX, types.float64))
_BOUND = (
    *(*_ARRAY, _ROWS, types.boolean, types.float64, _MATRIX),
    *(_tuple((_MATRIX, _MATRIX)), _tuple((_ROWS, _MATRIX, _ROWS, _VECTOR)), _BALL),
    *(types.float64, types.float64, types.float64, types.int64, _VECTOR),
)
_SIGNATURES: list[tuple[Any, tuple[Any, ...]]] = [
    (components, (_MATRIX, _MATRIX)),
    (subspace_distances, (*_ARRAY, _ROWS, _MATRIX, types.boolean)),
    (prune, _PRUNE),
    (bound_energy, _BOUND),
]


@cache
def warm_up() -> None:
    """Load the kernels from the cache, or compile them and say so on stderr."""
    load_kernels(_SIGNATURES, "compiling the certificate (once per machine, some 15 s)")
