"""The tables of ``runs.sqlite``, and the checks and updates of a file of another schema."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from nfbench.core import StoreError

from .damage import Damaged, patiently, remedy

__all__ = [
    "PLAN_COLUMNS",
    "POSITION_COLUMNS",
    "PROOF_COLUMNS",
    "REFERENCE_COLUMNS",
    "RESULT_COLUMNS",
    "SCHEMA",
    "bring_up_to_date",
    "check_to_read",
    "marks",
]

SCHEMA = 4
READABLE = 2  # the oldest schema that can be read without being updated
_TABLES = {
    "meta": "CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    "plan": (
        "CREATE TABLE IF NOT EXISTS plan (\n"
        "    ordinal INTEGER PRIMARY KEY, run_id TEXT NOT NULL UNIQUE, scenario TEXT, formulation TEXT, solver TEXT,\n"
        "    method TEXT, repetition INTEGER, swept TEXT, instance_seed INTEGER, solver_seed INTEGER)"
    ),
    "results": (
        "CREATE TABLE IF NOT EXISTS results (\n"
        "    run_id TEXT PRIMARY KEY, status TEXT NOT NULL, message TEXT, objective REAL, evaluations INTEGER, "
        "runtime_s REAL,\n"
        "    cpu_s REAL, scores TEXT, estimate TEXT, traces BLOB, host TEXT, worker INTEGER, finished REAL) "
        "WITHOUT ROWID"
    ),
    "reference_plan": (
        "CREATE TABLE IF NOT EXISTS reference_plan (\n"
        "    ordinal INTEGER PRIMARY KEY, reference_id TEXT NOT NULL, scenario TEXT, formulation TEXT, scene INTEGER,\n"
        "    swept TEXT, instance_seed INTEGER)"
    ),
    "reference_optima": (
        "CREATE TABLE IF NOT EXISTS reference_optima (\n"
        "    reference_id TEXT PRIMARY KEY, status TEXT NOT NULL, message TEXT, value REAL, gap REAL, "
        "certified INTEGER, step INTEGER,\n"
        "    columns TEXT, point TEXT, seconds REAL, cpu_s REAL, host TEXT, worker INTEGER, finished REAL) "
        "WITHOUT ROWID"
    ),
    "positions": (
        "CREATE TABLE IF NOT EXISTS positions (run_id TEXT PRIMARY KEY, truth TEXT NOT NULL, estimated TEXT NOT NULL) "
        "WITHOUT ROWID"
    ),
}
PLAN_COLUMNS = (
    *("ordinal", "run_id", "scenario", "formulation", "solver", "method", "repetition", "swept", "instance_seed"),
    "solver_seed",
)
RESULT_COLUMNS = (
    *("run_id", "status", "message", "objective", "evaluations", "runtime_s", "cpu_s", "scores", "estimate", "traces"),
    *("host", "worker", "finished"),
)
PROOF_COLUMNS = ("ordinal", "reference_id", "scenario", "formulation", "scene", "swept", "instance_seed")
REFERENCE_COLUMNS = (  # of another number than those of ``results``, so that rows in damaged files can be told apart
    *("reference_id", "status", "message", "value", "gap", "certified", "step", "columns", "point", "seconds"),
    *("cpu_s", "host", "worker", "finished"),
)
POSITION_COLUMNS = ("run_id", "truth", "estimated")
_COLUMNS = {
    "meta": ("key", "value"),
    "plan": PLAN_COLUMNS,
    "results": RESULT_COLUMNS,
    "reference_plan": PROOF_COLUMNS,
    "reference_optima": REFERENCE_COLUMNS,
    "positions": POSITION_COLUMNS,
}
_ADDED = {"finished": 2}  # columns that older schemas lack → schema that added them
_ADDED_TABLES = {"reference_plan": 3, "reference_optima": 3, "positions": 4}
_MIGRATIONS = {  # SQL that brings a file from this schema to the next one, besides creating tables
    1: "ALTER TABLE results ADD COLUMN finished REAL",
}


def check_to_read(db: sqlite3.Connection, path: Path) -> None:
    """Check that the file has our tables in the present schema. Raises StoreError, with what to do, if not."""
    schema = _schema(db, path)
    if schema is None:
        raise StoreError(
            f"{path} holds no study yet; if one has just been started, try again, else run it: `nfbench run STUDY.toml "
            f"--out {path.parent}`"
        )
    if schema > SCHEMA:
        raise StoreError(f"{path}: expected schema {SCHEMA}, found {schema}; a newer nfbench wrote it: update nfbench")
    if schema < READABLE:
        raise StoreError(f"{path}: expected schema {READABLE} to {SCHEMA}, found {schema}; `nfbench run` can update it")


def bring_up_to_date(db: sqlite3.Connection, path: Path, wait_s: float) -> None:
    """Create the tables, or update those of an older schema; all or nothing. Waits for a locked file."""
    schema = _schema(db, path)
    if schema is not None and not 1 <= schema <= SCHEMA:
        raise StoreError(
            f"{path}: expected schema 1 to {SCHEMA}, found {schema}; a newer nfbench wrote it: update nfbench"
        )
    if schema == SCHEMA and db.execute("SELECT 1 FROM meta WHERE key = 'schema'").fetchone():
        return
    steps = [_MIGRATIONS[step] for step in range(schema or SCHEMA, SCHEMA) if step in _MIGRATIONS]
    with db:
        patiently(db, path, wait_s, "BEGIN IMMEDIATE")
        for step in [*steps, *_TABLES.values()]:
            db.execute(step)
        db.execute("REPLACE INTO meta VALUES ('schema', ?)", [str(SCHEMA)])


def marks(count: int) -> str:
    """Placeholders of that many values."""
    return ", ".join("?" * count)


def _schema(db: sqlite3.Connection, path: Path) -> int | None:
    """The schema of a file, from its columns if it does not say; None if it has no tables.

    Raises Damaged if the tables are not ours. Views and triggers are refused, because they would run SQL on reading.
    """
    kinds = {str(name): str(kind) for name, kind in db.execute("SELECT name, type FROM sqlite_master")}
    if not kinds:
        return None
    if foreign := sorted(name for name, kind in kinds.items() if kind not in ("table", "index")):
        raise _damaged(path, f"expected tables only, found the {kinds[foreign[0]]} {foreign[0]!r}")
    stored = _stored(db, path) if "meta" in kinds else None
    if stored is not None and stored > SCHEMA:
        return stored  # of a newer nfbench, whose tables may differ
    oldest = SCHEMA
    for table, expected in _COLUMNS.items():
        if table not in kinds and table in _ADDED_TABLES:
            oldest = min(oldest, _ADDED_TABLES[table] - 1)
            continue
        if table not in kinds:
            raise _damaged(path, f"the table {table} is missing")
        found = [str(row[1]) for row in db.execute(f"PRAGMA table_info({table})")]
        if lacking := [name for name in expected if name not in found]:
            oldest = min(oldest, *(_ADDED.get(name, 0) - 1 for name in lacking))
            if oldest < 1:
                raise _damaged(path, f"the table {table} lacks the column {lacking[0]}")
        if tuple(found) != expected[: len(found)]:
            raise _damaged(path, f"expected the columns {', '.join(expected)} in {table}, found {', '.join(found)}")
    return oldest


def _stored(db: sqlite3.Connection, path: Path) -> int | None:
    """The schema that the file says it has; None if it does not say."""
    found = db.execute("SELECT value FROM meta WHERE key = 'schema'").fetchone()
    if found is None:
        return None
    if not isinstance(found[0], str) or not found[0].isdecimal() or int(found[0][:9]) < 1:
        raise _damaged(path, f"expected a number as the schema, found {found[0]!r:.80}")
    return int(found[0][:9])


def _damaged(path: Path, reason: str) -> Damaged:
    return Damaged(f"{path} is damaged ({reason}); {remedy(path.parent)}")
