"""The store: one SQLite file from which every table is made."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sqlite3
import time
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from filelock import FileLock

from nfbench.core import StoreError, Trace
from nfbench.study import RunRecord, RunSpec, Study

from .folder import locked

__all__ = ["ORIGIN_COLUMNS", "RUN_COLUMNS", "Store", "TracedRun", "network_file_system"]

FILE = "runs.sqlite"
SCHEMA = 2
MOUNTS = Path("/proc/mounts")
_TABLES = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS plan (
    ordinal INTEGER PRIMARY KEY, run_id TEXT NOT NULL UNIQUE, scenario TEXT, formulation TEXT, solver TEXT,
    method TEXT, repetition INTEGER, swept TEXT, instance_seed INTEGER, solver_seed INTEGER);
CREATE TABLE IF NOT EXISTS results (
    run_id TEXT PRIMARY KEY, status TEXT NOT NULL, message TEXT, objective REAL, evaluations INTEGER, runtime_s REAL,
    cpu_s REAL, scores TEXT, estimate TEXT, traces BLOB, host TEXT, worker INTEGER, finished REAL) WITHOUT ROWID;
"""
_MIGRATIONS = {  # SQL that brings a file from this schema to the next one
    1: "ALTER TABLE results ADD COLUMN finished REAL;",
}
RUN_COLUMNS = (  # from which a row of runs.csv is made
    *("run_id", "scenario", "formulation", "solver", "repetition", "swept", "status", "message", "objective"),
    *("evaluations", "runtime_s", "cpu_s", "instance_seed", "solver_seed", "method", "scores"),
)
ORIGIN_COLUMNS = ("run_id", "host", "worker", "finished")
_PLAN_COLUMNS = 10
_RESULT_COLUMNS = 13
_PAGE = 256  # runs that are read at once, with their traces


@dataclass(frozen=True)
class TracedRun:
    """A finished run with one trace for each problem that it minimized; no traces if it minimized none."""

    run_id: str
    formulation: str
    solver: str
    method: str
    repetition: int
    status: str
    swept: dict[str, Any]
    traces: tuple[Trace, ...]


class Store:
    """The rows and traces in one study's folder.

    The table ``plan`` holds the runs that the manifest describes now, in order. The table ``results`` holds every
    result ever computed in this folder. Readers see the results of runs in the plan. Any number of processes may open
    the store for reading at any time, and one for writing (``write=True``). Raises StoreError if the file cannot be
    opened, is damaged, or has another writer.
    """

    def __init__(self, folder: Path, *, write: bool = False) -> None:
        self.folder, self.path = folder, folder / FILE
        self._lock: FileLock | None = None
        if not write and not self.path.is_file():
            raise StoreError(f"{folder}: expected a results folder with {FILE}, found none")
        with self._own_errors():
            self._db = self._opened_to_write() if write else self._opened_to_read()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            with contextlib.suppress(sqlite3.Error):  # removes the -wal and -shm files, unless somebody is reading
                self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()
        if self._lock is not None:
            self._lock.release()

    # --- reading -------------------------------------------------------------------------------------------------

    @property
    def meta(self) -> dict[str, str]:
        """Name, seed, shard and further properties of the study, as text by key."""
        with self._own_errors():
            return dict(self._db.execute("SELECT key, value FROM meta"))

    def counts(self) -> dict[str, int]:
        """Number of runs of the plan by status; those without a result count as ``open``."""
        query = "SELECT COALESCE(status, 'open'), COUNT(*) FROM plan LEFT JOIN results USING (run_id) GROUP BY 1"
        with self._own_errors():
            return dict(self._db.execute(query))

    def failures(self) -> list[tuple[str, str, int, str]]:
        """(status, method, number of runs, one of their messages) of the runs that are not ok."""
        query = (
            "SELECT status, method, COUNT(*), MIN(message) FROM plan JOIN results USING (run_id) "
            "WHERE status != 'ok' GROUP BY 1, 2 ORDER BY 3 DESC"
        )
        with self._own_errors():
            return list(self._db.execute(query))

    def rate(self, window_s: float = 300.0) -> float:
        """Runs finished per second, over the ``window_s`` seconds before the last finished run; 0 if unknown."""
        query = (
            "SELECT COUNT(*), MAX(finished) - MIN(finished) FROM results WHERE finished > "
            "(SELECT MAX(finished) FROM results) - ?"
        )
        with self._own_errors():
            count, seconds = self._db.execute(query, [window_s]).fetchone()
        return (count - 1) / seconds if seconds else 0.0

    def open_ordinals(self) -> list[int]:
        """Positions in the plan of the runs without a result, in order."""
        query = "SELECT ordinal FROM plan WHERE run_id NOT IN (SELECT run_id FROM results) ORDER BY ordinal"
        with self._own_errors():
            return [ordinal for (ordinal,) in self._db.execute(query)]

    def runs(self) -> Iterator[tuple[Any, ...]]:
        """Yield the columns RUN_COLUMNS of every finished run of the plan, in order."""
        with self._own_errors():
            yield from self._db.execute(f"SELECT {', '.join(RUN_COLUMNS)} {_JOINED}")

    def origins(self) -> list[tuple[Any, ...]]:
        """The columns ORIGIN_COLUMNS of every finished run of the plan, in order."""
        with self._own_errors():
            return self._db.execute(f"SELECT {', '.join(ORIGIN_COLUMNS)} {_JOINED}").fetchall()

    def traces(self) -> Iterator[tuple[str, tuple[Trace, ...]]]:
        """Yield (run_id, traces) of every finished run of the plan, in order; one trace per minimized problem."""
        with self._own_errors():
            for run_id, blob in self._db.execute(f"SELECT run_id, traces {_JOINED}"):
                yield run_id, _unpacked(blob)

    def traced_runs(self) -> Iterator[TracedRun]:
        """Yield every finished run of the plan with its traces, in order.

        Runs are read in pages, so that a slow reader neither fills the memory nor blocks the writer.
        """
        query = (
            "SELECT ordinal, run_id, formulation, solver, method, repetition, status, swept, traces "
            "FROM plan JOIN results USING (run_id) WHERE ordinal > ? ORDER BY ordinal LIMIT ?"
        )
        page: list[tuple[Any, ...]] = [(-1,)]
        while page:
            with self._own_errors():
                page = self._db.execute(query, [page[-1][0], _PAGE]).fetchall()
            for _, run_id, formulation, solver, method, repetition, status, swept, traces in page:
                about = (run_id, formulation, solver, method, repetition, status)
                yield TracedRun(*about, json.loads(swept), _unpacked(traces))

    def swept_keys(self) -> list[str]:
        """The keys that the plan sweeps, in order."""
        with self._own_errors():
            settings = self._db.execute("SELECT swept FROM plan GROUP BY swept ORDER BY MIN(ordinal)").fetchall()
        return list(dict.fromkeys(key for (text,) in settings for key in json.loads(text)))

    def estimates(self) -> Iterator[tuple[str, Any]]:
        """Yield (run_id, estimate as nested lists) of every finished run of the plan that has one, in order."""
        with self._own_errors():
            for run_id, estimate in self._db.execute(f"SELECT run_id, estimate {_JOINED}"):
                if (found := json.loads(estimate)) is not None:
                    yield run_id, found

    # --- writing -------------------------------------------------------------------------------------------------

    def begin(self, study: Study, shard: tuple[int, int] | None = None) -> bool:
        """Store the plan: all runs of the study, or those of shard k of n. Return whether anything changed.

        Raises StoreError, with the difference, if the folder belongs to another study, seed or shard.
        """
        expected = {"name": study.name, "seed": str(study.seed), "shard": f"{shard[0]}/{shard[1]}" if shard else ""}
        found = self.meta
        differing = [
            f"expected {key} = {value!r}, found {found[key]!r}"
            for key, value in expected.items()
            if found.get(key, value) != value
        ]
        if differing:
            raise StoreError(
                f"{self.folder} belongs to another study: {'; '.join(differing)}; choose another folder with --out, "
                f"or move this one aside with --fresh"
            )
        about = {"title": study.title, "expect": study.expect, "error": study.error, "outlier_m": study.outlier_m}
        known = {key: str(value) for key, value in {**expected, **about, "plan": study.fingerprint}.items()}
        if known.items() <= found.items():
            return False
        with self._writing():
            self._db.executemany("REPLACE INTO meta VALUES (?, ?)", known.items())
            if found.get("plan") != known["plan"]:
                self._db.execute("DELETE FROM plan")
                rows = (
                    _plan_row(ordinal, spec)
                    for ordinal, spec in enumerate(study.specs())
                    if shard is None or int(spec.run_id, 16) % shard[1] == shard[0] - 1
                )
                self._db.executemany(f"INSERT INTO plan VALUES ({_marks(_PLAN_COLUMNS)})", rows)
        return True

    def tabled(self) -> bool:
        """Whether the tables include all runs that are finished now, according to ``mark_tabled``."""
        return self.meta.get("tabled") == str(self._finished())

    def mark_tabled(self) -> None:
        """Record that the tables include all runs that are finished now."""
        with self._writing():
            self._db.execute("REPLACE INTO meta VALUES ('tabled', ?)", [str(self._finished())])

    def _finished(self) -> int:
        return sum(count for status, count in self.counts().items() if status != "open")

    def forget(self, statuses: Iterable[str]) -> None:
        """Delete the results with these statuses, so that their runs are repeated."""
        with self._writing():
            self._db.executemany("DELETE FROM results WHERE status = ?", [(str(status),) for status in statuses])

    def add(self, records: Iterable[RunRecord]) -> None:
        """Write records in one transaction; they are on disk when this returns."""
        rows = [_result_row(record) for record in records]
        with self._writing():
            self._db.executemany(f"REPLACE INTO results VALUES ({_marks(_RESULT_COLUMNS)})", rows)

    def take_over(self, other: Store) -> None:
        """Add the plan and results of another folder of the same study.

        Raises StoreError if they contradict this folder: another study, another plan, or another result of a run.
        """
        ours, theirs = self.meta, other.meta
        for key in ("name", "seed", "plan"):
            if ours.setdefault(key, theirs.get(key, "")) != theirs.get(key, ""):
                reason = f"its {key} is {theirs.get(key, '')!r}, but that of the previous folders is {ours[key]!r}"
                if key == "plan":
                    reason = "its manifest or a plugin version differs from that of the previous folders"
                raise StoreError(f"{other.folder} cannot be merged: {reason}")
        with self._writing():
            known = [(key, value) for key, value in theirs.items() if key not in ("shard", "tabled")]
            self._db.executemany("REPLACE INTO meta VALUES (?, ?)", known)
            self._db.executemany(
                f"INSERT OR IGNORE INTO plan VALUES ({_marks(_PLAN_COLUMNS)})", other._db.execute("SELECT * FROM plan")
            )
            for row in other._db.execute("SELECT * FROM results"):
                present = self._db.execute("SELECT * FROM results WHERE run_id = ?", row[:1]).fetchone()
                if present is not None and _computed(present) != _computed(row):
                    raise StoreError(
                        f"{other.folder} cannot be merged: its result of run {row[0]} ({row[1]}, objective {row[3]}) "
                        f"differs from that in the previous folders ({present[1]}, objective {present[3]})"
                    )
                if present is None:
                    self._db.execute(f"INSERT INTO results VALUES ({_marks(_RESULT_COLUMNS)})", row)

    # --- the file ------------------------------------------------------------------------------------------------

    def _opened_to_read(self) -> sqlite3.Connection:
        db = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True, timeout=10)
        schema = _schema(db)
        if schema is None:
            raise StoreError(f"{self.path} holds no study yet; if one has just been started, try again")
        if schema != SCHEMA:
            raise StoreError(f"{self.path}: expected schema {SCHEMA}, found {schema}; `nfbench run` can update it")
        return db

    def _opened_to_write(self) -> sqlite3.Connection:
        self._lock = locked(self.folder)
        try:
            db = sqlite3.connect(self.path, timeout=10)
            damage = db.execute("PRAGMA quick_check(1)").fetchone()[0]
            if damage != "ok":
                raise StoreError(f"{self.path} is damaged ({damage}); --fresh moves the folder aside and starts over")
            # WAL needs shared memory, which a network file system does not provide
            db.execute(f"PRAGMA journal_mode = {'DELETE' if network_file_system(self.folder) else 'WAL'}")
            db.execute("PRAGMA synchronous = FULL")
            self._bring_up_to_date(db)
        except BaseException:
            self._lock.release()
            raise
        return db

    def _bring_up_to_date(self, db: sqlite3.Connection) -> None:
        schema = _schema(db)
        if schema is not None and not 1 <= schema <= SCHEMA:
            raise StoreError(f"{self.path}: expected schema 1 to {SCHEMA}, found {schema}; a newer nfbench wrote it")
        for step in range(schema or SCHEMA, SCHEMA):
            db.executescript(_MIGRATIONS[step])
        db.executescript(_TABLES)
        with db:
            db.execute("REPLACE INTO meta VALUES ('schema', ?)", [str(SCHEMA)])

    @contextlib.contextmanager
    def _own_errors(self) -> Iterator[None]:
        """Turn SQLite's errors into a StoreError that names the file."""
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {error}") from error

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """One transaction: committed at the end, rolled back on any exception."""
        try:
            with self._db:
                yield
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {error}; rows written earlier are kept") from error


_JOINED = "FROM plan JOIN results USING (run_id) ORDER BY ordinal"


def network_file_system(folder: Path) -> str | None:
    """The type of the network file system that holds ``folder``; None if it is local or unknown."""
    try:
        mounts = [line.split()[1:3] for line in MOUNTS.read_text(encoding="utf-8").splitlines()]
    except OSError:
        return None
    path = folder.resolve()
    holding = [(len(point), kind) for point, kind in mounts if path.is_relative_to(point.replace("\\040", " "))]
    kind = max(holding, default=(0, ""))[1]
    return kind if re.match(r"nfs|cifs|smb|9p|afs|lustre|gpfs|beegfs|ceph|glusterfs|fuse\.", kind) else None


def _schema(db: sqlite3.Connection) -> int | None:
    """The schema number of a file; None if it has no tables."""
    if not db.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()[0]:
        return None
    found = db.execute("SELECT value FROM meta WHERE key = 'schema'").fetchone()
    return int(found[0]) if found else None


def _marks(count: int) -> str:
    return ", ".join("?" * count)


def _plan_row(ordinal: int, spec: RunSpec) -> tuple[Any, ...]:
    method = spec.method
    return (
        ordinal, spec.run_id, spec.point.scenario.label, method.formulation.label,
        method.solver.label if method.solver else "", method.label, spec.repetition, json.dumps(spec.point.swept),
        spec.instance_seed, spec.solver_seed,
    )  # fmt: skip


def _result_row(record: RunRecord) -> tuple[Any, ...]:
    scores = {name: repr(score) for name, score in record.scores.items()}  # as text, because JSON has no inf
    return (
        record.run_id, str(record.status), record.message, record.objective, record.evaluations, record.runtime_s,
        record.cpu_s, json.dumps(scores), json.dumps(record.estimate), _packed(record.traces), record.host,
        record.worker, time.time(),
    )  # fmt: skip


def _computed(row: tuple[Any, ...]) -> tuple[Any, ...]:
    """What must be equal in two executions of one run: status, objective, evaluations, scores, estimate."""
    return (row[1], row[3], row[4], row[7], row[8])


def _packed(traces: tuple[Trace, ...]) -> bytes:
    """The traces as one compressed block of bytes."""
    if not traces:
        return b""
    buffer = io.BytesIO()
    arrays = {
        f"{name}{i}": getattr(trace, name)
        for i, trace in enumerate(traces)
        for name in ("evaluations", "seconds", "values", "points")
    }
    np.savez(buffer, **arrays)
    return zlib.compress(buffer.getvalue(), 1)


def _unpacked(blob: bytes) -> tuple[Trace, ...]:
    if not blob:
        return ()
    with np.load(io.BytesIO(zlib.decompress(blob))) as arrays:
        return tuple(
            Trace(*(arrays[f"{name}{i}"] for name in ("evaluations", "seconds", "values", "points")))
            for i in range(len(arrays.files) // 4)
        )
