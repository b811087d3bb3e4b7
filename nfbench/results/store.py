"""The store: one SQLite file from which every table is made."""

from __future__ import annotations

import contextlib
import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Self

from nfbench.core import Status, StoreError, Trace, printable
from nfbench.study import RunRecord, Study

from .damage import Damaged, guarded, patiently, remedy
from .folder import FolderLock, clean, locked, network_file_system
from .pages import pages
from .position_table import PositionTable
from .reference_table import ReferenceTable
from .rows import TracedRun, plan_row, result_row
from .schema import PLAN_COLUMNS, RESULT_COLUMNS, bring_up_to_date, check_to_read, marks
from .values import checked_row, inflated, is_positive, settings, unpacked

__all__ = ["FILE", "ORIGIN_COLUMNS", "RUN_COLUMNS", "Store"]

FILE = "runs.sqlite"
RUN_COLUMNS = (  # from which a row of runs.csv is made
    *("run_id", "scenario", "formulation", "solver", "repetition", "swept", "status", "message", "objective"),
    *("evaluations", "runtime_s", "cpu_s", "instance_seed", "solver_seed", "method", "scores"),
)
ORIGIN_COLUMNS = ("run_id", "host", "worker", "finished")
READ_WAIT_S = 6.0  # how long a reader waits for a file that another program has locked [s]
WRITE_WAIT_S = 600.0  # how long a running study waits, because its finished runs would be lost [s]
_ATTEMPT_S = 1.0  # after which SQLite returns to us, so that Ctrl-C works
_LARGEST = 2**28  # bytes of a cell
_DESCRIBED = ("name", "seed", "title", "expect", "error", "outlier_m")


class Store:
    """The rows and traces in one study's folder.

    The table ``plan`` holds the runs that the manifest describes now, in order. The table ``results`` holds every
    result ever computed in this folder. Readers see the results of runs in the plan. ``references`` has the optima that
    are proven beside them, and ``positions`` those of the sources. Any number of processes may open the store for
    reading at any time, and one for writing (``write=True``). Raises StoreError if the file cannot be opened, is
    damaged, or has another writer. Every value that is read is checked; any fault is a StoreError with a remedy.
    """

    def __init__(self, folder: Path, *, write: bool = False) -> None:
        self.folder, self.path = folder, folder / FILE
        self.references, self.positions = ReferenceTable(self), PositionTable(self)
        self._lock: FolderLock | None = None
        self._wait_s = WRITE_WAIT_S if write else READ_WAIT_S
        with guarded(self.path):
            if not self.path.is_file() and (not write or self.path.exists()):
                kind = "none" if not self.path.exists() else "a folder" if self.path.is_dir() else "a device or pipe"
                advice = "" if kind == "none" else f" of that name; move it away, or {folder} aside with --fresh"
                raise StoreError(f"{folder}: expected a results folder with {FILE}, found {kind}{advice}")
            self._db = self._opened_to_write() if write else self._opened_to_read()

    @property
    def connection(self) -> sqlite3.Connection:
        """The connection, for writing within ``writing``."""
        return self._db

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

    def select(self, sql: str, args: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query, unchecked. Every query of a reader goes through here."""
        with guarded(self.path):
            for row in patiently(self._db, self.path, self._wait_s, sql, args):  # noqa: UP028  # closes no cursor
                yield row

    def checked(
        self, table: str, names: Sequence[str], source: str, args: Sequence[Any] = ()
    ) -> Iterator[tuple[list[Any], tuple[Any, ...]]]:
        """Yield the rows of a query with these columns, once with checked and decoded values and once as stored."""
        for row in self.select(f"SELECT {', '.join(names)} {source}", args):
            with guarded(self.path):
                values = checked_row(table, names, row)
            yield values, row

    @property
    def meta(self) -> dict[str, str]:
        """Name, seed, shard and further properties of the study, as text by key."""
        found = dict(self.select("SELECT key, value FROM meta"))
        with guarded(self.path):
            if odd := [pair for pair in found.items() if not all(isinstance(part, str) for part in pair)]:
                raise ValueError(f"table meta: expected text, found {odd[0]!r:.80}")
        return found

    def described(self) -> dict[str, str]:
        """``meta`` of a study that has begun. Raises StoreError if something is missing or impossible."""
        meta = self.meta
        if missing := [key for key in _DESCRIBED if key not in meta]:
            raise StoreError(
                f"{self.path}: the table meta lacks {', '.join(missing)}; `nfbench run STUDY.toml --out {self.folder}` "
                f"writes it again and keeps all runs"
            )
        with guarded(self.path):
            if not meta.get("runs_per_scene", "1").isascii() or not meta.get("runs_per_scene", "1").isdigit():
                raise ValueError(f"table meta: expected runs_per_scene > 0, found {meta['runs_per_scene']!r:.80}")
            if not is_positive(meta["outlier_m"]):
                raise ValueError(f"table meta: expected outlier_m > 0, found {meta['outlier_m']!r:.80}")
        return meta

    def counts(self) -> dict[str, int]:
        """Number of runs by status; those without a result count as ``open``, also runs of shards that are missing."""
        query = "SELECT COALESCE(status, 'open'), COUNT(*) FROM plan LEFT JOIN results USING (run_id) GROUP BY 1"
        found = dict(self.select(query))
        with guarded(self.path):
            for status in found:
                if status != "open":
                    Status(status)
        if missing := self._unplanned():
            found["open"] = found.get("open", 0) + missing
        return found

    def _unplanned(self) -> int:
        """Number of runs of the study that the plan lacks, as after merging some of its shards."""
        meta = self.meta
        if meta.get("shard"):
            return 0
        ((count, last),) = self.select("SELECT COUNT(*), MAX(ordinal) FROM plan")
        with guarded(self.path):
            return max(int(meta.get("runs") or 0), (-1 if last is None else last) + 1) - count

    def failures(self) -> list[tuple[str, str, int, str]]:
        """(status, method, number of runs, one of their messages) of the runs that are not ok, as printable text."""
        query = (
            "SELECT status, method, COUNT(*), MIN(message) FROM plan JOIN results USING (run_id) "
            "WHERE status != 'ok' GROUP BY 1, 2 ORDER BY 3 DESC"
        )
        return [
            (printable(status), printable(method), count, printable(message))
            for status, method, count, message in self.select(query)
        ]

    def rate(self, window_s: float = 300.0) -> float:
        """Runs finished per second, over the ``window_s`` seconds before the last finished run; 0 if unknown."""
        times = "(SELECT finished FROM results WHERE typeof(finished) IN ('real', 'integer'))"
        query = (
            f"SELECT COUNT(*), MAX(finished) - MIN(finished) FROM {times} WHERE finished > "
            f"(SELECT MAX(finished) FROM {times}) - ?"
        )
        ((count, seconds),) = self.select(query, [window_s])
        return (count - 1) / seconds if seconds else 0.0

    def open_ordinals(self) -> list[int]:
        """Positions in the plan of the runs without a result, in order."""
        query = "SELECT ordinal FROM plan WHERE run_id NOT IN (SELECT run_id FROM results) ORDER BY ordinal"
        return [ordinal for (ordinal,) in self.select(query)]

    def runs(self) -> Iterator[tuple[Any, ...]]:
        """Yield the columns RUN_COLUMNS of every finished run of the plan, in order; scores as a dict.

        Raises StoreError also if the plan is not what was written.
        """
        self._check_plan()
        for values, _ in self.checked("results", RUN_COLUMNS, _JOINED):
            yield tuple(values)

    def _check_plan(self) -> None:
        if self.plan_changed():
            raise StoreError(
                f"{self.path}: the table plan has changed since it was written; `nfbench run STUDY.toml --out "
                f"{self.folder}` writes it again and keeps all results"
            )

    def origins(self) -> list[tuple[Any, ...]]:
        """The columns ORIGIN_COLUMNS of every finished run of the plan, in order."""
        return [tuple(values) for values, _ in self.checked("results", ORIGIN_COLUMNS, _JOINED)]

    def traces(self) -> Iterator[tuple[str, tuple[Trace, ...]]]:
        """Yield (run_id, traces) of every finished run of the plan, in order; one trace per minimized problem."""
        for (run_id, blob), _ in self.checked("results", ("run_id", "traces"), _JOINED):
            yield run_id, self._traces(run_id, blob)

    def _traces(self, run_id: str, blob: bytes) -> tuple[Trace, ...]:
        with guarded(self.path):
            try:
                return unpacked(blob)
            except Exception as error:
                raise ValueError(f"table results, row {run_id!r}, column traces: {error}") from error

    def traced_runs(self, lenient: bool = False, only: Sequence[str] | None = None) -> Iterator[TracedRun]:
        """Yield finished runs of the plan with their traces; see ``pages`` for ``only`` and the order.

        lenient: whether a run whose traces are damaged is yielded without them. Otherwise Damaged is raised.
        """
        names = ("formulation", "solver", "method", "repetition", "status", "swept", "traces")
        self._check_plan()
        for page in pages(self.checked, names, only):
            for _, run_id, formulation, solver, method, repetition, status, swept, blob in page:
                about = (run_id, formulation, solver, method, repetition, status, settings(swept))
                try:
                    yield TracedRun(*about, self._traces(run_id, blob))
                except Damaged as damage:
                    if not lenient:
                        raise
                    yield TracedRun(*about, (), damage=str(damage))

    def swept_keys(self) -> list[str]:
        """The keys that the plan sweeps, in order."""
        query = "SELECT swept FROM plan GROUP BY swept ORDER BY MIN(ordinal)"
        with guarded(self.path):
            return list(dict.fromkeys(key for (text,) in self.select(query) for key in settings(text)))

    def estimates(self) -> Iterator[tuple[str, Any]]:
        """Yield (run_id, estimate as nested lists) of every finished run of the plan that has one, in order."""
        for (run_id, found), _ in self.checked("results", ("run_id", "estimate"), _JOINED):
            if found is not None:
                yield run_id, found

    def plan_rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of the table ``plan`` as stored."""
        for _, row in self.checked("plan", PLAN_COLUMNS, "FROM plan ORDER BY ordinal"):
            yield row

    def result_rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of the table ``results`` as stored."""
        for values, row in self.checked("results", RESULT_COLUMNS, "FROM results"):
            with guarded(self.path):
                inflated(values[RESULT_COLUMNS.index("traces")])  # its checksum tells any damage
            yield row

    # --- writing -------------------------------------------------------------------------------------------------

    def begin(self, study: Study, shard: tuple[int, int] | None = None) -> bool:
        """Store the plan: all runs of the study, or those of shard k of n. Return whether anything changed.

        A plan that is not what was written, because it was damaged or merged, is written again. Raises StoreError, with
        the difference, if the folder belongs to another study, seed or shard.
        """
        expected = {"name": study.name, "seed": str(study.seed), "shard": f"{shard[0]}/{shard[1]}" if shard else ""}
        found = self.meta
        differing = [
            f"expected {key} = {value!r}, found {found[key]!r:.80}"
            for key, value in expected.items()
            if found.get(key, value) != value
        ]
        if differing:
            raise StoreError(
                f"{self.folder} belongs to another study: {'; '.join(differing)}; choose another folder with --out, "
                f"or move this one aside with --fresh"
            )
        about = {"title": study.title, "expect": study.expect, "error": study.error, "outlier_m": study.outlier_m}
        about |= {"plan": study.fingerprint, "runs": len(study), "runs_per_scene": study.runs_per_scene}
        about["scenarios"] = study.scenarios
        about |= {"targets": json.dumps(study.targets), "claims": json.dumps(study.claims)}
        about |= {"reference": json.dumps(study.proven)}
        budgets = {method.label: method.budget["evaluations"] for method in study.methods if method.budget}
        about |= {"budgets": json.dumps(budgets)}
        known = {key: str(value) for key, value in {**expected, **about}.items()}
        same_plan = found.get("plan") == known["plan"] and found.get("plan_rows") == self._plan_digest()
        same_plan = same_plan and found.get("reference", "[]") == known["reference"]
        if same_plan and known.items() <= found.items():
            return False
        with self.writing():
            self._db.executemany("REPLACE INTO meta VALUES (?, ?)", known.items())
            if not same_plan:
                self._db.execute("DELETE FROM plan")
                rows = (
                    plan_row(ordinal, spec)
                    for ordinal, spec in enumerate(study.specs())
                    if shard is None or int(spec.run_id, 16) % shard[1] == shard[0] - 1
                )
                self._db.executemany(f"INSERT INTO plan VALUES ({marks(len(PLAN_COLUMNS))})", rows)
                self.references.plan(study, shard)
                self._db.execute("REPLACE INTO meta VALUES ('plan_rows', ?)", [self._plan_digest()])
        return True

    def plan_changed(self) -> bool:
        """Whether the table ``plan`` is not what was written; False if that is not known, as in a merged folder."""
        own = not self._db.in_transaction
        if own:
            self._db.execute("BEGIN")  # so that both queries see the same state
        try:
            return self.meta.get("plan_rows", digest := self._plan_digest()) != digest
        finally:
            if own:
                self._db.rollback()

    def _plan_digest(self) -> str:
        """A hash of the tables ``plan`` and ``reference_plan``, by which a change in them is noticed."""
        found = hashlib.sha256()
        for table in ("plan", "reference_plan") if self.references.exist() else ("plan",):
            for row in self.select(f"SELECT * FROM {table} ORDER BY ordinal"):
                found.update(repr(row).encode("utf-8", "surrogatepass"))
        return found.hexdigest()[:32]

    def tabled(self) -> bool:
        """Whether the tables include all runs and proofs that are finished now, according to ``mark_tabled``."""
        return self.meta.get("tabled") == self._finished()

    def mark_tabled(self) -> None:
        """Record that the tables include all runs and proofs that are finished now."""
        with self.writing():
            self._db.execute("REPLACE INTO meta VALUES ('tabled', ?)", [self._finished()])

    def _finished(self) -> str:
        """Number of finished runs, and of finished proofs if there are any."""
        counts = (self.counts(), self.references.counts())
        numbers = [sum(count for status, count in found.items() if status != "open") for found in counts]
        return " ".join(map(str, numbers if numbers[1] else numbers[:1]))

    def forget(self, statuses: Iterable[str]) -> None:
        """Delete the results with these statuses, so that their runs and proofs are repeated."""
        values = [(str(status),) for status in statuses]
        with self.writing():
            for table in ("results", "reference_optima"):
                self._db.executemany(f"DELETE FROM {table} WHERE status = ?", values)

    def add(self, records: Iterable[RunRecord]) -> None:
        """Write records in one transaction; they are on disk when this returns."""
        records = list(records)
        with self.writing() as db:
            db.executemany(f"REPLACE INTO results VALUES ({marks(len(RESULT_COLUMNS))})", map(result_row, records))
            self.positions.put(records)

    @contextlib.contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction on the connection it yields: committed at the end, rolled back on any exception."""
        try:
            patiently(self._db, self.path, self._wait_s, "BEGIN IMMEDIATE")
            try:
                yield self._db
                patiently(self._db, self.path, self._wait_s, "COMMIT")
            except BaseException:
                self._db.rollback()
                raise
        except sqlite3.Error as error:
            damage = f"; {remedy(self.folder)}" if _is_damage(error) else ""
            raise StoreError(f"{self.path}: {error}; rows written earlier are kept{damage}") from error

    # --- the file ------------------------------------------------------------------------------------------------

    def _opened_to_read(self) -> sqlite3.Connection:
        db = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True, timeout=_ATTEMPT_S)
        try:
            _limit(db)
            patiently(db, self.path, self._wait_s, "SELECT COUNT(*) FROM sqlite_master")
            check_to_read(db, self.path)
        except BaseException:
            db.close()
            raise
        return db

    def _opened_to_write(self) -> sqlite3.Connection:
        self._lock = locked(self.folder)
        db = None
        try:
            clean(self.folder)
            db = sqlite3.connect(self.path, timeout=_ATTEMPT_S)
            _limit(db)
            damage = patiently(db, self.path, self._wait_s, "PRAGMA quick_check(1)").fetchone()[0]
            if damage != "ok":
                raise Damaged(f"{self.path} is damaged ({printable(damage, 300)}); {remedy(self.folder)}")
            # WAL needs shared memory, which a network file system does not provide
            mode = "DELETE" if network_file_system(self.folder) else "WAL"
            patiently(db, self.path, self._wait_s, f"PRAGMA journal_mode = {mode}")
            db.execute("PRAGMA synchronous = FULL")
            bring_up_to_date(db, self.path, self._wait_s)
        except BaseException:
            if db is not None:
                db.close()
            self._lock.release()
            raise
        return db


_JOINED = "FROM plan JOIN results USING (run_id) ORDER BY ordinal"


def _limit(db: sqlite3.Connection) -> None:
    """Let a file from elsewhere neither run code nor fill the memory."""
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST)
    db.execute("PRAGMA trusted_schema = OFF")
    db.execute("PRAGMA cell_size_check = ON")


def _is_damage(error: sqlite3.Error) -> bool:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
