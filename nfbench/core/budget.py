"""The limits on what a solver may spend on one problem."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from .options import Ge, Gt, Le, Lt, Options

__all__ = ["Budget"]


@dataclass(frozen=True)
class Budget(Options):
    """The limits on what a solver may spend on one problem. At least one of evaluations and seconds is required.

    evaluations: maximum number of evaluations of the objective, at most 10^15; None for no limit.
    seconds: maximum wall-clock time [s] from the start of the solver, at most 10^9, checked before each evaluation or
    batch of evaluations; None for no limit.
    target: objective value, in the problem's unit, at or below which the solver is stopped; None for no target.
    """

    evaluations: Annotated[int, Ge(1), Le(10**15)] | None = None
    seconds: Annotated[float, Gt(0.0), Le(1e9)] | None = None
    target: Annotated[float, Gt(-math.inf), Lt(math.inf)] | None = None

    def validate(self) -> None:
        if self.evaluations is None and self.seconds is None:
            raise ValueError("expected a limit on evaluations or seconds, got neither")
