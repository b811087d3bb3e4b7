"""Merges results folders of one study, such as its shards, and rescues what can be read of damaged ones."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nfbench.core import StoreError

from .damage import Damaged
from .folder import whole_folder, write_whole
from .rescue import Rescue
from .results import Results
from .schema import PLAN_COLUMNS, POSITION_COLUMNS, PROOF_COLUMNS, REFERENCE_COLUMNS, RESULT_COLUMNS, marks
from .store import FILE, Store

__all__ = ["merge", "missing_shards"]

_SAME = ("name", "seed", "plan")
_REPAIR = "`nfbench run STUDY.toml` with --out on the merged folder"
_COSTS = ("evaluation_s", "batches", "batched")  # of a run, beside its scores
_LOCAL = ("schema", "shard", "shards", "tabled", "plan_rows")  # properties that are not taken from other folders


def merge(folders: Sequence[str | Path], out: str | Path, warn: Callable[[str], object] = lambda _: None) -> Results:
    """Merge the results of ``folders`` into ``out``, a new folder or one of the same study, and write its tables.

    Every row that can be read is taken from a damaged folder. Runs without a result, also those of shards that are not
    among the folders, are open in ``out``, and ``run`` resumes it.

    warn: receives a sentence about each damaged folder.

    Raises StoreError if the folders differ in study, seed, manifest or plugin versions, or if they have different
    results for the same run, or if ``out`` holds something else. Nothing is then written.
    """
    sources, out = [Path(folder) for folder in folders], Path(os.path.abspath(out))  # noqa: PTH100  # keeps symlinks
    if (out / FILE).exists():
        with Store(out, write=True) as store:
            _fill(store, [folder for folder in sources if folder.resolve() != out.resolve()], warn)
        return _finished(sources, out, warn)
    _refuse_foreign(out)
    with whole_folder(out) as draft:
        with Store(draft, write=True) as store:
            _fill(store, sources, warn)
        _finished(sources, draft, warn)
    return Results(out)


def missing_shards(results: Results) -> list[str]:
    """The shards that are missing in a folder that was merged from shards, as ``k/n``; empty if that is not known."""
    merged = [shard.partition("/") for shard in results.meta.get("shards", "").split()]
    numbers = {total for _, _, total in merged}
    if len(numbers) != 1 or not (total := numbers.pop()).isdecimal():
        return []
    present = {part for part, _, _ in merged}
    return [f"{k}/{total}" for k in range(1, min(int(total), 10_000) + 1) if str(k) not in present]


def _refuse_foreign(out: Path) -> None:
    try:
        names = sorted(path.name for path in out.iterdir()) if out.exists() else []
    except OSError as error:
        raise StoreError(f"{out}: {error.strerror or error}") from error
    if names or not out.name:
        raise StoreError(
            f"{out}: expected a new folder or one with results of the same study, found a folder with "
            f"{', '.join(names[:3])}; choose another one with --out"
        )


def _fill(store: Store, folders: Iterable[Path], warn: Callable[[str], object]) -> None:
    """Take over all folders in one transaction, so that the store is unchanged if one is refused."""
    with store.writing() as db:
        for folder in folders:
            try:
                with Store(folder) as other:
                    _check(store, folder, other.meta)
                    if other.plan_changed():
                        warn(
                            f"{other.path}: the table plan has changed since it was written; {_REPAIR} writes it again"
                        )
                    _take_properties(store, db, other.meta)
                    _take_plan(db, other.plan_rows())
                    _take_results(db, folder, other.result_rows())
                    _take_positions(db, other.positions.rows())
                    _take_proofs(db, other.references.plan_rows())
                    _take_references(db, folder, other.references.rows())
            except Damaged as damage:
                _rescue(store, db, folder, damage, warn)


def _rescue(store: Store, db: sqlite3.Connection, folder: Path, damage: Damaged, warn: Callable[[str], object]) -> None:
    """Take over what can be read; results that are already there stay."""
    found = Rescue(folder / FILE)
    _check(store, folder, found.meta)
    _take_properties(store, db, found.meta)
    _take_plan(db, iter(found.plan.values()))
    db.executemany(f"INSERT OR IGNORE INTO results VALUES ({marks(len(RESULT_COLUMNS))})", found.rows())
    _take_positions(db, found.positions.values())
    _take_proofs(db, found.proofs.values())
    _put_references(db, found.references.values())
    reason = str(damage).partition("; ")[0]
    lost = f"{found.lost} or more are lost" if found.lost else "none is known to be lost"
    if found.blanked:
        lost += f", {len(found.blanked)} lack their message, times or traces"
    if found.unplanned:
        lost += f", {found.unplanned} are not in the plan, which is damaged, and will be seen once it is written again"
    kept = f"{len(found.results)} results were read and are kept"
    warn(f"{reason}; {kept}, {lost}; {_REPAIR} writes the plan again and repeats what is missing")


def _check(store: Store, folder: Path, theirs: dict[str, str]) -> None:
    ours = store.meta
    for key in _SAME:
        if key in ours and key in theirs and ours[key] != theirs[key]:
            reason = f"its {key} is {theirs[key]!r:.80}, but that of the previous folders is {ours[key]!r:.80}"
            if key == "plan":
                reason = "its manifest or a plugin version differs from that of the previous folders"
            raise StoreError(f"{folder} cannot be merged: {reason}; nothing was written")


def _take_properties(store: Store, db: sqlite3.Connection, theirs: dict[str, str]) -> None:
    """Take over the properties of the study. The merged folder is no shard, but knows which shards it holds."""
    ours = store.meta
    shards = [*ours.get("shards", "").split(), ours.get("shard", "")]
    shards += [*theirs.get("shards", "").split(), theirs.get("shard", "")]
    known = {key: value for key, value in theirs.items() if key not in _LOCAL}
    known |= {"shard": "", "shards": " ".join(sorted({shard for shard in shards if shard}))}
    db.executemany("REPLACE INTO meta VALUES (?, ?)", known.items())
    db.execute("DELETE FROM meta WHERE key = 'plan_rows'")  # the next run writes the whole plan


def _take_plan(db: sqlite3.Connection, rows: Iterable[tuple[Any, ...]]) -> None:
    db.executemany(f"INSERT OR IGNORE INTO plan VALUES ({marks(len(PLAN_COLUMNS))})", rows)


def _take_results(db: sqlite3.Connection, folder: Path, rows: Iterable[tuple[Any, ...]]) -> None:
    for row in rows:
        present = db.execute("SELECT * FROM results WHERE run_id = ?", row[:1]).fetchone()
        if present is None:
            db.execute(f"INSERT INTO results VALUES ({marks(len(RESULT_COLUMNS))})", row)
        elif _computed(present) != _computed(row):
            raise StoreError(
                f"{folder} cannot be merged: its result of run {row[0]} ({row[1]}, objective {row[3]}) differs from "
                f"that in the previous folders ({present[1]}, objective {present[3]}); nothing was written"
            )


def _take_positions(db: sqlite3.Connection, rows: Iterable[tuple[Any, ...]]) -> None:
    """Take over the positions of runs, except those that are there: they follow from the results, which are equal."""
    db.executemany(f"INSERT OR IGNORE INTO positions VALUES ({marks(len(POSITION_COLUMNS))})", rows)


def _take_proofs(db: sqlite3.Connection, rows: Iterable[tuple[Any, ...]]) -> None:
    db.executemany(f"INSERT OR IGNORE INTO reference_plan VALUES ({marks(len(PROOF_COLUMNS))})", rows)


def _put_references(db: sqlite3.Connection, rows: Iterable[tuple[Any, ...]]) -> None:
    """Take over proofs of optima, except those that are there."""
    db.executemany(f"INSERT OR IGNORE INTO reference_optima VALUES ({marks(len(REFERENCE_COLUMNS))})", rows)


def _take_references(db: sqlite3.Connection, folder: Path, rows: Iterable[tuple[Any, ...]]) -> None:
    for row in rows:
        present = db.execute("SELECT * FROM reference_optima WHERE reference_id = ?", row[:1]).fetchone()
        if present is not None and _proven(present) != _proven(row):
            raise StoreError(
                f"{folder} cannot be merged: its proven optimum {row[0]} ({row[1]}, value {row[3]}) differs from that "
                f"in the previous folders ({present[1]}, value {present[3]}); nothing was written"
            )
        _put_references(db, [row])


def _proven(row: tuple[Any, ...]) -> tuple[Any, ...]:
    """What must be equal in two executions of one proof: status, value, gap, certified, step, columns, point."""
    return (row[1], *row[3:9])


def _computed(row: tuple[Any, ...]) -> tuple[Any, ...]:
    """What must be equal in two executions of one run: status, objective, evaluations, scores, estimate."""
    return (row[1], row[3], row[4], _without_costs(row[7]), row[8])


def _without_costs(scores: Any) -> Any:
    """The scores without the time inside the problem, and without what older versions did not record."""
    try:
        return {name: score for name, score in json.loads(scores).items() if name not in _COSTS}
    except (TypeError, ValueError, AttributeError, RecursionError):  # damaged: compared as it is
        return scores


def _finished(sources: Sequence[Path], out: Path, warn: Callable[[str], object]) -> Results:
    """Write everything besides the rows: the manifest, the environments, the tables."""
    for folder in sources:
        manifest = folder / "manifest.toml"
        if manifest.is_file() and manifest.resolve() != (out / manifest.name).resolve():
            write_whole(out / manifest.name, partial(shutil.copyfile, manifest))
    environments = [_environment(path) for f in sources if (path := f / "environment.json").is_file()]
    text = json.dumps({"merged": environments}, indent=2) + "\n"
    write_whole(out / "environment.json", lambda draft: draft.write_text(text, encoding="utf-8"))
    results = Results(out)
    try:
        results.write_tables()
    except StoreError as error:  # the rows are safe, but the plan or the properties of the study are damaged
        reason = str(error).partition("; ")[0].replace(str(out), "the merged folder")
        warn(f"no tables are written: {reason}; {_REPAIR} writes them")
    return results


def _environment(path: Path) -> Any:
    """The content of ``environment.json``, or why it cannot be read; no run depends on it."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        return {"unreadable": f"{path.name}: {type(error).__name__}"}
