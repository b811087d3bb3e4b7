"""Reads what can be read of a damaged results folder."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

from .carving import carved
from .damage import Damaged, guarded, remedy
from .schema import PLAN_COLUMNS, POSITION_COLUMNS, PROOF_COLUMNS, REFERENCE_COLUMNS, RESULT_COLUMNS
from .values import checked_row, unpacked

__all__ = ["Rescue"]

_LENGTHS = (len(RESULT_COLUMNS) - 1, len(RESULT_COLUMNS))  # files of schema 1 lack the last column
_KEYS = (
    *("name", "seed", "shard", "shards", "title", "expect", "error", "outlier_m", "plan", "runs", "tabled"),
    "reference",
)
_BLANK: dict[str, Any] = {  # what a rescued result can do without, and what stands in its place
    "message": "", "runtime_s": None, "cpu_s": None, "traces": b"", "host": "", "worker": 0, "finished": None
}  # fmt: skip


@final
class Rescue:
    """The undamaged rows of a folder's ``runs.sqlite``.

    meta: the properties of the study that can be read.
    plan: rows of this table by ordinal, in which every value is possible.
    results: when each result was computed, by run; of several results of a run, the last.
    proofs, references: rows of ``reference_plan`` by ordinal, and of ``reference_optima`` by identity.
    positions: rows of this table by run, in which every value is possible.
    blanked: runs of which something was damaged that no table needs, and is left out: the message, times, traces.

    Raises Damaged if nothing can be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.meta: dict[str, str] = {}
        self.plan: dict[int, tuple[Any, ...]] = {}
        self.results: dict[str, float] = {}
        self.blanked: set[str] = set()
        self.proofs: dict[int, tuple[Any, ...]] = {}
        self.references: dict[str, tuple[Any, ...]] = {}
        self.positions: dict[str, tuple[Any, ...]] = {}
        self._bad: set[str] = set()
        with guarded(path):
            for rowid, row in carved(path):
                self._sort(rowid, row)
        if not self.results:
            raise Damaged(f"{path} is damaged, and no run can be read; {remedy(path.parent).partition('; ')[2]}")

    @property
    def lost(self) -> int:
        """The least number of results that cannot be read."""
        tabled = self.meta.get("tabled", "").partition(" ")[0]  # the number of proofs follows that of runs
        finished = int(tabled) if tabled.isdecimal() and len(tabled) < 10 else 0
        return max(len(self._bad - set(self.results)), finished - len(self.results))

    @property
    def unplanned(self) -> int:
        """Number of results whose run is not in the plan, as far as it can be read."""
        return len(set(self.results) - {row[1] for row in self.plan.values()})

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the columns of each result; the file is read again, so that its traces are not kept in memory."""
        left = dict(self.results)
        for rowid, row in carved(self._path):
            if rowid is None and len(row) in _LENGTHS and row[0] in left:
                found, _ = _result(row)
                if found and left[found[0]] == (found[-1] or 0.0):
                    del left[found[0]]
                    yield found

    def _sort(self, rowid: int | None, row: tuple[Any, ...]) -> None:
        """Keep a row if it is one of ours and undamaged."""
        if rowid is not None and len(row) == len(PLAN_COLUMNS):
            with contextlib.suppress(ValueError):
                checked_row("plan", PLAN_COLUMNS, (rowid, *row[1:]))
                self.plan[rowid] = (rowid, *row[1:])
        elif rowid is not None and len(row) == len(PROOF_COLUMNS):
            with contextlib.suppress(ValueError):
                checked_row("reference_plan", PROOF_COLUMNS, (rowid, *row[1:]))
                self.proofs[rowid] = (rowid, *row[1:])
        elif rowid is None and len(row) == len(REFERENCE_COLUMNS):
            with contextlib.suppress(ValueError):
                checked_row("reference_optima", REFERENCE_COLUMNS, row)
                if (row[-1] or 0.0) >= (self.references.get(row[0], row)[-1] or 0.0):
                    self.references[row[0]] = row
        elif rowid is None and len(row) == len(POSITION_COLUMNS):
            with contextlib.suppress(ValueError):
                checked_row("positions", POSITION_COLUMNS, row)
                self.positions[row[0]] = row
        elif rowid is None and len(row) == 2 and row[0] in _KEYS and isinstance(row[1], str):
            self.meta[row[0]] = row[1]
        elif rowid is None and len(row) in _LENGTHS and isinstance(row[0], str):
            found, blanked = _result(row)
            if found is None:
                self._bad.add(row[0])
            else:
                self.results[row[0]] = max(self.results.get(row[0], 0.0), found[-1] or 0.0)
                self.blanked |= {row[0]} if blanked else set()


def _result(row: tuple[Any, ...]) -> tuple[tuple[Any, ...] | None, bool]:
    """A row of ``results`` with all columns, None if it is damaged; and whether something in it is left blank."""
    kept, blanked = [], False
    for name, value in zip(RESULT_COLUMNS, (*row, None), strict=False):
        try:
            checked_row("results", [name], [value])
            if name == "traces":
                unpacked(value)
        except Exception:  # of whatever kind
            if name not in _BLANK:
                return None, False
            blanked, value = True, _BLANK[name]
        kept.append(value)
    return tuple(kept), blanked
