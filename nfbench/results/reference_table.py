"""The proven optima in the store of a study: which are planned, and what the finished proofs have given."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol, final

from nfbench.core import Status, printable
from nfbench.study import RunRecord, Study

from .damage import guarded
from .rows import proof_row, reference_row
from .schema import PROOF_COLUMNS, REFERENCE_COLUMNS, marks

__all__ = ["COLUMNS", "ReferenceTable"]

COLUMNS = (  # from which a row of references.csv is made
    *("reference_id", "swept", "scene", "instance_seed", "formulation", "status", "message", "value", "gap"),
    *("certified", "step", "seconds", "cpu_s", "columns", "point"),
)
_JOINED = "FROM reference_plan JOIN reference_optima USING (reference_id) ORDER BY ordinal"
_COUNTED = "SELECT COALESCE(status, 'open'), COUNT(*) FROM reference_plan LEFT JOIN reference_optima"


class _Database(Protocol):
    """What a store offers to its tables."""

    path: Path

    @property
    def connection(self) -> sqlite3.Connection: ...

    def select(self, sql: str, args: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]: ...

    def checked(
        self, table: str, names: Sequence[str], source: str, args: Sequence[Any] = ()
    ) -> Iterator[tuple[list[Any], tuple[Any, ...]]]: ...

    def writing(self) -> AbstractContextManager[sqlite3.Connection]: ...


@final
class ReferenceTable:
    """The tables ``reference_plan`` and ``reference_optima`` of a store, as ``plan`` and ``results`` are for runs.

    Files of schema 2 do not have them, and hold no proofs.
    """

    def __init__(self, store: _Database) -> None:
        self._store = store

    def exist(self) -> bool:
        """Whether the file has the tables."""
        query = "SELECT 1 FROM sqlite_master WHERE name = 'reference_plan'"
        return any(True for _ in self._store.select(query))

    def counts(self) -> dict[str, int]:
        """Number of planned proofs by status; those without a result count as ``open``."""
        if not self.exist():
            return {}
        found = dict(self._store.select(f"{_COUNTED} USING (reference_id) GROUP BY 1"))
        with guarded(self._store.path):
            for status in found:
                if status != "open":
                    Status(status)
        return found

    def open_ordinals(self) -> list[int]:
        """Positions in the plan of the proofs without a result, in order; only one of those with the same identity."""
        query = (
            "SELECT MIN(ordinal) FROM reference_plan WHERE reference_id NOT IN (SELECT reference_id FROM "
            "reference_optima) GROUP BY reference_id ORDER BY 1"
        )
        return [ordinal for (ordinal,) in self._store.select(query)]

    def failures(self) -> list[tuple[str, str, int, str]]:
        """(status, formulation, number, one of their messages) of the proofs that are not ok."""
        query = (
            f"SELECT status, formulation, COUNT(*), MIN(message) {_JOINED.partition(' ORDER')[0]} "
            f"WHERE status != 'ok' GROUP BY 1, 2 ORDER BY 3 DESC"
        )
        rows = self._store.select(query) if self.exist() else ()
        return [(printable(status), printable(label), count, printable(text)) for status, label, count, text in rows]

    def finished(self) -> Iterator[tuple[Any, ...]]:
        """Yield the columns COLUMNS of every finished proof of the plan, in order; columns and point decoded."""
        if self.exist():
            for values, _ in self._store.checked("reference_optima", COLUMNS, _JOINED):
                yield tuple(values)

    def plan_rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of ``reference_plan`` as stored."""
        if self.exist():
            for _, row in self._store.checked("reference_plan", PROOF_COLUMNS, "FROM reference_plan ORDER BY ordinal"):
                yield row

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of ``reference_optima`` as stored."""
        if self.exist():
            for _, row in self._store.checked("reference_optima", REFERENCE_COLUMNS, "FROM reference_optima"):
                yield row

    def add(self, records: Iterable[RunRecord]) -> None:
        """Write the records of proofs in one transaction; they are on disk when this returns."""
        rows = [reference_row(record) for record in records]
        with self._store.writing() as db:
            db.executemany(f"REPLACE INTO reference_optima VALUES ({marks(len(REFERENCE_COLUMNS))})", rows)

    def plan(self, study: Study, shard: tuple[int, int] | None) -> None:
        """Replace the plan by the proofs of the study, or those of shard k of n; within a transaction of the store."""
        specs = ((ordinal, study.reference(ordinal)) for ordinal in range(study.references))
        rows = (
            proof_row(ordinal, spec.repetition // study.runs_per_scene, spec)
            for ordinal, spec in specs
            if shard is None or int(spec.run_id, 16) % shard[1] == shard[0] - 1
        )
        db = self._store.connection
        db.execute("DELETE FROM reference_plan")
        db.executemany(f"INSERT INTO reference_plan VALUES ({marks(len(PROOF_COLUMNS))})", rows)
