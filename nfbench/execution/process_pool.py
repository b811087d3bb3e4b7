"""Worker processes, one run at a time in each, that can die at any moment and cost only that run.

Each worker has a pipe of its own, so that one killed while it writes leaves nothing behind that others need: neither a
lock nor half a message in a queue.
"""

from __future__ import annotations

import contextlib
import math
import signal
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Self

from nfbench.core import NfbenchError, Status
from nfbench.study import RunRecord, RunSpec

from . import worker

__all__ = ["ProcessPool"]

MAX_FAILED_STARTS = 3  # in a row: then no worker can start here
GROWTH_MB = 1024.0  # of a worker's memory, after which another takes its place
CLOSING_S = 5.0  # for workers to end by themselves


@dataclass(eq=False)
class _Worker:
    """A process, our end of its pipe, and the run it has."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    spec: RunSpec | None = None
    future: Future[RunRecord] | None = None
    deadline: float = math.inf


class ProcessPool:
    """``jobs`` worker processes; a run is killed at its timeout, and a worker that dies is replaced.

    A context manager: on an exception the workers are killed, otherwise they first finish what was submitted.
    """

    def __init__(self, plugins: Iterable[str | Path], jobs: int) -> None:
        self._plugins, self._jobs = tuple(plugins), jobs
        self._folder = tempfile.TemporaryDirectory(prefix="nfbench-", ignore_cleanup_errors=True)
        self._spawn = get_context("spawn")
        self._woken, self._waker = self._spawn.Pipe(duplex=False)
        self._queue: deque[tuple[RunSpec, Future[RunRecord]]] = deque()
        self._workers: list[_Worker] = []
        self._failed_starts = 0
        self._error: NfbenchError | None = None
        self._closing = self._killing = False
        self._supervisor = threading.Thread(target=self._supervise, name="nfbench-supervisor", daemon=True)
        self._supervisor.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._closing, self._killing = True, kind is not None
        self._wake()
        self._supervisor.join()
        self._woken.close()
        self._waker.close()
        self._folder.cleanup()

    def submit(self, spec: RunSpec) -> Future[RunRecord]:
        """Queue a run. Its future comes to a record, or to an NfbenchError where no worker can start.

        It can be cancelled until the run starts.
        """
        future: Future[RunRecord] = Future()
        self._queue.append((spec, future))
        self._wake()
        if not self._supervisor.is_alive():
            self._give_up()
        return future

    def _wake(self) -> None:
        self._waker.send_bytes(b".")

    # --- the supervisor's thread, which alone touches the workers ---------------------------------------------------

    def _supervise(self) -> None:
        try:
            while not self._killing:
                self._start_workers()
                self._assign()
                busy = [each for each in self._workers if each.spec]
                if self._closing and not busy and not self._queue:
                    break
                self._listen()
        except BaseException as error:
            self._error = error if isinstance(error, NfbenchError) else NfbenchError(f"the engine failed: {error!r}")
        finally:
            self._end_workers()
            self._give_up()

    def _give_up(self) -> None:
        """Every run that is still queued or in a worker ends in the engine's error; without one, it is cancelled."""
        for each in self._workers:
            if each.future and self._error is not None:
                each.future.set_exception(self._error)
            each.spec = each.future = None
        while self._queue:
            _, future = self._queue.popleft()
            if self._error is None:
                future.cancel()
            elif future.set_running_or_notify_cancel():
                future.set_exception(self._error)

    def _start_workers(self) -> None:
        """As many as there is work for. Where none can start, that is an error of the place, not of the runs."""
        if self._failed_starts >= MAX_FAILED_STARTS:
            raise NfbenchError(
                f"worker processes cannot start: {self._last_output}. A script that calls nfbench.run must do so below "
                f'`if __name__ == "__main__":`, as workers import it first'
            )
        idle = sum(each.spec is None for each in self._workers)
        for _ in range(min(self._jobs - len(self._workers), len(self._queue) - idle)):
            ours, theirs = self._spawn.Pipe()
            arguments = (theirs, self._plugins, self._folder.name, GROWTH_MB)
            process = self._spawn.Process(target=worker.serve, args=arguments, daemon=True)
            process.start()
            theirs.close()
            self._workers.append(_Worker(process, ours))

    def _assign(self) -> None:
        for each in self._workers:
            if not each.ready or each.spec:
                continue
            while self._queue:
                spec, future = self._queue.popleft()
                if future.set_running_or_notify_cancel():
                    each.spec, each.future = spec, future
                    each.deadline = time.monotonic() + (spec.method.run_timeout_s or math.inf)
                    with contextlib.suppress(OSError):  # dead since we last listened; its pipe will say so
                        each.pipe.send(spec)
                    break

    def _listen(self) -> None:
        """Wait until a worker says something or dies, a deadline passes, or there is something new to do."""
        pipes: dict[object, _Worker] = {each.pipe: each for each in self._workers}
        left = min((each.deadline for each in self._workers), default=math.inf) - time.monotonic()
        heard = wait([*pipes, self._woken], None if math.isinf(left) else max(left, 0.0))  # type: ignore[list-item]
        if self._woken in heard:
            while self._woken.poll():
                self._woken.recv_bytes()
        for pipe, each in pipes.items():
            if pipe in heard:
                self._hear(each)
            elif time.monotonic() >= each.deadline:
                limit = each.spec.method.run_timeout_s if each.spec else None
                text = f"stopped after run_timeout_s = {limit:g} s"
                self._fail_worker(each, Status.TIMEOUT, text, limit or math.nan)

    def _hear(self, each: _Worker) -> None:
        try:
            said = each.pipe.recv()
        except Exception:  # the end of the pipe, or of a message that will not be completed
            each.process.join(CLOSING_S)
            words = worker.last_output(self._folder.name, each.process.pid)
            cause = f"its process died: {_cause(each.process.exitcode)}{f': {words}' if words else ''}"
            self._fail_worker(each, Status.CRASHED, cause)
            return
        if not each.ready:
            each.ready, self._failed_starts = True, 0
        elif each.future:
            record, retires = said
            future, each.spec, each.future, each.deadline = each.future, None, None, math.inf
            if retires:
                self._remove(each)
            future.set_result(record)

    def _fail_worker(self, each: _Worker, status: Status, message: str, runtime_s: float = math.nan) -> None:
        """Remove a worker that is dead or must be killed; its run, if it has one, ends with this status."""
        self._remove(each)
        if not each.ready:
            self._failed_starts += 1
            self._last_output = message
        if each.future and each.spec:
            each.future.set_result(RunRecord(each.spec.run_id, status, message, runtime_s=runtime_s))

    def _remove(self, each: _Worker) -> None:
        each.process.kill()
        each.process.join()
        each.pipe.close()
        self._workers.remove(each)

    def _end_workers(self) -> None:
        for each in self._workers:
            if self._killing:
                each.process.kill()
            each.pipe.close()  # a worker that waits for its next run ends when there is none to come
        deadline = time.monotonic() + CLOSING_S
        for each in self._workers:
            each.process.join(max(deadline - time.monotonic(), 0.0))
            each.process.kill()
            each.process.join()


def _cause(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"exit code {exitcode}"
    return f"signal {-exitcode} ({signal.Signals(-exitcode).name})"
