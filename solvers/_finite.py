"""A finite stand-in for +inf, for libraries whose arithmetic it breaks."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

__all__ = ["Finite"]


@final
class Finite:
    """Replaces +inf by the largest finite value met so far, or by ``start`` before there is one.

    The order of the values is kept, but for ties with that largest one.
    """

    def __init__(self, start: float) -> None:
        self.start = start
        self.worst = -math.inf

    def one(self, value: float) -> float:
        """The value, or its stand-in."""
        if value < math.inf:
            self.worst = max(self.worst, value)
            return value
        return self.worst if self.worst > -math.inf else self.start

    def many(self, values: Float[ndarray, " p"]) -> Float[ndarray, " p"]:
        """The values, the finite ones among them considered first."""
        finite = values < math.inf
        if finite.any():
            self.worst = max(self.worst, float(values[finite].max()))
        return np.where(finite, values, self.one(math.inf))
