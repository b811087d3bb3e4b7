"""Inner products aᴴl of a response with rows, such as those of a data factor or a subspace."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import compiled

from .packing import LANES, ROWS

__all__ = ["SUMS", "FourProducts", "Index", "gram_row", "inner_product", "inner_products_of_four", "uint"]

Index: TypeAlias = int | np.uint64
FourProducts: TypeAlias = tuple[float, float, float, float, float, float, float, float]

SUMS = {"contract", "reassoc", "nsz"}  # fused multiply-adds, and sums in any order: their rounding is that of BLAS
uint = np.uint64  # an index that is never negative, so that Numba emits no check for wraparound


@compiled(SUMS)
def inner_products_of_four(
    a: Float[ndarray, "2 p padded"], p: Index, rows: Float[ndarray, "2 rows padded"], j: Index, start: Index
) -> FourProducts:
    """aᴴl, real and imaginary parts in turn, of response p with rows j … j + 3, over the elements from ``start`` on."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    for m in range(start, uint(a.shape[2])):
        x, y = a[0, p, m], a[1, p, m]
        s0 += x * rows[0, j, m] + y * rows[1, j, m]
        s1 += x * rows[1, j, m] - y * rows[0, j, m]
        s2 += x * rows[0, j + uint(1), m] + y * rows[1, j + uint(1), m]
        s3 += x * rows[1, j + uint(1), m] - y * rows[0, j + uint(1), m]
        s4 += x * rows[0, j + uint(2), m] + y * rows[1, j + uint(2), m]
        s5 += x * rows[1, j + uint(2), m] - y * rows[0, j + uint(2), m]
        s6 += x * rows[0, j + uint(3), m] + y * rows[1, j + uint(3), m]
        s7 += x * rows[1, j + uint(3), m] - y * rows[0, j + uint(3), m]
    return s0, s1, s2, s3, s4, s5, s6, s7


@compiled(SUMS)
def inner_product(
    a: Float[ndarray, "2 p padded"], p: Index, rows: Float[ndarray, "2 rows padded"], j: Index
) -> tuple[float, float]:
    """aᴴl, real and imaginary part, of response p with row j alone."""
    s0 = s1 = 0.0
    for m in range(uint(a.shape[2])):
        s0 += a[0, p, m] * rows[0, j, m] + a[1, p, m] * rows[1, j, m]
        s1 += a[0, p, m] * rows[1, j, m] - a[1, p, m] * rows[0, j, m]
    return s0, s1


@compiled(inline=True)
def gram_row(rows: Float[ndarray, "2 rows padded"], c: int, j: int, h: Complex[ndarray, " rows"]) -> None:
    """h = a_jᴴ[F, a_0 … a_{j−1}]: row j of B, then row j of G left of its diagonal."""
    first = 0
    if c > LANES:  # column k of F is zero before element k
        first = c
        for k in range(uint(0), uint(c), uint(ROWS)):
            start = k // uint(LANES) * uint(LANES)
            s0, s1, s2, s3, s4, s5, s6, s7 = inner_products_of_four(rows, uint(c + j), rows, k, start)
            h[k] = complex(s0, s1)
            h[k + uint(1)] = complex(s2, s3)
            h[k + uint(2)] = complex(s4, s5)
            h[k + uint(3)] = complex(s6, s7)
    for k in range(uint(first), uint(c + j), uint(ROWS)):
        if k + uint(1) == uint(c + j):  # one is left over, as for K = 3
            s0, s1 = inner_product(rows, uint(c + j), rows, k)
            h[k] = complex(s0, s1)
            break
        s0, s1, s2, s3, s4, s5, s6, s7 = inner_products_of_four(rows, uint(c + j), rows, k, uint(0))
        h[k] = complex(s0, s1)
        h[k + uint(1)] = complex(s2, s3)
        h[k + uint(2)] = complex(s4, s5)
        h[k + uint(3)] = complex(s6, s7)
