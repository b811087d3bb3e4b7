"""The engine: takes RunSpecs, yields RunRecords, and knows alone where runs happen."""

from __future__ import annotations

import itertools
import math
import os
import signal
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from .budget import Status
from .execute import RunRecord, execute
from .registry import Registry
from .study import RunSpec

if TYPE_CHECKING:
    from pebble import ProcessFuture

__all__ = ["run_specs"]


def run_specs(specs: Iterable[RunSpec], plugins: Iterable[str | Path] = (), jobs: int = 0) -> Iterator[RunRecord]:
    """Run specs and yield each record as it is finished, in any order.

    jobs: worker processes, each run in one of them, where a crash or a timeout costs just that run.
    0 runs in this process, one after another, without that protection.
    """
    if jobs == 0:
        return _here(specs, tuple(plugins))
    return _in_processes(specs, tuple(plugins), jobs)


def _here(specs: Iterable[RunSpec], plugins: tuple[str | Path, ...]) -> Iterator[RunRecord]:
    registry = Registry(plugins)
    for spec in specs:
        with threadpool_limits(1):  # one BLAS thread: the same sums, bit for bit, on every machine and load
            record = execute(spec, registry)
        yield record


def _in_processes(specs: Iterable[RunSpec], plugins: tuple[str | Path, ...], jobs: int) -> Iterator[RunRecord]:
    from pebble import ProcessPool

    pool = ProcessPool(jobs, initializer=_start_worker, initargs=(plugins,), context=get_context("spawn"))
    waiting: dict[ProcessFuture[RunRecord], RunSpec] = {}
    queue = iter(specs)
    try:
        while True:
            for spec in itertools.islice(queue, 4 * jobs - len(waiting)):
                waiting[pool.schedule(_work, args=[spec], timeout=spec.method.run_timeout_s)] = spec
            if not waiting:
                break
            wait(waiting, return_when=FIRST_COMPLETED)
            for future in [future for future in waiting if future.done()]:
                yield _record(waiting.pop(future), future)
        pool.close()  # type: ignore[no-untyped-call]
    except BaseException:
        pool.stop()  # type: ignore[no-untyped-call]
        raise
    finally:
        pool.join()


def _record(spec: RunSpec, future: ProcessFuture[RunRecord]) -> RunRecord:
    from pebble import ProcessExpired

    try:
        return future.result()
    except TimeoutError:
        limit = spec.method.run_timeout_s or math.nan
        return RunRecord(spec.run_id, Status.TIMEOUT, f"stopped after run_timeout_s = {limit:g} s", runtime_s=limit)
    except ProcessExpired as error:
        return RunRecord(spec.run_id, Status.CRASHED, f"its process died: {_cause(error.exitcode)}")


def _cause(exitcode: int) -> str:
    if exitcode >= 0:
        return f"exit code {exitcode}"
    return f"signal {-exitcode} ({signal.Signals(-exitcode).name})"


# --- in the worker -----------------------------------------------------------------------------------------------

_registry: Registry | None = None


def _start_worker(plugins: tuple[str | Path, ...]) -> None:
    """Once per process: ignore Ctrl-C, which the parent handles; pin BLAS; import the plugins."""
    global _registry
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"
    _registry = Registry(plugins)


def _work(spec: RunSpec) -> RunRecord:
    assert _registry is not None
    with threadpool_limits(1):
        return execute(spec, _registry)
