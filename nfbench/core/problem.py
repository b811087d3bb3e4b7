"""The contract of a problem: a function on a box, which a solver minimizes as a black box."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .errors import Incompatible

__all__ = ["Problem"]


class Problem(ABC):
    """A function to minimize over the box ``lower <= x <= upper``, independent of any solver.

    A subclass sets ``lower`` and ``upper``, which are finite float64 arrays of shape ``(n,)`` with lower < upper, and
    implements ``evaluate``. Its docstring states the units of the unknowns and of the value.

    ``minimum`` is the smallest value over the box where it is known, else None. A gap is measured from it.
    """

    lower: Float[ndarray, " n"]
    upper: Float[ndarray, " n"]
    has_gradient: ClassVar[bool] = False
    minimum: float | None = None

    @property
    def dimension(self) -> int:
        """Number n of unknowns."""
        return len(self.lower)

    @abstractmethod
    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        """Return the values at p points, one point per row.

        This is the hot path: the method need not check ``X``, and it must not change it.
        """

    def value(self, x: Float[ndarray, " n"]) -> float:
        """Return the value at one point. Override it if that is faster than evaluating a batch of one point."""
        return float(self.evaluate(x[None, :])[0])

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """Return the value and the gradient at one point. Override it in problems whose ``has_gradient`` is true."""
        raise Incompatible(f"{type(self).__name__} has no analytic gradient")


def check_box(lower: ndarray, upper: ndarray) -> tuple[ndarray, ndarray]:
    """Return the bounds as read-only float64 copies.

    Raises ValueError unless both are finite and of shape (n,), with n >= 1 and lower < upper.
    """
    lower, upper = (np.array(bound, dtype=np.float64) for bound in (lower, upper))
    if lower.ndim != 1 or lower.shape != upper.shape or not lower.size:
        raise ValueError(
            f"lower and upper: expected two vectors of equal length, got shapes {lower.shape} and {upper.shape}"
        )
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower < upper).all()):
        raise ValueError(f"lower and upper: expected finite bounds with lower < upper, got {lower} and {upper}")
    lower.flags.writeable = upper.flags.writeable = False
    return lower, upper
