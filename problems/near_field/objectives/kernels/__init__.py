"""The compiled kernels of the objectives: response vectors, RLS and subspace fitting.

A value does not depend on which other points are evaluated with it: one point is a batch of one, because the same sum
may be rounded in another way in another kernel. Kernels are compiled once per machine and kept on disk; ``warm_up``
loads them before any clock runs.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from numba import types

from nfbench import load_kernels

from .packing import LANES, WAVEFRONTS, pack_factor, pack_geometry, pack_rows
from .response_vectors import NEAR, advance_slopes, phasors, responses, towards
from .rls import projected_energy, projected_energy_and_gradient, repulsion
from .subspace_fitting import fill_singular, misfit, misfit_and_gradient

__all__ = [
    "LANES",
    "NEAR",
    "WAVEFRONTS",
    "advance_slopes",
    "fill_singular",
    "misfit",
    "misfit_and_gradient",
    "pack_factor",
    "pack_geometry",
    "pack_rows",
    "phasors",
    "projected_energy",
    "projected_energy_and_gradient",
    "repulsion",
    "responses",
    "towards",
    "warm_up",
]

_VECTOR, _MATRIX, _ROWS = (types.Array(types.float64, n, "C") for n in (1, 2, 3))
_POINT, _POINTS = (types.Array(types.float64, n, "A", readonly=True, aligned=False) for n in (1, 2))  # any strides
_C1, _C2 = types.complex128[::1], types.complex128[:, ::1]
_ARRAY = (types.float64, types.int64, _MATRIX, types.int64)  # the fields of ArrayModel
_FACTOR = (types.float64, _ROWS, _C1, _C2, _C2)  # energy, rows, h, L, W
_REPULSION = (_POINTS, types.float64, types.float64)
_SIGNATURES: list[tuple[Any, tuple[Any, ...]]] = [
    (phasors, (_VECTOR,) * 3),  # the quickest to compile
    (towards, (types.float64,) * 7),
    (responses, (*_ARRAY, _POINTS)),
    (advance_slopes, (types.int64, _MATRIX, _POINT, _VECTOR)),
    (projected_energy, (*_ARRAY, _ROWS, _POINTS)),
    (projected_energy_and_gradient, (*_ARRAY, _ROWS, _POINT)),
    (repulsion, (*_REPULSION, _POINTS)),
    (misfit, (*_ARRAY, *_FACTOR, _POINTS)),
    (misfit_and_gradient, (*_ARRAY, *_FACTOR, _POINT)),
    (fill_singular, (*_ARRAY, *_FACTOR, _POINTS, _VECTOR, _MATRIX)),
]


@cache
def warm_up() -> None:
    """Load every kernel from the cache, or compile it and say so on stderr; nothing is compiled after this."""
    load_kernels(_SIGNATURES, "compiling kernels (once per machine, some 10 s)")
