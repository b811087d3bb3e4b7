"""How a run can end."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Status"]


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
