"""A finite replacement for +inf, for libraries that cannot compute with infinite values."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

__all__ = ["Finite"]


@final
class Finite:
    """Replaces +inf by the largest finite value seen so far, or by ``start`` if there is none yet.

    The order of the values is preserved, except that +inf ties with the largest finite value.
    """

    def __init__(self, start: float) -> None:
        self.start = start
        self.worst = -math.inf

    def one(self, value: float) -> float:
        """Return the value, or its replacement if it is +inf."""
        if value < math.inf:
            self.worst = max(self.worst, value)
            return value
        return self.worst if self.worst > -math.inf else self.start

    def many(self, values: Float[ndarray, " p"]) -> Float[ndarray, " p"]:
        """Return the values with +inf replaced; the finite values of this batch are taken into account first."""
        finite = values < math.inf
        if finite.any():
            self.worst = max(self.worst, float(values[finite].max()))
        return np.where(finite, values, self.one(math.inf))
