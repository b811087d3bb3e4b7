"""The engine: takes RunSpecs and yields RunRecords. No other part of nfbench knows where runs are executed."""

from __future__ import annotations

import contextlib
import itertools
import queue
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TypeAlias

from threadpoolctl import threadpool_limits

from nfbench.plugins import Registry
from nfbench.study import RunRecord, RunSpec

from .process_pool import ProcessPool
from .run_one import execute

__all__ = ["Batches", "RunAll", "ordered_runner", "run_specs"]

Batches: TypeAlias = Generator[list[tuple[RunSpec, RunRecord]], None, None]
RunAll: TypeAlias = Callable[[Sequence[RunSpec]], list[RunRecord]]

AHEAD = 64  # runs queued per worker, so that no worker waits for the parent process
PATIENCE_S = 0.05  # time to wait for a finished run [s]
TOGETHER_S = 0.01  # time for which finished runs are gathered [s]: writing them to disk costs the same for one or many


def run_specs(
    specs: Iterable[RunSpec],
    plugins: Iterable[str | Path] = (),
    jobs: int = 0,
    stop: Callable[[], bool] = lambda: False,
) -> Batches:
    """Run specs and yield batches of (spec, record) pairs as the runs finish, in any order.

    specs: the runs to execute.
    plugins: plugin files that the runs need.
    jobs: number of worker processes. Each run is executed in one of them, so that a crash, a timeout or running out
    of memory costs only that run. 0 executes all runs in this process, one after another, without that protection.
    stop: once it returns True, runs that have started are finished and no other run is started.
    """
    if jobs == 0:
        return _in_this_process(specs, tuple(plugins), stop)
    return _in_processes(specs, tuple(plugins), jobs, stop)


@contextlib.contextmanager
def ordered_runner(plugins: Iterable[str | Path], jobs: int) -> Iterator[RunAll]:
    """Yield a function that runs specs and returns their records in order; ``jobs`` is as in ``run_specs``."""
    if jobs == 0:
        registry = Registry(plugins)
        with threadpool_limits(1):
            yield lambda specs: [execute(spec, registry) for spec in specs]
        return
    with ProcessPool(plugins, jobs) as workers:
        yield lambda specs: [future.result() for future in [workers.submit(spec) for spec in specs]]


def _in_this_process(specs: Iterable[RunSpec], plugins: tuple[str | Path, ...], stop: Callable[[], bool]) -> Batches:
    registry = Registry(plugins)
    with threadpool_limits(1):  # one BLAS thread, so that sums are bit-for-bit the same as in a worker
        for spec in itertools.takewhile(lambda _: not stop(), specs):
            yield [(spec, execute(spec, registry))]


def _in_processes(
    specs: Iterable[RunSpec], plugins: tuple[str | Path, ...], jobs: int, stop: Callable[[], bool]
) -> Batches:
    done: queue.SimpleQueue[Future[RunRecord]] = queue.SimpleQueue()
    waiting: dict[Future[RunRecord], RunSpec] = {}
    feed = itertools.takewhile(lambda _: not stop(), specs)
    with ProcessPool(plugins, jobs) as workers:
        while True:
            for spec in itertools.islice(feed, AHEAD * jobs - len(waiting)):
                future = workers.submit(spec)
                waiting[future] = spec
                future.add_done_callback(done.put)
            if stop():
                for future in [future for future in waiting if future.cancel()]:  # running ones cannot be cancelled
                    del waiting[future]
            if not waiting:
                return
            finished = [future for future in _gathered(done) if future in waiting]
            if finished:
                yield [(waiting.pop(future), future.result()) for future in finished]


def _gathered(done: queue.SimpleQueue[Future[RunRecord]]) -> Iterator[Future[RunRecord]]:
    """Wait for a run to finish, and yield it with those that finish shortly after it."""
    try:
        yield done.get(timeout=PATIENCE_S)
        deadline = time.monotonic() + TOGETHER_S
        while True:
            yield done.get(timeout=max(deadline - time.monotonic(), 0.0))
    except queue.Empty:
        return
