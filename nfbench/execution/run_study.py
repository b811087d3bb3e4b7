"""Runs a study into a folder."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from logging import Logger
from pathlib import Path
from typing import Any, Protocol

from nfbench.core import NfbenchError
from nfbench.results import Results, Store, network_file_system, prepare, write_whole
from nfbench.study import RunRecord, RunSpec, Study

from .compile_ahead import warm_up
from .engine import Batches, run_specs
from .environment import describe_environment
from .interrupts import Interrupts
from .log import logging_to

__all__ = ["Listener", "run"]


class Listener(Protocol):
    """Told of a study's progress while it runs."""

    def begin(self, total: int, done: int) -> None:
        """``done`` of ``total`` runs were finished before."""

    def finished(self, spec: RunSpec, record: RunRecord) -> None:
        """One more run is finished and stored."""

    def stopping(self) -> None:
        """Ctrl-C was met: runs in flight are finished, then the study stops. Called from a signal handler."""


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
    stopping = listener.stopping if listener else lambda: None
    with Store(folder, write=True) as store, logging_to(folder / "study.log") as log, Interrupts(stopping) as stop:
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
            warm_up(study)
        if listener:
            listener.begin(total, total - len(todo))
        try:
            _make_runs(_batches(study, todo, jobs, cluster, stop), store, log, listener)
        finally:
            if todo or is_new or not store.tabled() or not results.has_tables():
                _write_environment(folder, describe_environment(study.plugins), cluster or jobs, started)
                results.write_tables()
                store.mark_tabled()
            log.info("ended: %s", ", ".join(f"{count} {status}" for status, count in store.counts().items()))
        if stop():
            raise KeyboardInterrupt
    return results


def _make_runs(batches: Batches, store: Store, log: Logger, listener: Listener | None) -> None:
    """Store every finished batch, and report its runs."""
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


def _batches(study: Study, todo: list[int], jobs: int, cluster: str | None, stop: Callable[[], bool]) -> Batches:
    specs = map(study.spec, todo)
    if cluster is None:
        return run_specs(specs, study.plugins, jobs if todo else 0, stop)
    from .dask_cluster import run_on_cluster

    return run_on_cluster(specs, study.plugins, cluster, stop)


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
