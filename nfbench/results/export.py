"""What the exports of a study have in common: what they report, and which paths they write."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from nfbench.core import NfbenchError, Status

if TYPE_CHECKING:
    from .results import Results
    from .rows import TracedRun

__all__ = ["Exported", "refuse_existing", "safe_name", "status_or"]

NAME_LENGTH = 80  # maximum length of a file or folder name made from a label [characters]


@dataclass
class Exported:
    """What an export wrote.

    path: file or folder that was written.
    runs: number of exported runs.
    total: number of runs in the study.
    misses: number of exported runs that are not ok, and were written as runs that reach no target.
    left_out: number of runs that were left out, by reason.
    """

    path: Path
    runs: int = 0
    total: int = 0
    misses: int = 0
    left_out: Counter[str] = field(default_factory=Counter)

    def __str__(self) -> str:
        text = f"{self.path}: {self.runs} of {self.total} runs"
        if self.misses:
            text += f", of which {self.misses} {'is' if self.misses == 1 else 'are'} not ok"
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())
        return text + (f"; left out: {reasons}" if reasons else "")

    def takes(self, reason: str | None) -> bool:
        """Count one more run; return False if there is a reason to leave it out."""
        if reason is None:
            self.runs += 1
        else:
            self.left_out[reason] += 1
        return reason is None

    def close(self, results: Results) -> None:
        """Count the unfinished runs. Raises NfbenchError if there was nothing to write."""
        self.total = sum(results.counts.values())
        if left := self.total - self.runs - sum(self.left_out.values()):
            self.left_out["open"] = left
        if not self.runs:
            reason = "no finished run can be exported" if self.total > left else "no run has finished yet"
            raise NfbenchError(f"{results.folder}: {reason}; nothing was written ({self})")


def refuse_existing(out: Path) -> None:
    """Raise NfbenchError if there is something at this path already."""
    if out.exists() or out.is_symlink():
        raise NfbenchError(f"{out} already exists; remove it, or choose another path with --out")


def status_or(run: TracedRun, reason_if_ok: str) -> str:
    """Return the status of a run that is left out, or the given reason if its status is ok."""
    return reason_if_ok if run.status == Status.OK else run.status


def safe_name(label: str, taken: Iterable[str] = ()) -> str:
    """Return a label as a valid file name on any system, unlike those taken even where case is ignored."""
    name = re.sub(r"[^A-Za-z0-9+-]+", "_", label).strip("_-")[:NAME_LENGTH] or "_"
    lowered, number, found = {other.lower() for other in taken}, 2, name
    while found.lower() in lowered:
        found, number = f"{name}-{number}", number + 1
    return found
