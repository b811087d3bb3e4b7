"""The status with which a run ends."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Status"]


class Status(StrEnum):
    """The status with which a run ended. Every run is stored as a row with one of these values."""

    OK = "ok"
    FAILED = "failed"
    TIMEOUT = "timeout"
    CRASHED = "crashed"
    INVALID = "invalid"
    SKIPPED = "skipped"

    @property
    def sentence(self) -> str:
        """Explanation of this status for the user."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "The run ended by itself or used up its budget, and gave a valid estimate.",
    Status.FAILED: "The solver or formulation raised an exception, or returned without evaluating a point.",
    Status.TIMEOUT: "The run exceeded run_timeout_s and was stopped.",
    Status.CRASHED: "The run's process died or ran out of memory.",
    Status.INVALID: "A point was outside the box, an array had the wrong shape, or no finite value or error was found.",
    Status.SKIPPED: "The formulation, the solver and the problem cannot be combined; the message says why.",
}
