"""The covariance of the minimizer from the curvature of the misfit."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray

from nfbench import compiled

from .misfit import misfit_and_derivatives

__all__ = ["inverse_curvature"]

CERTAIN = 1e-10
"""Least pivot of the curvature, scaled to a unit diagonal, and of AᴴA, relative to M, from which an inverse is formed.

The curvature carries rounding errors of some 1e-15, so that the inverse is right to some 1e-5 at least."""


@compiled()
def _invert(H: Float[ndarray, "n n"], free: Bool[ndarray, " n"]) -> bool:
    """H⁻¹ in the free coordinates, and 0 in the others, in place; returns whether H is certainly positive definite."""
    n = len(H)
    L, inverse = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        if not free[i]:
            H[i, i] = 1.0
            continue
        for j in range(i):
            if free[j]:
                total = H[i, j]
                for k in range(j):
                    total -= L[i, k] * L[j, k]
                L[i, j] = total / L[j, j]
        pivot = H[i, i]
        for k in range(i):
            pivot -= L[i, k] * L[i, k]
        if not pivot > CERTAIN * H[i, i]:
            return False
        L[i, i] = math.sqrt(pivot)
    for c in range(n):  # column c of L⁻¹
        if free[c]:
            inverse[c, c] = 1.0 / L[c, c]
            for i in range(c + 1, n):
                if free[i]:
                    total = 0.0
                    for k in range(c, i):
                        total -= L[i, k] * inverse[k, c]
                    inverse[i, c] = total / L[i, i]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(max(i, j), n):
                total += inverse[k, i] * inverse[k, j]
            H[i, j] = total
    return True


@compiled()
def inverse_curvature(
    wavelength: float,
    wavefront: int,
    geometry: Float[ndarray, "4 padded"],
    M: int,
    F: Complex[ndarray, "m c"],
    G: Complex[ndarray, "m c"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    unit: Float[ndarray, " d"],
    x: Float[ndarray, " n"],
) -> Float[ndarray, "n n"]:
    """H(F)⁻¹·H(G)·H(F)⁻¹ in [rad, m], or H(F)⁻¹ if G has no columns; coordinates on an edge of the box are held.

    Rows and columns of held coordinates are 0. All elements are NaN if H(F) is singular or sources coincide.
    """
    n, d = len(x), len(unit)
    _, _, H, apart = misfit_and_derivatives(wavelength, wavefront, geometry, M, F, unit, x)
    free, scale = np.empty(n, np.bool_), np.empty(n)
    for i in range(n):
        c = i % d
        free[i] = lower[c] < x[i] < upper[c]
        scale[i] = unit[c] if c < d - 1 else -x[i] * x[i] * unit[c]  # ∂θ/∂z
    if not apart > CERTAIN or not _invert(H, free):
        H[:] = math.nan
        return H
    C = H
    if G.shape[1]:
        meat = misfit_and_derivatives(wavelength, wavefront, geometry, M, G, unit, x)[2]
        half, C = np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            for j in range(n):
                for k in range(n):
                    half[i, j] += H[i, k] * meat[k, j]
        for i in range(n):
            for j in range(n):
                for k in range(n):
                    C[i, j] += half[i, k] * H[k, j]
    for i in range(n):
        for j in range(n):
            C[i, j] *= scale[i] * scale[j]
    return C
