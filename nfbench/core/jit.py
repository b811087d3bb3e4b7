"""Compiled functions of plugins: Numba's, kept on disk, loaded before any clock runs.

They are compiled once a machine and kept in ``__pycache__`` beside their source, or where that is read-only in the
user's cache folder (Numba's own order; NUMBA_CACHE_DIR comes before both).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba

from .errors import NfbenchError

__all__ = ["compiled", "load_kernels"]

_F = TypeVar("_F", bound=Callable[..., Any])

_REMEDY = "set NUMBA_CACHE_DIR to a writable folder, or reinstall numba and llvmlite"


def compiled(fastmath: set[str] | bool = False) -> Callable[[_F], _F]:
    """Numba's njit with what all kernels share: no Python exceptions inside, and a cache on disk.

    Raises NfbenchError where there is no folder for the cache.
    """

    def compiled_with(function: _F) -> _F:
        try:
            kernel = numba.njit(cache=True, error_model="numpy", fastmath=fastmath)(function)
        except RuntimeError as error:
            raise NfbenchError(f"kernels: Numba {numba.__version__} cannot be used here: {error}; {_REMEDY}") from error
        return cast(_F, kernel)

    return compiled_with


def load_kernels(kernels: Sequence[tuple[Any, tuple[Any, ...]]], message: str) -> None:
    """Load each (kernel, signature) from the cache, or compile it; nothing is compiled for these kernels after this.

    ``message`` is told on stderr once the first of them, which should be the quickest, turns out not to be in the
    cache. Raises NfbenchError where Numba cannot compile.
    """
    try:
        for number, (kernel, signature) in enumerate(kernels):
            kernel.compile(signature)
            kernel.disable_compile()
            if number == 0 and kernel.stats.cache_misses:
                print(f"nfbench: {message} …", file=sys.stderr, flush=True)
    except (numba.core.errors.NumbaError, OSError, RuntimeError) as error:
        raise NfbenchError(f"kernels: Numba {numba.__version__} cannot compile here: {error}; {_REMEDY}") from error
