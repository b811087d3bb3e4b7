"""How received data were read, as far as warnings about them depend on it."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Complex
from numpy import ndarray

__all__ = ["Reading"]


@dataclass(frozen=True, eq=False)
class Reading:
    """How received data were read.

    elements: what the user calls each row of the data, by name or number; empty: the numbers of the rows.
    short_blocks: why one source may seem to be several, and whether that is likely, because the blocks of which
        snapshots are the Fourier transforms are short; None: there is no such reason.
    transposed: the data with their axes exchanged, and the number of the other axis; None if only one axis fits.
    """

    elements: tuple[str, ...] = ()
    short_blocks: tuple[str, bool] | None = None
    transposed: tuple[Complex[ndarray, "m m"], int] | None = None
