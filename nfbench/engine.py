"""The engine: takes RunSpecs, yields RunRecords, and knows alone where runs happen."""

from __future__ import annotations

import itertools
import math
import queue
import signal
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from threadpoolctl import threadpool_limits

from . import worker
from .budget import Status
from .execute import RunRecord, execute
from .registry import Registry
from .study import RunSpec

if TYPE_CHECKING:
    from pebble import ProcessPool

__all__ = ["Batches", "Isolated", "run_specs"]

Batches: TypeAlias = Generator[list[tuple[RunSpec, RunRecord]], None, None]

AHEAD = 16  # runs queued for each worker, so that none waits for the parent
PATIENCE = 0.05  # seconds in which finished runs are gathered into one batch
GRACE = 0.3  # seconds between asking a worker to end and killing it


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


def _here(specs: Iterable[RunSpec], plugins: tuple[str | Path, ...], stop: Callable[[], bool]) -> Batches:
    registry = Registry(plugins)
    with threadpool_limits(1):  # one BLAS thread: the same sums, bit for bit, as in a worker
        for spec in itertools.takewhile(lambda _: not stop(), specs):
            yield [(spec, execute(spec, registry))]


def _in_processes(
    specs: Iterable[RunSpec], plugins: tuple[str | Path, ...], jobs: int, stop: Callable[[], bool]
) -> Batches:
    with Isolated(plugins, jobs) as pool:
        done: queue.SimpleQueue[Future[RunRecord]] = queue.SimpleQueue()
        waiting: dict[Future[RunRecord], RunSpec] = {}
        feed = itertools.takewhile(lambda _: not stop(), specs)
        while True:
            for spec in itertools.islice(feed, AHEAD * jobs - len(waiting)):
                future = pool.submit(spec)
                waiting[future] = spec
                future.add_done_callback(lambda future: done.put(future))
            if stop():
                for future in [future for future in waiting if not future.running() and _cancelled(future)]:
                    del waiting[future]
            if not waiting:
                return
            finished = [future for future in _gathered(done) if future in waiting]
            if finished:
                yield [(spec := waiting.pop(future), pool.record(spec, future)) for future in finished]


def _gathered(done: queue.SimpleQueue[Future[RunRecord]]) -> Iterator[Future[RunRecord]]:
    """What is finished now, or within a moment."""
    try:
        yield done.get(timeout=PATIENCE)
        while True:
            yield done.get_nowait()
    except queue.Empty:
        return


def _cancelled(future: Future[RunRecord]) -> bool:
    return future.cancel()


class Isolated:
    """Worker processes that take one run each at a time, are killed at its timeout, and replaced when they die.

    A context manager: on an exception the workers are killed, otherwise they end when they are done.
    """

    def __init__(self, plugins: tuple[str | Path, ...], jobs: int) -> None:
        import pebble

        pebble.CONSTS.term_timeout = GRACE  # pebble has one setting for the process, and three seconds by default
        self._folder = tempfile.TemporaryDirectory(prefix="nfbench-", ignore_cleanup_errors=True)
        self._pool: ProcessPool = pebble.ProcessPool(
            jobs, initializer=worker.start, initargs=(plugins, self._folder.name), context=get_context("spawn")
        )

    def __enter__(self) -> Isolated:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._pool.close() if kind is None else self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()
        self._folder.cleanup()

    def submit(self, spec: RunSpec) -> Future[RunRecord]:
        """Queue a run; its future is read with ``record``."""
        return self._pool.schedule(worker.work, args=[spec], timeout=spec.method.run_timeout_s)

    def record(self, spec: RunSpec, future: Future[RunRecord]) -> RunRecord:
        """The record of a finished run, also where its process did not live to write one."""
        from pebble import ProcessExpired

        try:
            return future.result()
        except TimeoutError:
            limit = spec.method.run_timeout_s or math.nan
            return RunRecord(spec.run_id, Status.TIMEOUT, f"stopped after run_timeout_s = {limit:g} s", runtime_s=limit)
        except ProcessExpired as error:
            words = worker.last_words(self._folder.name, error.pid)
            cause = f"its process died: {_cause(error.exitcode)}{f': {words}' if words else ''}"
            return RunRecord(spec.run_id, Status.CRASHED, cause)
        except Exception as error:  # the record could not be sent, or the pool is broken: a row all the same
            return RunRecord(spec.run_id, Status.CRASHED, f"no record came back: {type(error).__name__}: {error}")


def _cause(exitcode: int) -> str:
    if exitcode >= 0:
        return f"exit code {exitcode}"
    return f"signal {-exitcode} ({signal.Signals(-exitcode).name})"
