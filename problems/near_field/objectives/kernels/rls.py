"""The kernels of RLS: the energy ‖aᴴL‖² of the data in the direction of a response, its gradient, and the repulsion.

L is any factor with LLᴴ = YYᴴ, lower triangular where it is square: row j of its packed form is zero before element j.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import compiled

from .inner_products import SUMS, inner_products_of_four, uint
from .packing import LANES, ROWS, ArrayModel
from .response_vectors import phase_gradient, respond, source_at

__all__ = ["projected_energy", "projected_energy_and_gradient", "repulsion"]

_BLOCK = 16  # candidates whose responses stay in the first-level cache while the factor streams past them


@compiled()
def _add_energies(
    array: ArrayModel,
    L: Float[ndarray, "2 rows padded"],
    X: Float[ndarray, "p d"],
    first: int,
    a: Float[ndarray, "2 block padded"],
    energies: Float[ndarray, " p"],
) -> None:
    """‖aᴴL‖² of the block of candidates that starts at ``first``; ``a`` takes their responses."""
    count = min(len(X) - first, _BLOCK)
    for p in range(count):
        respond(array, source_at(X, first + p, 0, X.shape[1], array.wavelength), a, p)
        energies[first + p] = 0.0
    for j in range(uint(0), uint(L.shape[1]), uint(ROWS)):
        start = j // uint(LANES) * uint(LANES)
        for p in range(uint(count)):
            b0, b1, b2, b3, b4, b5, b6, b7 = inner_products_of_four(a, p, L, j, start)
            energies[uint(first) + p] += ((b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3)) + (
                (b4 * b4 + b5 * b5) + (b6 * b6 + b7 * b7)
            )


@compiled()
def projected_energy(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    L: Float[ndarray, "2 rows padded"],
    X: Float[ndarray, "p d"],
) -> Float[ndarray, " p"]:
    """‖aᴴL‖² of p candidates (p, d) [rad, m]."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    a = np.empty((2, min(len(X), _BLOCK), geometry.shape[1]))
    energies = np.empty(len(X))
    for first in range(0, len(X), _BLOCK):
        _add_energies(array, L, X, first, a, energies)
    return energies


@compiled(SUMS)
def projected_energy_and_gradient(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    L: Float[ndarray, "2 rows padded"],
    x: Float[ndarray, " d"],
) -> tuple[float, Float[ndarray, " d"]]:
    """‖aᴴL‖² and 2Re(∂aᴴ·v), v = LLᴴa, of one candidate (d,) [rad, m]."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    a, v = np.empty((2, 1, geometry.shape[1])), np.zeros((2, 1, geometry.shape[1]))
    energy, gradient = 0.0, np.empty(len(x))
    source = source_at(np.expand_dims(x, 0), 0, 0, len(x), wavelength)
    respond(array, source, a, 0)
    for j in range(uint(0), uint(L.shape[1]), uint(ROWS)):
        start = j // uint(LANES) * uint(LANES)
        b0, b1, b2, b3, b4, b5, b6, b7 = inner_products_of_four(a, uint(0), L, j, start)
        energy += ((b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3)) + ((b4 * b4 + b5 * b5) + (b6 * b6 + b7 * b7))
        for m in range(start, uint(geometry.shape[1])):  # v += L_j·(aᴴL_j)*
            v[0, 0, m] += (
                (L[0, j, m] * b0 + L[1, j, m] * b1)
                + (L[0, j + uint(1), m] * b2 + L[1, j + uint(1), m] * b3)
                + (L[0, j + uint(2), m] * b4 + L[1, j + uint(2), m] * b5)
                + (L[0, j + uint(3), m] * b6 + L[1, j + uint(3), m] * b7)
            )
            v[1, 0, m] += (
                (L[1, j, m] * b0 - L[0, j, m] * b1)
                + (L[1, j + uint(1), m] * b2 - L[0, j + uint(1), m] * b3)
                + (L[1, j + uint(2), m] * b4 - L[0, j + uint(2), m] * b5)
                + (L[1, j + uint(3), m] * b6 - L[0, j + uint(3), m] * b7)
            )
    for m in range(geometry.shape[1]):  # ∂a = j2π·∂t·a, so 2Re(∂aᴴv) = 4π·∂t·Im(a*v)
        v[0, 0, m] = 4.0 * math.pi * (a[0, 0, m] * v[1, 0, m] - a[1, 0, m] * v[0, 0, m])
    phase_gradient(array, source, v, gradient)
    return energy, gradient


@compiled()
def repulsion(
    detected: Float[ndarray, "k d"], alpha: float, delta_min: float, X: Float[ndarray, "p d"]
) -> Float[ndarray, " p"]:
    """Σ_i α·max(0, δ_min − ‖θ − θ_i‖) of p candidates (p, d), with 1 rad and 1 m alike; ``detected`` are the θ_i."""
    total = np.zeros(len(X))
    for p in range(len(X)):
        for i in range(len(detected)):
            square = 0.0
            for c in range(X.shape[1]):
                square += (X[p, c] - detected[i, c]) ** 2
            total[p] += alpha * max(0.0, delta_min - math.sqrt(square))
    return total
