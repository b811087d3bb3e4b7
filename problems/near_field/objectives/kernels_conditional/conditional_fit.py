"""The kernels of the conditional fit: J = E − N/D with N = ‖aᴴF⊥‖², D = M − ‖aᴴQ‖² = ‖P⊥a‖², E = ‖F⊥‖².

What they share:

    rows    the columns of Q, an orthonormal basis of the other sources, then those of F⊥ = (I − QQᴴ)F. F⊥ is lower
            triangular where it is square: its column j is zero before element j
    basis   the number of columns of Q
    energy  E
    least   the least D; below it a is in the span of the others, and J = E
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import compiled

from ..kernels.inner_products import SUMS, Index, inner_products_of_four, uint
from ..kernels.packing import LANES, ROWS, ArrayModel
from ..kernels.response_vectors import phase_gradient, respond, source_at

__all__ = ["conditional_misfit", "conditional_misfit_and_gradient"]

_BLOCK = 16  # candidates whose responses stay in the first-level cache while the rows stream past them


@compiled(inline=True)
def first_element(j: Index, basis: Index) -> Index:
    """The element from which on rows j … j + 3 may differ from zero, rounded down to whole registers."""
    return (j - basis) // uint(LANES) * uint(LANES) if j > basis else uint(0)


@compiled(inline=True)
def misfit(gained: float, inside: float, M: int, energy: float, least: float) -> float:
    """J = E − N/D, which rounding must not make negative; E where D is below ``least``."""
    D = M - inside
    return max(energy - gained / D, 0.0) if least < D else energy


@compiled()
def _misfits(
    array: ArrayModel,
    rows: Float[ndarray, "2 rows padded"],
    basis: int,
    energy: float,
    least: float,
    X: Float[ndarray, "p d"],
    first: int,
    a: Float[ndarray, "2 block padded"],
    sums: Float[ndarray, "2 block"],
    J: Float[ndarray, " p"],
) -> None:
    """J of the block of candidates that starts at ``first``; ``a`` takes their responses, ``sums`` N and ‖aᴴQ‖²."""
    count = min(len(X) - first, _BLOCK)
    for p in range(count):
        respond(array, source_at(X, first + p, 0, X.shape[1], array.wavelength), a, p)
        sums[0, p] = sums[1, p] = 0.0
    for j in range(uint(0), uint(rows.shape[1]), uint(ROWS)):
        start = first_element(j, uint(basis))
        for p in range(uint(count)):
            b0, b1, b2, b3, b4, b5, b6, b7 = inner_products_of_four(a, p, rows, j, start)
            e0, e1, e2, e3 = b0 * b0 + b1 * b1, b2 * b2 + b3 * b3, b4 * b4 + b5 * b5, b6 * b6 + b7 * b7
            if j >= uint(basis):
                sums[0, p] += (e0 + e1) + (e2 + e3)
                continue
            sums[1, p] += e0
            sums[0 if j + uint(1) >= uint(basis) else 1, p] += e1
            sums[0 if j + uint(2) >= uint(basis) else 1, p] += e2
            sums[0 if j + uint(3) >= uint(basis) else 1, p] += e3
    for p in range(count):
        J[first + p] = misfit(sums[0, p], sums[1, p], array.M, energy, least)


@compiled()
def conditional_misfit(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    rows: Float[ndarray, "2 rows padded"],
    basis: int,
    energy: float,
    least: float,
    X: Float[ndarray, "p d"],
) -> Float[ndarray, " p"]:
    """J of p candidates (p, d) [rad, m]."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    a, sums = np.empty((2, min(len(X), _BLOCK), geometry.shape[1])), np.empty((2, _BLOCK))
    J = np.empty(len(X))
    for first in range(0, len(X), _BLOCK):
        _misfits(array, rows, basis, energy, least, X, first, a, sums, J)
    return J


@compiled(SUMS)
def conditional_misfit_and_gradient(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    rows: Float[ndarray, "2 rows padded"],
    basis: int,
    energy: float,
    least: float,
    x: Float[ndarray, " d"],
) -> tuple[float, Float[ndarray, " d"]]:
    """J and ∂J = −2Re(∂aᴴ·v)/D, v = F⊥F⊥ᴴa + (N/D)·QQᴴa, of one candidate (d,) [rad, m]; 0 where J = E."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    a, v = np.empty((2, 1, geometry.shape[1])), np.zeros((2, 1, geometry.shape[1]))
    b = np.empty((rows.shape[1], 2))  # aᴴ·row
    gained, inside, gradient = 0.0, 0.0, np.zeros(len(x))
    source = source_at(np.expand_dims(x, 0), 0, 0, len(x), wavelength)
    respond(array, source, a, 0)
    for j in range(uint(0), uint(rows.shape[1]), uint(ROWS)):
        products = inner_products_of_four(a, uint(0), rows, j, first_element(j, uint(basis)))
        for i in range(uint(ROWS)):
            b[j + i, 0], b[j + i, 1] = products[2 * i], products[2 * i + 1]
    for j in range(rows.shape[1]):
        square = b[j, 0] * b[j, 0] + b[j, 1] * b[j, 1]
        if j < basis:
            inside += square
        else:
            gained += square
    D = M - inside
    if not least < D:
        return energy, gradient
    for j in range(uint(rows.shape[1])):  # v += row_j·(aᴴ·row_j)*, with weight N/D for the columns of Q
        weight = gained / D if j < uint(basis) else 1.0
        re, im = weight * b[j, 0], weight * b[j, 1]
        for m in range(first_element(j, uint(basis)), uint(geometry.shape[1])):
            v[0, 0, m] += rows[0, j, m] * re + rows[1, j, m] * im
            v[1, 0, m] += rows[1, j, m] * re - rows[0, j, m] * im
    for m in range(geometry.shape[1]):  # ∂a = j2π·∂t·a, so −2Re(∂aᴴv)/D = −4π·∂t·Im(a*v)/D
        v[0, 0, m] = -4.0 * math.pi / D * (a[0, 0, m] * v[1, 0, m] - a[1, 0, m] * v[0, 0, m])
    phase_gradient(array, source, v, gradient)
    return misfit(gained, inside, M, energy, least), gradient
