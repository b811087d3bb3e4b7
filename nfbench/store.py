"""The store: one SQLite file that every table is made from."""

from __future__ import annotations

import io
import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from .errors import StoreError
from .execute import RunRecord
from .study import RunSpec, Study
from .trace import Trace

__all__ = ["Store"]

SCHEMA = 1
_TABLES = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS plan (
    ordinal INTEGER PRIMARY KEY, run_id TEXT NOT NULL UNIQUE, scenario TEXT, formulation TEXT, solver TEXT,
    method TEXT, repetition INTEGER, swept TEXT, instance_seed INTEGER, solver_seed INTEGER);
CREATE TABLE IF NOT EXISTS results (
    run_id TEXT PRIMARY KEY, status TEXT NOT NULL, message TEXT, objective REAL, evaluations INTEGER, runtime_s REAL,
    cpu_s REAL, scores TEXT, estimate TEXT, traces BLOB, host TEXT, worker INTEGER) WITHOUT ROWID;
"""


class Store:
    """The rows and traces of one study's folder, in ``runs.sqlite``.

    ``plan`` holds what the manifest asks for now, in order; ``results`` whatever was ever computed here. Tables show
    the results of the plan. Raises StoreError where the file cannot be opened, read or written.
    """

    def __init__(self, folder: Path, *, create: bool = False) -> None:
        self.path = folder / "runs.sqlite"
        if not create and not self.path.is_file():
            raise StoreError(f"{folder}: expected a results folder with runs.sqlite, found none")
        try:
            self._db = sqlite3.connect(self.path)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = NORMAL")
            self._db.executescript(_TABLES)
            schema = self.meta.setdefault("schema", str(SCHEMA)) if create else self.meta.get("schema")
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {error}") from error
        if schema != str(SCHEMA):
            raise StoreError(f"{self.path}: expected schema {SCHEMA}, found {schema}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()

    @property
    def meta(self) -> dict[str, str]:
        """What the folder belongs to, as text by key."""
        return dict(self._db.execute("SELECT key, value FROM meta"))

    def begin(self, study: Study) -> None:
        """Lay down the study's plan. Raises StoreError if the folder belongs to another study or seed."""
        asked = {"schema": str(SCHEMA), "name": study.name, "seed": str(study.seed)}
        found = self.meta
        differing = [
            f"{key} {found[key]!r} there, {value!r} asked for"
            for key, value in asked.items()
            if found.get(key, value) != value
        ]
        if differing:
            raise StoreError(
                f"{self.path.parent} belongs to another study: {'; '.join(differing)}; "
                f"choose another folder with --out, or move it aside with --fresh"
            )
        about = {"title": study.title, "expect": study.expect, "error": study.error, "outlier_m": study.outlier_m}
        with self._writing():
            self._db.executemany(
                "REPLACE INTO meta VALUES (?, ?)", [(k, str(v)) for k, v in {**asked, **about}.items()]
            )
            self._db.execute("DELETE FROM plan")
            self._db.executemany(
                "INSERT INTO plan VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (_plan_row(number, spec) for number, spec in enumerate(study.specs())),
            )

    def forget(self, statuses: Iterable[str]) -> None:
        """Drop the results of these statuses, so that their runs are made again."""
        with self._writing():
            self._db.executemany("DELETE FROM results WHERE status = ?", [(status,) for status in statuses])

    def finished(self) -> set[str]:
        """The run_ids that have a result."""
        return {run_id for (run_id,) in self._db.execute("SELECT run_id FROM results")}

    def add(self, record: RunRecord) -> None:
        """Write one record; it is safe when this returns, also if this process is killed the next moment."""
        row = (
            record.run_id, str(record.status), record.message, record.objective, record.evaluations, record.runtime_s,
            record.cpu_s, json.dumps(record.scores), json.dumps(record.estimate), _packed(record.traces), record.host,
            record.worker,
        )  # fmt: skip
        with self._writing():
            self._db.execute("REPLACE INTO results VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)

    def counts(self) -> dict[str, int]:
        """Runs of the plan by status, and those without a result as ``open``."""
        query = "SELECT COALESCE(status, 'open'), COUNT(*) FROM plan LEFT JOIN results USING (run_id) GROUP BY 1"
        return dict(self._db.execute(query))

    def runs(self) -> pd.DataFrame:
        """One row a finished run of the plan, in its order; the columns of ``runs.csv``."""
        study = self.meta.get("name", "")
        rows = list(
            self._db.execute(
                "SELECT run_id, scenario, formulation, solver, repetition, swept, status, message, objective, "
                "evaluations, runtime_s, cpu_s, instance_seed, solver_seed, method, scores "
                "FROM plan JOIN results USING (run_id) ORDER BY ordinal"
            )
        )
        return pd.DataFrame([_run_row(study, row) for row in rows], columns=None if rows else _COLUMNS)

    def traces(self, run_id: str) -> tuple[Trace, ...]:
        """The traces of one run, one for each problem it minimized. Raises StoreError for an unknown run_id."""
        found = self._db.execute("SELECT traces FROM results WHERE run_id = ?", [run_id]).fetchone()
        if found is None:
            raise StoreError(f"{self.path}: no result of run_id {run_id!r}")
        return _unpacked(found[0])

    def all_traces(self) -> Iterator[tuple[str, tuple[Trace, ...]]]:
        """(run_id, traces) of every finished run of the plan, in its order."""
        query = "SELECT run_id, traces FROM plan JOIN results USING (run_id) ORDER BY ordinal"
        for run_id, blob in self._db.execute(query):
            yield run_id, _unpacked(blob)

    def _writing(self) -> _Transaction:
        return _Transaction(self._db, self.path)


class _Transaction:
    """``with`` commits at the end, rolls back on any exception, and tells SQLite's errors in our words."""

    def __init__(self, db: sqlite3.Connection, path: Path) -> None:
        self._db, self._path = db, path

    def __enter__(self) -> None:
        self._db.__enter__()

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        try:
            self._db.__exit__(kind, error, trace)
        except sqlite3.Error as inner:
            raise StoreError(f"{self._path}: {inner}; finished rows are kept") from inner
        if isinstance(error, sqlite3.Error):
            raise StoreError(f"{self._path}: {error}; finished rows are kept") from error


def _plan_row(number: int, spec: RunSpec) -> tuple[Any, ...]:
    method = spec.method
    return (
        number, spec.run_id, spec.point.scenario.label, method.formulation.label,
        method.solver.label if method.solver else "", method.label, spec.repetition, json.dumps(spec.point.swept),
        spec.instance_seed, spec.solver_seed,
    )  # fmt: skip


_COLUMNS = [
    "run_id", "study", "scenario", "formulation", "solver", "repetition", "status", "message", "rmse_m", "objective",
    "evaluations", "runtime_s", "cpu_s", "instance_seed", "solver_seed", "method",
]  # fmt: skip


def _run_row(study: str, row: tuple[Any, ...]) -> dict[str, Any]:
    (run_id, scenario, formulation, solver, repetition, swept, status, message, objective, evaluations, runtime_s,
     cpu_s, instance_seed, solver_seed, method, scores) = row  # fmt: skip
    scores = json.loads(scores)
    return {
        "run_id": run_id,
        "study": study,
        "scenario": scenario,
        "formulation": formulation,
        "solver": solver,
        "repetition": repetition,
        **{f"scenario.{key}": _cell(value) for key, value in json.loads(swept).items()},
        "status": status,
        "message": message,
        "rmse_m": scores.pop("rmse_m", np.nan),
        "objective": np.nan if objective is None else objective,
        "evaluations": evaluations,
        "runtime_s": np.nan if runtime_s is None else runtime_s,
        "cpu_s": np.nan if cpu_s is None else cpu_s,
        "instance_seed": instance_seed,
        "solver_seed": solver_seed,
        "method": method,
        **scores,
    }


def _cell(value: Any) -> Any:
    """A swept value as one cell: numbers and text as they are, lists and tables as JSON."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _packed(traces: tuple[Trace, ...]) -> bytes:
    """The traces as one compressed block of arrays."""
    buffer = io.BytesIO()
    arrays = {
        f"{name}{i}": getattr(trace, name)
        for i, trace in enumerate(traces)
        for name in ("evaluations", "seconds", "values", "points")
    }
    np.savez(buffer, **arrays)
    return zlib.compress(buffer.getvalue(), 1)


def _unpacked(blob: bytes) -> tuple[Trace, ...]:
    with np.load(io.BytesIO(zlib.decompress(blob))) as arrays:
        return tuple(
            Trace(*(arrays[f"{name}{i}"] for name in ("evaluations", "seconds", "values", "points")))
            for i in range(len(arrays.files) // 4)
        )
