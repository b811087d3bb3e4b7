"""What a solver may spend on one problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .options import Ge, Gt, Options

__all__ = ["Budget"]


@dataclass(frozen=True)
class Budget(Options):
    """What a solver may spend on one problem; at least one of evaluations and seconds must be given.

    evaluations: evaluations of the objective.
    seconds: wall-clock time [s] from the solver's start, checked before each evaluation.
    target: the objective value at which the solver has reached its goal and stops.
    """

    evaluations: Annotated[int, Ge(1)] | None = None
    seconds: Annotated[float, Gt(0.0)] | None = None
    target: float | None = None

    def validate(self) -> None:
        if self.evaluations is None and self.seconds is None:
            raise ValueError("expected a limit in evaluations or in seconds, got neither")
