"""What a solver found on one problem."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray

from .status import Status
from .trace import Trace

__all__ = ["Minimum"]


@dataclass(frozen=True)
class Minimum:
    """What a solver found.

    x: (n,) the best point, NaN if no finite value was met. value: its objective. evaluations: how many were made;
    gradients: how many of them with the gradient; nonfinite: how many gave NaN or ±inf. runtime_s: wall-clock
    time [s]. status, message: how it ended. trace: every improvement, thinned to under 1,000 rows. population: (p, n)
    the solver's last population and population_values: (p,) its values, best first; None where it keeps none.
    """

    x: Float[ndarray, " n"]
    value: float
    evaluations: int
    gradients: int
    nonfinite: int
    runtime_s: float
    status: Status
    message: str
    trace: Trace
    population: Float[ndarray, "p n"] | None = None
    population_values: Float[ndarray, " p"] | None = None
