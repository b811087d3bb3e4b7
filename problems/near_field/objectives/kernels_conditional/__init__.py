"""The compiled kernels of the conditional fit: one candidate source given others.

They are apart from the other kernels so that a change of these does not compile all of them again. A value does not
depend on which other points are evaluated with it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from numba import types

from nfbench import load_kernels

from .conditional_fit import conditional_misfit, conditional_misfit_and_gradient

__all__ = ["conditional_misfit", "conditional_misfit_and_gradient", "warm_up"]

_ARRAY = (types.float64, types.int64, types.Array(types.float64, 2, "C"), types.int64)  # the fields of ArrayModel
_GIVEN = (types.Array(types.float64, 3, "C"), types.int64, types.float64, types.float64)  # rows, basis, energy, least
_POINT, _POINTS = (types.Array(types.float64, n, "A", readonly=True, aligned=False) for n in (1, 2))  # any strides
_SIGNATURES: list[tuple[Any, tuple[Any, ...]]] = [
    (conditional_misfit, (*_ARRAY, *_GIVEN, _POINTS)),
    (conditional_misfit_and_gradient, (*_ARRAY, *_GIVEN, _POINT)),
]


@cache
def warm_up() -> None:
    """Load every kernel from the cache, or compile it and say so on stderr; nothing is compiled after this."""
    load_kernels(_SIGNATURES, "compiling kernels of the conditional fit (once per machine, some 5 s)")
