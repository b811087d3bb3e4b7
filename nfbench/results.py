"""Runs a study into a folder, and reads the folder as pandas tables."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

import pandas as pd

from .engine import run_specs
from .environment import describe_environment
from .errors import StoreError
from .execute import RunRecord
from .store import Store
from .study import Study
from .tables import summarize

__all__ = ["Listener", "Results", "run"]


class Listener(Protocol):
    """Told of a study's progress while it runs."""

    def begin(self, total: int, done: int) -> None:
        """``done`` of ``total`` runs were finished before."""

    def finished(self, record: RunRecord) -> None:
        """One more run is finished and stored."""


@dataclass(frozen=True)
class Results:
    """A study's folder, read afresh at every access (also while the study runs).

    Raises StoreError where the folder holds no results.
    """

    folder: Path

    @property
    def runs(self) -> pd.DataFrame:
        """One row a finished run, in the study's order; the columns of ``runs.csv``."""
        with Store(self.folder) as store:
            return store.runs()

    @property
    def traces(self) -> pd.DataFrame:
        """Every improvement of every run: run_id, problem (0, 1 … in the run), evaluations, seconds, value, x_0 …"""
        with Store(self.folder) as store:
            frames = [
                pd.DataFrame(
                    {
                        "run_id": run_id,
                        "problem": number,
                        "evaluations": trace.evaluations,
                        "seconds": trace.seconds,
                        "value": trace.values,
                        **{f"x_{j}": column for j, column in enumerate(trace.points.T)},
                    }
                )
                for run_id, traces in store.all_traces()
                for number, trace in enumerate(traces)
            ]
        columns = ["run_id", "problem", "evaluations", "seconds", "value"]
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=columns)

    @property
    def meta(self) -> dict[str, str]:
        """Name, seed, title, expectation, error and outlier threshold of the study."""
        with Store(self.folder) as store:
            return store.meta

    @property
    def counts(self) -> dict[str, int]:
        """Runs by status; ``open`` are those without a result yet."""
        with Store(self.folder) as store:
            return store.counts()

    def summary(self, by: Sequence[str] | None = None, outlier_m: float | None = None) -> pd.DataFrame:
        """One row per group of ``by`` (default: swept keys, formulation, solver, method); see ``tables.summarize``."""
        meta = self.meta
        outlier_m = float(meta["outlier_m"]) if outlier_m is None else outlier_m
        return summarize(self.runs, by, error=meta["error"], outlier_m=outlier_m)

    def write_tables(self) -> list[Path]:
        """Write ``runs.csv`` and ``summary.csv``; each replaces the old one only when it is whole."""
        tables = {"runs.csv": self.runs, "summary.csv": self.summary()}
        return [_written(self.folder / name, table.to_csv(index=False)) for name, table in tables.items()]


def run(
    study: Study,
    *,
    out: str | Path | None = None,
    jobs: int | None = None,
    fresh: bool = False,
    retry: Iterable[str] = (),
    listener: Listener | None = None,
) -> Results:
    """Run a study into ``out`` (default ``results/<name>``) and return its results; a second call resumes.

    jobs: worker processes (default: one a core; 0: in this process). fresh: move an old folder aside first.
    retry: statuses whose runs are made again, e.g. ``["failed"]``. Raises StoreError where the folder cannot be used
    or belongs to another study. KeyboardInterrupt leaves a folder that resumes.
    """
    folder = Path("results") / study.name if out is None else Path(out)
    jobs = os.cpu_count() or 1 if jobs is None else jobs
    try:
        if fresh and folder.exists():
            folder.rename(folder.with_name(f"{folder.name}.{datetime.now():%Y%m%d-%H%M%S}"))
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: {error.strerror or error}") from error
    results = Results(folder)
    with Store(folder, create=True) as store:
        store.begin(study)
        store.forget(retry)
        started = time.time()
        _written(folder / "manifest.toml", study.manifest)
        done = store.finished()
        todo = (spec for spec in study.specs() if spec.run_id not in done)
        if listener:
            counts = store.counts()
            listener.begin(len(study), len(study) - counts.get("open", 0))
        try:
            for record in run_specs(todo, study.plugins, jobs):
                store.add(record)
                if listener:
                    listener.finished(record)
        finally:
            _written(folder / "environment.json", json.dumps(_environment(study, jobs, started), indent=2) + "\n")
            results.write_tables()
    return results


def _environment(study: Study, jobs: int, started: float) -> dict[str, object]:
    times = {
        name: datetime.fromtimestamp(t, UTC).isoformat() for name, t in (("started", started), ("ended", time.time()))
    }
    return {**describe_environment(study.plugins), "jobs": jobs, **times}


def _written(path: Path, text: str) -> Path:
    """Write a file whole or not at all. Raises StoreError, and the old file stays, where that fails."""
    draft = path.with_name(f".{path.name}.draft")
    try:
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise StoreError(f"{path}: {error.strerror or error}; finished rows are kept in runs.sqlite") from error
    return path
