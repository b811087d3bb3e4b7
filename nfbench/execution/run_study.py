"""Runs a study and writes its results folder."""

from __future__ import annotations

import contextlib
import heapq
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
from nfbench.study import MANIFEST_FOLDER, RunRecord, RunSpec, Study

from .compile_ahead import warm_up
from .engine import Batches, run_specs
from .environment import describe_environment
from .interrupts import Interrupts
from .log import logging_to

__all__ = ["Listener", "run"]


class Listener(Protocol):
    """Receives the progress of a study while it runs."""

    def begin(self, total: int, done: int) -> None:
        """Called before the first run; ``done`` of ``total`` runs, including proofs of optima, are finished."""

    def finished(self, spec: RunSpec, record: RunRecord) -> None:
        """Called after each run or proof that is finished and stored; ``spec.asks`` says which."""

    def stopping(self) -> None:
        """Called from a signal handler at the first Ctrl-C: current runs are finished, then the study stops."""


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
    """Run a study and return its results; a second call resumes.

    out: results folder; None: ``results/<name>``.
    jobs: number of worker processes; None: one per core; 0: run in this process, without isolation.
    cluster: address of a dask.distributed scheduler, or ``local:N`` to start one with N workers; None: use ``jobs``.
    shard: (k, n) runs only the k-th of n deterministic parts, to be joined by ``merge``; None: all runs.
    fresh: whether to move an existing folder aside first.
    retry: statuses whose runs are repeated, e.g. ``["failed"]``.
    listener: receives the progress.

    Raises StoreError if the folder cannot be used or belongs to another study, and KeyboardInterrupt after SIGINT or
    SIGTERM: after the first signal once the current runs are finished. The study can then be resumed.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # in a worker that imports the caller's script
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
        _log_warnings(log, study, folder)
        todo, proofs = store.open_ordinals(), store.references.open_ordinals()
        total = sum(store.counts().values())
        log.info("%d of %d runs to do, on %s", len(todo), total, cluster or f"{jobs} worker processes")
        if study.proven:
            log.info("%d of %d optima to prove", len(proofs), study.references)
            total += sum(store.references.counts().values())
        started = datetime.now(UTC)
        work = len(todo) + len(proofs)
        if work and not cluster:
            warm_up(study)
        if listener:
            listener.begin(total, total - work)
        try:
            _store_batches(_batches(study, todo, proofs, jobs, cluster, stop), store, log, listener)
        finally:
            if work or is_new or not store.tabled() or not results.has_tables():
                _write_environment(folder, study, cluster or jobs, started)
                results.write_tables()
                store.mark_tabled()
            log.info("ended: %s", ", ".join(f"{count} {status}" for status, count in store.counts().items()))
        if stop():
            raise KeyboardInterrupt
    return results


def _log_warnings(log: Logger, study: Study, folder: Path) -> None:
    """Keep the warnings of a study and of its folder in the log."""
    for text in study.warnings:
        log.warning("%s", text)
    if kind := network_file_system(folder):
        log.warning("%s is on a network file system (%s): writing without WAL, which is slower", folder, kind)


def _store_batches(batches: Batches, store: Store, log: Logger, listener: Listener | None) -> None:
    """Store every finished batch, then report its runs to the log and the listener."""
    try:
        for batch in batches:
            store.add(record for spec, record in batch if spec.asks == "estimate")
            if any(spec.asks == "reference" for spec, _ in batch):
                store.references.add(record for spec, record in batch if spec.asks == "reference")
            for spec, record in batch:
                if record.status != "ok":
                    log.info("%s: %s: %s", record.status, spec.method.label, record.message)
                if listener:
                    listener.finished(spec, record)
    finally:
        batches.close()


def _batches(
    study: Study, todo: list[int], proofs: list[int], jobs: int, cluster: str | None, stop: Callable[[], bool]
) -> Batches:
    """The runs and proofs, scene by scene: the proofs of a scene come first, because they may take longest."""
    specs = heapq.merge(map(study.reference, proofs), map(study.spec, todo), key=lambda spec: spec.repetition)
    if cluster is None:
        return run_specs(specs, study.plugins, jobs if todo or proofs else 0, stop)
    from .dask_cluster import run_on_cluster

    return run_on_cluster(specs, study.plugins, cluster, stop)


def _origin(study: Study, folder: Path) -> dict[str, str]:
    """Where the manifest was, so that relative paths in its copy keep their meaning; empty if it cannot be said."""
    with contextlib.suppress(ValueError):  # on another drive
        return {MANIFEST_FOLDER: Path(os.path.relpath(study.folder.resolve(), folder.resolve())).as_posix()}
    return {}


def _write_environment(folder: Path, study: Study, jobs: int | str, started: datetime) -> None:
    """Write ``environment.json``: this session, with the previous ones under ``earlier``."""
    environment: dict[str, Any] = {**describe_environment(study.plugins), **_origin(study, folder)}
    path = folder / "environment.json"
    earlier = []
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError, RecursionError):  # missing or not valid:
        before = json.loads(path.read_text(encoding="utf-8"))  # this session is written anyway
        earlier = [*before.pop("earlier", []), before]
    times = {"started": started.isoformat(), "ended": datetime.now(UTC).isoformat()}
    text = json.dumps({**environment, "jobs": jobs, **times, "earlier": earlier}, indent=2) + "\n"
    write_whole(path, lambda draft: draft.write_text(text, encoding="utf-8"))
