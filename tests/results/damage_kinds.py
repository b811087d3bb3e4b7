"""Ways to damage a results folder: every table, column, file and format; and random flips of bytes."""

import io
import os
import sqlite3
import zlib

import numpy as np

FILE = "runs.sqlite"


def sql(*statements):
    """A damage by SQL."""

    def damage(folder):
        with sqlite3.connect(folder / FILE) as db:
            for statement in statements:
                db.execute(statement)

    return damage


def blob(content):
    """A damage that replaces the traces of all runs."""

    def damage(folder):
        with sqlite3.connect(folder / FILE) as db:
            db.execute("UPDATE results SET traces = ?", [content])

    return damage


def placed(run_id, truth, estimated):
    """A damage that gives every run positions."""
    return sql(f"INSERT INTO positions SELECT {run_id}, {truth}, {estimated} FROM plan")


def edited(change, name=FILE):
    """A damage of a file's bytes: ``change`` gets a bytearray."""

    def damage(folder):
        content = bytearray((folder / name).read_bytes())
        changed = change(content)
        (folder / name).write_bytes(content if changed is None else changed)

    return damage


def replaced(name, content=b"\xff\xfe\x00garbage"):
    def damage(folder):
        (folder / name).write_bytes(content)

    return damage


def with_folder(name):
    def damage(folder):
        (folder / name).unlink(missing_ok=True)
        (folder / name / "inside").mkdir(parents=True)

    return damage


def with_pipe(name):
    def damage(folder):
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)

    return damage


def removed(name):
    return lambda folder: (folder / name).unlink()


def overwritten(first, count=4096, byte=0xFF):
    def change(content):
        content[first : first + count] = bytes([byte]) * len(content[first : first + count])

    return edited(change)


def _npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return zlib.compress(buffer.getvalue())


GOOD = {"evaluations0": np.arange(1, 3), "seconds0": np.ones(2), "values0": np.ones(2), "points0": np.ones((2, 2))}
COLUMNS = {
    "meta": ("value",),
    "plan": (
        *("run_id", "scenario", "formulation", "solver", "method", "repetition", "swept", "instance_seed"),
        "solver_seed",
    ),
    "results": (
        *("status", "message", "objective", "evaluations", "runtime_s", "cpu_s", "scores", "estimate", "traces"),
        *("host", "worker", "finished"),
    ),
}
KINDS = {
    # whole files
    "empty file": edited(lambda content: b""),
    "text file": replaced(FILE, b"this is no database\n" * 100),
    "half of the file": edited(lambda content: content[: len(content) // 2]),
    "last page missing": edited(lambda content: content[:-4096]),
    "a few bytes": edited(lambda content: content[:37]),
    "first page overwritten": overwritten(0),
    "header zeroed": overwritten(0, 100, 0),
    "second page overwritten": overwritten(4096),
    "third page zeroed": overwritten(2 * 4096, byte=0),
    "last pages overwritten": overwritten(4 * 4096, 10**6),
    "appended": edited(lambda content: content + b"x" * 5000),
    "database is a folder": with_folder(FILE),
    "database is a pipe": with_pipe(FILE),
    "log is garbage": replaced(f"{FILE}-wal", os.urandom(8192)),
    "log is a folder": with_folder(f"{FILE}-wal"),
    "journal is garbage": replaced(f"{FILE}-journal", b"\xd9\xd5\x05\xf9 \xa1c\xd7" + bytes(600)),
    # tables
    "meta dropped": sql("DROP TABLE meta"),
    "plan dropped": sql("DROP TABLE plan"),
    "results dropped": sql("DROP TABLE results"),
    "meta emptied": sql("DELETE FROM meta"),
    "plan emptied": sql("DELETE FROM plan"),
    "results emptied": sql("DELETE FROM results"),
    "column dropped": sql("ALTER TABLE results DROP COLUMN scores"),
    "column renamed": sql("ALTER TABLE plan RENAME COLUMN method TO methods"),
    "view in place of a table": sql(
        "ALTER TABLE plan RENAME TO old", "CREATE VIEW plan AS SELECT * FROM old UNION ALL SELECT * FROM old"
    ),
    "endless view": sql(
        "ALTER TABLE plan RENAME TO old",
        "CREATE VIEW plan AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
        "SELECT i AS ordinal, 'x' AS run_id, '' AS scenario, '' AS formulation, '' AS solver, '' AS method, "
        "0 AS repetition, '{}' AS swept, 1 AS instance_seed, 1 AS solver_seed FROM n",
    ),
    "trigger": sql("CREATE TRIGGER t AFTER INSERT ON results BEGIN DELETE FROM results; END"),
    "newer schema": sql("UPDATE meta SET value = '99' WHERE key = 'schema'"),
    "no schema": sql("DELETE FROM meta WHERE key = 'schema'"),
    "schema is a word": sql("UPDATE meta SET value = 'two' WHERE key = 'schema'"),
    "schema has 5000 digits": sql(f"UPDATE meta SET value = '{'9' * 5000}' WHERE key = 'schema'"),
    "old schema": sql("ALTER TABLE results DROP COLUMN finished", "UPDATE meta SET value = '1' WHERE key = 'schema'"),
    "outlier_m is a word": sql("UPDATE meta SET value = 'far' WHERE key = 'outlier_m'"),
    "outlier_m is nan": sql("UPDATE meta SET value = 'nan' WHERE key = 'outlier_m'"),
    "another error measure": sql("UPDATE meta SET value = 'luck' WHERE key = 'error'"),
    "title is markup": sql("UPDATE meta SET value = '[/] [bold' || char(27) || '[2J' WHERE key = 'title'"),
    # values
    "swept is a list": sql("UPDATE plan SET swept = '[1]' WHERE ordinal = 1"),
    "swept has other keys": sql("UPDATE plan SET swept = '{\"other\": 1}' WHERE ordinal = 1"),
    "swept is text": sql('UPDATE plan SET swept = \'{"noise": "[/"}\' WHERE ordinal < 4'),
    "swept is nested deeply": sql(f"UPDATE plan SET swept = '{'[' * 100_000}'"),
    "a repetition twice": sql("UPDATE plan SET repetition = 0"),
    "negative repetition": sql("UPDATE plan SET repetition = -5 WHERE ordinal = 1"),
    "negative seed": sql("UPDATE plan SET instance_seed = -1"),
    "unknown status": sql("UPDATE results SET status = 'fine'"),
    "scores are a list": sql("UPDATE results SET scores = '[1, 2]'"),
    "a score is a word": sql('UPDATE results SET scores = \'{"rmse_m": "good"}\''),
    "a score is infinite": sql('UPDATE results SET scores = \'{"rmse_m": "inf"}\''),
    "a score is huge": sql('UPDATE results SET scores = \'{"rmse_m": "1e308"}\''),
    "a score is a huge integer": sql(f"UPDATE results SET scores = '{{\"rmse_m\": {'9' * 400}}}'"),
    "no scores": sql("UPDATE results SET scores = '{}'"),
    "ragged estimate": sql("UPDATE results SET estimate = '[[1, 2], [3]]'"),
    "estimate of another shape": sql("UPDATE results SET estimate = '[1, 2, 3, 4, 5]'"),
    "estimate is a table": sql("UPDATE results SET estimate = '{}'"),
    "no estimate": sql("UPDATE results SET estimate = 'null'"),
    "huge time": sql("UPDATE results SET finished = 1e300, runtime_s = 1e300"),
    "text in place of a number": sql("UPDATE results SET objective = 'x', evaluations = 'y'"),
    "text that is not UTF-8": sql("UPDATE results SET message = CAST(x'fffe41' AS TEXT)"),
    "labels that are not UTF-8": sql("UPDATE plan SET method = CAST(x'c328' AS TEXT)"),
    "control characters": sql("UPDATE results SET message = 'a' || char(27, 13, 10, 0) || '[/]', status = 'failed'"),
    "labels are markup": sql("UPDATE plan SET method = '[/bold' || char(27) || ordinal || ']$x_' || char(0)"),
    # positions
    "positions dropped": sql("DROP TABLE positions"),
    "positions of unknown runs": placed("'x' || run_id", "'[]'", "'[]'"),
    "positions in the plane": placed("run_id", "'[[1, 2]]'", "'[[1, 2]]'"),
    "positions are text": placed("run_id", "'[[1, 2, 3]]'", '\'[["x", "y", "z"]]\''),
    "positions are null": placed("run_id", "'null'", "'null'"),
    "positions are a blob": placed("run_id", "x'00ff'", "'[]'"),
    "positions are nested deeply": placed("run_id", f"'{'[' * 100_000}'", "'[]'"),
    "fewer estimates than sources": placed("run_id", "'[[1, 2, 3]]'", "'[]'"),
    "positions are infinite": placed("run_id", "'[[1, 2, 3]]'", "'[[Infinity, NaN, 1e308]]'"),
    # traces
    "traces are no zlib": blob(b"garbage"),
    "traces are cut": blob(_npz(**GOOD)[:-20]),
    "traces are no archive": blob(zlib.compress(b"no archive")),
    "traces lack an array": blob(_npz(evaluations0=np.arange(3))),
    "traces have other names": blob(_npz(a=np.ones(1), b=np.ones(1), c=np.ones(1), d=np.ones(1))),
    "traces of unequal lengths": blob(_npz(**{**GOOD, "values0": np.ones(7)})),
    "traces of text": blob(_npz(**{**GOOD, "values0": np.array(["a", "b"])})),
    "traces begin at 0": blob(_npz(**{**GOOD, "evaluations0": np.arange(2)})),
    "traces inflate to a gigabyte": blob(zlib.compress(bytes(2**30), 1)),
    # other files
    "manifest is not UTF-8": replaced("manifest.toml"),
    "manifest is no TOML": replaced("manifest.toml", b"name = "),
    "manifest is a folder": with_folder("manifest.toml"),
    "manifest is a pipe": with_pipe("manifest.toml"),
    "no manifest": removed("manifest.toml"),
    "environment is not UTF-8": replaced("environment.json"),
    "environment is no JSON": replaced("environment.json", b"{"),
    "environment is a list": replaced("environment.json", b"[1]"),
    "environment is nested deeply": replaced("environment.json", b"[" * 100_000),
    "earlier environments are a number": replaced("environment.json", b'{"earlier": 5}'),
    "environment is a folder": with_folder("environment.json"),
    "environment is a pipe": with_pipe("environment.json"),
    "runs.csv is a folder": with_folder("runs.csv"),
    "summary.csv is a pipe": with_pipe("summary.csv"),
    "study.log is a folder": with_folder("study.log"),
    "study.log is a pipe": with_pipe("study.log"),
    "lock is a folder": with_folder(".lock"),
}
for _table, _names in COLUMNS.items():
    for _name in _names:
        KINDS[f"{_table}.{_name} is a blob"] = sql(f"UPDATE OR IGNORE {_table} SET {_name} = x'00ff'")
        if _name not in ("run_id", "status", "value"):
            KINDS[f"{_table}.{_name} is null"] = sql(f"UPDATE {_table} SET {_name} = NULL")
for _key in ("name", "seed", "title", "expect", "error", "outlier_m", "plan", "shard"):
    KINDS[f"meta lacks {_key}"] = sql(f"DELETE FROM meta WHERE key = '{_key}'")


def pickled(code):
    """Traces that run code if they are unpickled."""

    class Bomb:
        def __reduce__(self):
            return exec, (code,)

    return blob(_npz(**{**GOOD, "values0": np.array([Bomb()], dtype=object)}))


def flip(path, rng):
    """Flip one random bit of a file, and return the place of its byte."""
    content = bytearray(path.read_bytes())
    place = int(rng.integers(len(content)))
    content[place] ^= 1 << int(rng.integers(8))
    path.write_bytes(content)
    return place
