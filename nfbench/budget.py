"""What a solver may spend, and how a run can end."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from .options import Ge, Gt, Options

__all__ = ["Budget", "Status"]


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


class Status(StrEnum):
    """How a run ended. Every run becomes a row with one of these."""

    OK = "ok"
    FAILED = "failed"
    TIMEOUT = "timeout"
    CRASHED = "crashed"
    INVALID = "invalid"
    SKIPPED = "skipped"

    @property
    def sentence(self) -> str:
        """What this status means, for the user."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "The run ended by itself or used up its budget, with a valid estimate.",
    Status.FAILED: "The solver or formulation raised an exception, or returned without evaluating a point.",
    Status.TIMEOUT: "The run exceeded run_timeout_s and was stopped.",
    Status.CRASHED: "The process of the run died, or ran out of memory.",
    Status.INVALID: "A point outside the box, a wrong shape, or no finite value was met.",
    Status.SKIPPED: "The pair cannot work together; the message says why.",
}
