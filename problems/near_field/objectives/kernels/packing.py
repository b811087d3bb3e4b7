"""How arrays and factors of data are laid out for the kernels.

Every vector over the M elements is a row of float64, with its real and imaginary parts in separate rows, padded with
zeros to a multiple of LANES: each inner loop is then a plain sum over whole SIMD registers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

__all__ = [
    "EXACT",
    "FRESNEL",
    "LANES",
    "PAPER",
    "PLANAR",
    "ROWS",
    "WAVEFRONTS",
    "ArrayModel",
    "pack_factor",
    "pack_geometry",
    "pack_rows",
]

LANES = 16  # two of the widest SIMD registers (AVX-512), which LLVM keeps in flight per sum
ROWS = 4  # rows per inner product: 8 sums in flight hide the latency of a fused multiply-add
EXACT, FRESNEL, PAPER, PLANAR = range(4)
WAVEFRONTS = {"exact": EXACT, "fresnel": FRESNEL, "paper": PAPER, "planar": PLANAR}


class ArrayModel(NamedTuple):
    """What determines a response vector besides the source; compiled code passes it from kernel to kernel.

    Python passes the four fields one by one, because a tuple takes Numba 3 µs longer to unpack.
    """

    wavelength: float  # λ [m]
    wavefront: int  # a value of WAVEFRONTS
    geometry: Float[ndarray, "4 padded"]  # q_x, q_y, q_z [λ] and w = ‖q‖² [λ²]
    M: int  # elements


def pack_geometry(positions: Float[ndarray, "m 3"], wavelength_m: float) -> Float[ndarray, "4 padded"]:
    """The rows q_x, q_y, q_z [λ] and w = ‖q‖² [λ²]; (M, 3) ``positions`` [m]."""
    q = positions.T / wavelength_m
    return _pad(np.vstack([q, np.sum(q * q, axis=0)]), 1)


def pack_rows(columns: Complex[ndarray, "m c"]) -> Float[ndarray, "2 rows padded"]:
    """The real and the imaginary parts of c columns, one column per row; rows of zeros make c a multiple of ROWS."""
    return np.stack([_pad(part, ROWS) for part in (columns.real.T, columns.imag.T)])


def pack_factor(
    F: Complex[ndarray, "m c"], sources: int
) -> tuple[
    Float[ndarray, "2 rows padded"], Complex[ndarray, " rows"], Complex[ndarray, "k k"], Complex[ndarray, "k c"]
]:
    """F with room for the responses of K sources after it, and room for h, L and W of one candidate at a time.

    If there are more than LANES columns, F must be lower triangular; columns of zeros then make c a multiple of ROWS.
    Threads may share the arrays: a kernel holds the interpreter's lock while it writes there.
    """
    columns = F.shape[1] + (-F.shape[1] % ROWS if F.shape[1] > LANES else 0)
    room = np.zeros((len(F), columns - F.shape[1] + sources), np.complex128)
    rows = pack_rows(np.hstack([F, room]))
    L, W = np.empty((sources, sources), np.complex128), np.empty((sources, columns), np.complex128)
    return rows, np.empty(rows.shape[1], np.complex128), L, W


def _pad(rows: ndarray, multiple: int) -> ndarray:
    r, m = rows.shape
    padded = np.zeros((r + -r % multiple, m + -m % LANES))
    padded[:r, :m] = rows
    return padded
