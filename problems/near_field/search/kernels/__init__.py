"""The compiled kernels of the search for sources: the grid, the local search, and the curvature at its end."""

from __future__ import annotations

from functools import cache
from typing import Any

from numba import types

from nfbench import load_kernels

from .grid_search import choose_greedily, choose_replacements, respond_all
from .local_search import local_search
from .misfit import misfit_and_derivatives
from .standard_errors import inverse_curvature

__all__ = [
    "choose_greedily",
    "choose_replacements",
    "inverse_curvature",
    "local_search",
    "misfit_and_derivatives",
    "respond_all",
    "warm_up",
]

_VECTOR, _MATRIX, _ROWS = (types.Array(types.float64, n, "C") for n in (1, 2, 3))
_POINT = types.Array(types.float64, 1, "A", readonly=True, aligned=False)  # any strides
_POINTS = types.Array(types.float64, 2, "C", readonly=True)
_FACTOR = types.Array(types.complex128, 2, "A", readonly=True)
_ARRAY = (types.float64, types.int64, _MATRIX, types.int64)  # the fields of ArrayModel
_TABLE = (_POINTS, types.Array(types.float64, 3, "C"))
_SIGNATURES: list[tuple[Any, tuple[Any, ...]]] = [
    (respond_all, (*_ARRAY, _POINTS)),  # the quickest to compile
    (choose_greedily, (*_ARRAY, *_TABLE, _FACTOR, types.int64)),
    (choose_replacements, (*_ARRAY, *_TABLE, _FACTOR, _ROWS, _POINT)),
    (misfit_and_derivatives, (*_ARRAY, _FACTOR, _POINT, _POINT)),
    (inverse_curvature, (*_ARRAY, _FACTOR, _FACTOR, *(_POINT,) * 4)),
    (local_search, (*_ARRAY, _FACTOR, *(_POINT,) * 4, types.int64)),
]


@cache
def warm_up() -> None:
    """Load every kernel from the cache, or compile it and say so on stderr; nothing is compiled after this."""
    load_kernels(_SIGNATURES, "compiling the search (once per machine, some 20 s)")
