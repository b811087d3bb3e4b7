"""The compiled kernels of the signal subspace."""

from __future__ import annotations

from functools import cache

from numba import types

from nfbench import load_kernels

from .block_power import fix_phases, power_iteration

__all__ = ["fix_phases", "power_iteration", "warm_up"]

_FACTOR = types.Array(types.complex128, 2, "A", readonly=True)
_COLUMNS = types.Array(types.complex128, 2, "C", readonly=True)
_SIGNATURES = [
    (fix_phases, (_FACTOR,)),  # the quickest to compile
    (power_iteration, (_COLUMNS, _COLUMNS, types.int64, types.float64)),
]


@cache
def warm_up() -> None:
    """Load every kernel from the cache, or compile it and say so on stderr; nothing is compiled after this."""
    load_kernels(_SIGNATURES, "compiling kernels of the signal subspace (once per machine, some 5 s)")
