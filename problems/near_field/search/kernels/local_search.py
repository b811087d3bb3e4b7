"""Levenberg–Marquardt on the variable projection, within a box."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray

from nfbench import compiled

from ...objectives.kernels.packing import ArrayModel
from .misfit import derivatives, fit_of, misfit, pack

__all__ = ["local_search"]

ITERATIONS = 100
FIRST_DAMPING, LAST_DAMPING = 1e-3, 1e12  # μ
LONGEST = 0.25  # of a step in each coordinate: in beamwidths and depths of focus
ENOUGH = 1e-15  # decrease of J, relative to J, at which the search ends
LOST = 1e-13  # predicted decrease below which J may rise by its rounding errors alone
ROUNDING = 1e-30  # decrease of J, relative to ‖F‖², below which J is only the rounding of R
FLAT = 1e-14  # least curvature, relative to the greatest: a planar wavefront has none along the range


class Box(NamedTuple):
    """The bounds of one source and the units of its coordinates: z = angle/unit, or 1/(range·unit)."""

    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    unit: Float[ndarray, " d"]


@compiled()
def _bounds(box: Box, i: int) -> tuple[float, float]:
    """The bounds of coordinate i of z; those of the inverse range change places."""
    d = len(box.unit)
    c = i % d
    if c == d - 1:
        return 1.0 / (box.upper[c] * box.unit[c]), 1.0 / (box.lower[c] * box.unit[c])
    return box.lower[c] / box.unit[c], box.upper[c] / box.unit[c]


@compiled()
def _place(box: Box, z: Float[ndarray, " n"], X: Float[ndarray, "1 n"]) -> None:
    """x of z [rad, m], exactly on an edge where z is."""
    d = len(box.unit)
    for i in range(len(z)):
        c = i % d
        low, high = _bounds(box, i)
        if c == d - 1:
            r = 1.0 / (z[i] * box.unit[c])
            X[0, i] = box.upper[c] if z[i] <= low else box.lower[c] if z[i] >= high else r
        else:
            X[0, i] = box.lower[c] if z[i] <= low else box.upper[c] if z[i] >= high else z[i] * box.unit[c]
        X[0, i] = min(max(X[0, i], box.lower[c]), box.upper[c])


# ------------------------------------------------------------------------------------------------- the step


class Model(NamedTuple):
    """The model J + 2g·s + sᵀHs of a step s, its limits, and room to solve for the step."""

    g: Float[ndarray, " n"]
    H: Float[ndarray, "n n"]
    low: Float[ndarray, " n"]
    high: Float[ndarray, " n"]
    s: Float[ndarray, " n"]
    held: Bool[ndarray, " n"]
    L: Float[ndarray, "n n"]


@compiled()
def _solve_free(model: Model, damping: float) -> None:
    """(H + μ·diag H)s = −g in the coordinates that are not held, given s in the others, by Cholesky's factorization."""
    g, H, s, held, L = model.g, model.H, model.s, model.held, model.L
    n = len(g)
    greatest = 1e-300
    for i in range(n):
        greatest = max(greatest, H[i, i])
    for i in range(n):
        if held[i]:
            continue
        size = max(H[i, i], FLAT * greatest)
        pivot = H[i, i] + damping * size
        total = -g[i]
        for j in range(n):
            if held[j]:
                total -= H[i, j] * s[j]
        for j in range(i):
            if held[j]:
                continue
            v = H[i, j]
            for k in range(j):
                if not held[k]:
                    v -= L[i, k] * L[j, k]
            v /= L[j, j]
            L[i, j] = v
            pivot -= v * v
            total -= v * s[j]
        L[i, i] = math.sqrt(max(pivot, FLAT * size))
        s[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        if held[i]:
            continue
        for j in range(i + 1, n):
            if not held[j]:
                s[i] -= L[j, i] * s[j]
        s[i] /= L[i, i]


@compiled()
def _step(model: Model, damping: float, fixed: int) -> tuple[float, bool]:
    """The step s within its limits; returns the decrease of J that the model predicts, and whether a limit was met.

    The first ``fixed`` coordinates are held, and those at an edge of the box from which the gradient points outwards.
    What leaves the limits is put on them, and the other coordinates are solved again given those.
    """
    g, H, low, high, s, held = model.g, model.H, model.low, model.high, model.s, model.held
    n = len(g)
    for i in range(n):
        s[i] = 0.0
        held[i] = i < fixed or (low[i] >= 0.0 and g[i] >= 0.0) or (high[i] <= 0.0 and g[i] <= 0.0)
    limited = False
    for _ in range(n):
        _solve_free(model, damping)
        inside = True
        for i in range(n):
            if not held[i] and not low[i] <= s[i] <= high[i]:
                s[i] = low[i] if s[i] < low[i] else high[i]
                held[i], inside = True, False
        if inside:
            break
        limited = True
    drop = 0.0
    for i in range(n):
        curved = 0.0
        for j in range(n):
            curved += H[i, j] * s[j]
        drop -= s[i] * (2.0 * g[i] + curved)
    return drop, limited


@compiled()
def _limit(model: Model, box: Box, z: Float[ndarray, " n"]) -> None:
    for i in range(len(z)):
        low, high = _bounds(box, i)
        model.low[i], model.high[i] = max(low - z[i], -LONGEST), min(high - z[i], LONGEST)


# ------------------------------------------------------------------------------------------------- the search


@compiled()
def _advance(box: Box, model: Model, z: Float[ndarray, " n"], trial: Float[ndarray, " n"]) -> None:
    """trial = z + s, exactly on an edge where s ends there."""
    for i in range(len(z)):
        low, high = _bounds(box, i)
        trial[i] = min(max(z[i] + model.s[i], low), high)
        if model.s[i] == low - z[i]:
            trial[i] = low
        elif model.s[i] == high - z[i]:
            trial[i] = high


@compiled()
def local_search(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    F: Complex[ndarray, "m c"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    unit: Float[ndarray, " d"],
    start: Float[ndarray, " n"],
    fixed: int,
) -> tuple[Float[ndarray, " n"], float, Float[ndarray, "n n"], int, float]:
    """A local minimizer x, its J and H, the number of steps tried, and the least pivot of AᴴA relative to M.

    The first ``fixed`` coordinates keep their values.
    """
    array, box = ArrayModel(wavelength, wavefront, geometry, M), Box(lower, upper, unit)
    n, d = len(start), len(unit)
    fit = fit_of(pack(F, geometry.shape[1]), n // d, d)
    energy = 0.0
    for m in range(M):
        for j in range(F.shape[1]):
            energy += F[m, j].real ** 2 + F[m, j].imag ** 2
    vectors, matrices = np.empty((6, n)), np.empty((2, n, n))
    model = Model(vectors[0], matrices[0], vectors[1], vectors[2], vectors[3], np.empty(n, np.bool_), matrices[1])
    z, trial = vectors[4], vectors[5]
    X, best = np.empty((1, n)), np.empty(n)
    for i in range(n):
        X[0, i] = best[i] = start[i]
        z[i] = start[i] / unit[i % d] if i % d < d - 1 else 1.0 / (start[i] * unit[i % d])
    J, pivot = misfit(array, fit, X)
    derivatives(array, fit, X, unit, model.g, model.H)
    damping, growth, steps = FIRST_DAMPING, 2.0, 0
    while steps < ITERATIONS and damping <= LAST_DAMPING:
        _limit(model, box, z)
        predicted, limited = _step(model, damping, fixed)
        if not predicted > ENOUGH * J + ROUNDING * energy:
            if not limited:
                break
            damping, growth = damping * growth, 2.0 * growth
            continue
        _advance(box, model, z, trial)
        _place(box, trial, X)
        steps += 1
        value, smallest = misfit(array, fit, X)
        drop = J - value
        if not drop > 0.0:
            if predicted <= LOST * J:
                break
            damping, growth = damping * growth, 2.0 * growth
            continue
        for i in range(n):
            z[i], best[i] = trial[i], X[0, i]
        J, pivot = value, smallest
        derivatives(array, fit, X, unit, model.g, model.H)
        damping *= max(0.1, 1.0 - (2.0 * drop / predicted - 1.0) ** 3)
        growth = 2.0
        if drop <= ENOUGH * J:
            break
    return best, J, model.H.copy(), steps, pivot
