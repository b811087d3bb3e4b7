"""The engine: takes RunSpecs, yields RunRecords, and knows alone where runs happen."""

from __future__ import annotations

import contextlib
import itertools
import queue
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

AHEAD = 16  # runs queued for each worker, so that none waits for the parent
PATIENCE = 0.05  # seconds in which finished runs are gathered into one batch


def run_specs(
    specs: Iterable[RunSpec],
    plugins: Iterable[str | Path] = (),
    jobs: int = 0,
    stop: Callable[[], bool] = lambda: False,
) -> Batches:
    """Run specs and yield finished ones in batches, in any order, each with its record.

    jobs: worker processes; each run happens in one of them, where a crash, a timeout or a want of memory costs just
    that run. 0 runs in this process, one after another, without that protection. Once ``stop()`` is true, runs that
    have started are finished and no other is.
    """
    if jobs == 0:
        return _here(specs, tuple(plugins), stop)
    return _in_processes(specs, tuple(plugins), jobs, stop)


@contextlib.contextmanager
def ordered_runner(plugins: Iterable[str | Path], jobs: int) -> Iterator[RunAll]:
    """A function that runs specs and returns their records in the same order, with ``jobs`` as in ``run_specs``."""
    if jobs == 0:
        registry = Registry(plugins)
        with threadpool_limits(1):
            yield lambda specs: [execute(spec, registry) for spec in specs]
        return
    with ProcessPool(plugins, jobs) as workers:
        yield lambda specs: [future.result() for future in [workers.submit(spec) for spec in specs]]


def _here(specs: Iterable[RunSpec], plugins: tuple[str | Path, ...], stop: Callable[[], bool]) -> Batches:
    registry = Registry(plugins)
    with threadpool_limits(1):  # one BLAS thread: the same sums, bit for bit, as in a worker
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
                for future in [future for future in waiting if future.cancel()]:  # those that run cannot be
                    del waiting[future]
            if not waiting:
                return
            finished = [future for future in _gathered(done) if future in waiting]
            if finished:
                yield [(waiting.pop(future), future.result()) for future in finished]


def _gathered(done: queue.SimpleQueue[Future[RunRecord]]) -> Iterator[Future[RunRecord]]:
    """What is finished now, or within a moment."""
    try:
        yield done.get(timeout=PATIENCE)
        while True:
            yield done.get_nowait()
    except queue.Empty:
        return
