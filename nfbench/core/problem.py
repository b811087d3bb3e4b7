"""The contract of a problem: a bounded black box that is minimized."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .errors import Incompatible

__all__ = ["Problem"]


class Problem(ABC):
    """A function to minimize over the box ``lower <= x <= upper``. It knows nothing of solvers.

    A subclass sets ``lower`` and ``upper``, both ``(n,)`` float64, finite and lower < upper, and implements
    ``evaluate``. Units are the problem's own and stated in its docstring.
    """

    lower: Float[ndarray, " n"]
    upper: Float[ndarray, " n"]
    has_gradient: ClassVar[bool] = False

    @property
    def dimension(self) -> int:
        """The number n of unknowns."""
        return len(self.lower)

    @abstractmethod
    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        """The values at p points, one a row. The hot path: no checks, ``X`` is not changed."""

    def value(self, x: Float[ndarray, " n"]) -> float:
        """The value at one point; override where one point can be had faster than a batch of one."""
        return float(self.evaluate(x[None, :])[0])

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """The value and the gradient at one point; implemented where ``has_gradient`` is true."""
        raise Incompatible(f"{type(self).__name__} has no analytic gradient")


def check_box(lower: ndarray, upper: ndarray) -> tuple[ndarray, ndarray]:
    """The bounds as read-only float64 copies; raises ValueError unless both are (n,), finite, lower < upper."""
    lower, upper = (np.array(bound, dtype=np.float64) for bound in (lower, upper))
    if lower.ndim != 1 or lower.shape != upper.shape or not lower.size:
        raise ValueError(
            f"lower and upper: expected two vectors of one length, got shapes {lower.shape}, {upper.shape}"
        )
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower < upper).all()):
        raise ValueError(f"lower and upper: expected finite bounds with lower < upper, got {lower} and {upper}")
    lower.flags.writeable = upper.flags.writeable = False
    return lower, upper
