"""Runs a study into a folder, and reads the folder as pandas tables."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import pandas as pd

from .engine import Batches, run_specs
from .environment import describe_environment
from .errors import NfbenchError
from .execute import RunRecord
from .folders import prepare, write_whole
from .interrupts import Interrupts
from .log import logging_to
from .registry import Registry
from .scenario import Scenario
from .solver import Solver
from .store import Store, network_file_system
from .study import RunSpec, Study
from .tables import summarize

__all__ = ["Listener", "Results", "run"]


class Listener(Protocol):
    """Told of a study's progress while it runs."""

    def begin(self, total: int, done: int) -> None:
        """``done`` of ``total`` runs were finished before."""

    def finished(self, spec: RunSpec, record: RunRecord) -> None:
        """One more run is finished and stored."""

    def stopping(self) -> None:
        """Ctrl-C was met: runs in flight are finished, then the study stops. Called from a signal handler."""


@dataclass(frozen=True)
class Results:
    """A study's folder, read afresh at every access (also while the study runs).

    Raises StoreError where the folder holds no results.
    """

    folder: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))

    @property
    def runs(self) -> pd.DataFrame:
        """One row a finished run, in the study's order; the columns of ``runs.csv``."""
        with Store(self.folder) as store:
            return store.runs()

    @property
    def origins(self) -> pd.DataFrame:
        """Where and when each finished run was made: run_id, host, worker (process id), finished."""
        with Store(self.folder) as store:
            return store.origins()

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
                for run_id, traces in store.traces()
                for number, trace in enumerate(traces)
            ]
        columns = ["run_id", "problem", "evaluations", "seconds", "value"]
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=columns)

    @property
    def meta(self) -> dict[str, str]:
        """Name, seed, shard, title, expectation, error and outlier threshold of the study."""
        with Store(self.folder) as store:
            return store.meta

    @property
    def counts(self) -> dict[str, int]:
        """Runs by status; ``open`` are those without a result yet."""
        with Store(self.folder) as store:
            return store.counts()

    def summary(self, by: Sequence[str] | None = None, outlier_m: float | None = None) -> pd.DataFrame:
        """One row per group of ``by`` (default: swept keys, formulation, solver, method); see ``tables.summarize``."""
        return self._summary(self.runs, by, outlier_m)

    def write_tables(self) -> None:
        """Write ``runs.csv`` and ``summary.csv``; each replaces the old one only when it is whole."""
        runs = self.runs
        write_whole(self.folder / "runs.csv", lambda path: runs.to_csv(path, index=False))
        write_whole(self.folder / "summary.csv", lambda path: self._summary(runs).to_csv(path, index=False))

    def has_tables(self) -> bool:
        """Whether ``runs.csv`` and ``summary.csv`` are there."""
        return all((self.folder / name).is_file() for name in ("runs.csv", "summary.csv"))

    def _summary(
        self, runs: pd.DataFrame, by: Sequence[str] | None = None, outlier_m: float | None = None
    ) -> pd.DataFrame:
        meta = self.meta
        outlier_m = float(meta["outlier_m"]) if outlier_m is None else outlier_m
        return summarize(runs, by, error=meta["error"], outlier_m=outlier_m)


def run(
    study: Study,
    *,
    out: str | Path | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    shard: tuple[int, int] | None = None,
    fresh: bool = False,
    retry: Iterable[str] = (),
    listener: Listener | None = None,
) -> Results:
    """Run a study into ``out`` (default ``results/<name>``) and return its results; a second call resumes.

    jobs: worker processes (default: one a core; 0: in this process, without isolation). cluster: the address of a
    dask.distributed scheduler, or ``local:N`` to start one here with N workers, instead of jobs. shard: (k, n) makes
    only the k-th of n deterministic parts, to be joined by ``merge``. fresh: move an old folder aside first. retry:
    statuses whose runs are made again, e.g. ``["failed"]``.

    Raises StoreError where the folder cannot be used, has another writer or belongs to another study; KeyboardInterrupt
    after SIGINT or SIGTERM, with the runs in flight finished and a folder that resumes.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # a worker that imports the caller's script
        raise NfbenchError('a script that calls nfbench.run must do so below `if __name__ == "__main__":`')
    folder = Path("results") / study.name if out is None else Path(out)
    jobs = os.cpu_count() or 1 if jobs is None else jobs
    prepare(folder, fresh)
    results = Results(folder)
    told = listener.stopping if listener else lambda: None
    with Store(folder, write=True) as store, logging_to(folder / "study.log") as log, Interrupts(told) as stop:
        is_new = store.begin(study, shard)
        store.forget(retry)
        write_whole(folder / "manifest.toml", lambda path: path.write_text(study.manifest, encoding="utf-8"))
        if kind := network_file_system(folder):
            log.warning("%s is on a network file system (%s): writing without WAL, which is slower", folder, kind)
        todo = store.open_ordinals()
        total = sum(store.counts().values())
        log.info("%d of %d runs to do, %s", len(todo), total, cluster or f"{jobs} jobs")
        started = datetime.now(UTC)
        if todo and not cluster:
            _warm_up(study)
        if listener:
            listener.begin(total, total - len(todo))
        batches = _batches(study, todo, jobs, cluster, stop)
        try:
            for batch in batches:
                store.add(record for _, record in batch)
                for spec, record in batch:
                    if record.status != "ok":
                        log.info("%s: %s: %s", record.status, spec.method.label, record.message)
                    if listener:
                        listener.finished(spec, record)
        finally:
            batches.close()
            if todo or is_new or not store.tabled() or not results.has_tables():
                _write_environment(folder, describe_environment(study.plugins), cluster or jobs, started)
                results.write_tables()
                store.mark_tabled()
            log.info("ended: %s", ", ".join(f"{count} {status}" for status, count in store.counts().items()))
        if stop():
            raise KeyboardInterrupt
    return results


def _batches(study: Study, todo: list[int], jobs: int, cluster: str | None, stop: Callable[[], bool]) -> Batches:
    specs = map(study.spec, todo)
    if cluster is None:
        return run_specs(specs, study.plugins, jobs if todo else 0, stop)
    from .cluster import run_on_cluster

    return run_on_cluster(specs, study.plugins, cluster, stop)


def _warm_up(study: Study) -> None:
    """Once here, where its messages are seen; the workers then find what was compiled."""
    registry = Registry(study.plugins)
    solvers = {method.solver.kind: method.solver for method in study.methods if method.solver}
    for plugin, choice in [
        ("scenario", study.points[0].scenario),
        *(("solver", solver) for solver in solvers.values()),
    ]:
        if not choice.broken:
            part = registry.make(plugin, choice.kind, choice.options)
            assert isinstance(part, Scenario | Solver)
            part.warm_up()


def _write_environment(folder: Path, environment: dict[str, Any], jobs: int | str, started: datetime) -> None:
    """``environment.json``: this session, and those before it under ``earlier``."""
    path = folder / "environment.json"
    earlier = []
    with contextlib.suppress(OSError, ValueError):  # none, or spoilt by hand: this session is still written
        before = json.loads(path.read_text(encoding="utf-8"))
        earlier = [*before.pop("earlier", []), before]
    times = {"started": started.isoformat(), "ended": datetime.now(UTC).isoformat()}
    text = json.dumps({**environment, "jobs": jobs, **times, "earlier": earlier}, indent=2) + "\n"
    write_whole(path, lambda draft: draft.write_text(text, encoding="utf-8"))
