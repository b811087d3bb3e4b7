"""A pool of worker processes that execute one run at a time. A process that dies costs only the run that it executes.

Each worker has its own pipe. A worker that is killed while it writes therefore leaves behind neither a held lock nor
half a message in a queue that other workers share.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Self

from nfbench.core import NfbenchError, Status, cause_of_end
from nfbench.study import RunRecord, RunSpec

from .scratch import ScratchFolder
from .worker import BLOCKED_AT_START, last_output, serve

__all__ = ["ProcessPool"]

MAX_FAILED_STARTS = 3  # consecutive failures after which the pool gives up
GROWTH_MB = 1024.0  # growth of a worker's memory [MiB] after which it is replaced
CLOSING_S = 5.0  # time for workers to end by themselves
LONGEST_WAIT_S = 3600.0  # longer than this, the system cannot wait at once
FAST_S = 0.005  # runs of a worker are sent ahead if the last one took less than this
AHEAD = 32  # runs of a worker, with those sent ahead
AHEAD_BYTES = 2**15  # so small that it fits into a pipe: otherwise worker and pool might wait for each other
POLL_S = 0.5  # between two looks at whether a worker is alive, where the system does not say so


@dataclass(eq=False)
class _Worker:
    """A worker process, our end of its pipe, and its runs.

    runs: runs that were sent to it: first the one that it executes, then those that wait in its pipe.
    sizes: size of each of these messages [bytes].
    """

    process: BaseProcess
    pipe: Connection
    exit: int  # a descriptor that becomes readable when the process, and not only its pipe, is gone
    ready: bool = False
    runs: deque[_Run] = field(default_factory=deque)
    sizes: deque[int] = field(default_factory=deque)
    started: float = 0.0
    deadline: float = math.inf
    is_fast: bool = False  # whether its last run was so short that the next ones are sent ahead

    def start_first(self) -> None:
        """Note that the first of the runs starts now."""
        self.started = time.monotonic()
        self.deadline = self.started + (self.runs[0].spec.method.run_timeout_s or math.inf) if self.runs else math.inf

    def may_take(self) -> bool:
        """Whether another run can be sent: to an idle worker, or ahead to one whose runs are short."""
        return not self.runs or (self.is_fast and len(self.runs) < AHEAD and sum(self.sizes) < AHEAD_BYTES)


@dataclass(frozen=True, eq=False)
class _Run:
    """A run to execute, and the future of its record."""

    spec: RunSpec
    future: Future[RunRecord]


class ProcessPool:
    """A pool of worker processes. A run is killed at its timeout, and a worker that dies is replaced.

    Use the pool as a context manager: on an exception the workers are killed, otherwise they first finish all
    submitted runs.

    plugins: plugin files that the runs need.
    jobs: maximum number of worker processes.
    """

    def __init__(self, plugins: Iterable[str | Path], jobs: int) -> None:
        self._plugins, self._jobs = tuple(plugins), jobs
        self._folder = ScratchFolder()
        self._spawn = get_context("spawn")
        self._woken, self._waker = self._spawn.Pipe(duplex=False)
        self._queue: deque[_Run] = deque()
        self._workers: list[_Worker] = []
        self._failed_starts = 0.0
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
        """Queue a run and return a future of its record. The future fails with NfbenchError if no worker can start.

        The future can be cancelled until the run starts.
        """
        future: Future[RunRecord] = Future()
        self._queue.append(_Run(spec, future))
        if len(self._queue) == 1:  # otherwise the supervisor has not come to the run before this one yet
            self._wake()
        if not self._supervisor.is_alive():
            self._give_up()
        return future

    def _wake(self) -> None:
        self._waker.send_bytes(b".")

    # --- the supervisor's thread, which alone touches the workers ---------------------------------------------------

    def _supervise(self) -> None:
        resource_tracker.ensure_running()  # starting it would undo what follows
        # inherited by workers, so that Ctrl-C does not reach them before they have their own handlers
        signal.pthread_sigmask(signal.SIG_BLOCK, BLOCKED_AT_START)
        try:
            while not self._killing:
                self._start_workers()
                self._assign()
                busy = [worker for worker in self._workers if worker.runs]
                if self._closing and not busy and not self._queue:
                    break
                self._listen()
        except BaseException as error:
            self._error = error if isinstance(error, NfbenchError) else NfbenchError(f"the engine failed: {error!r}")
        finally:
            self._end_workers()
            self._give_up()

    def _give_up(self) -> None:
        """Fail all queued and running runs with the engine's error; without an error, cancel the queued ones."""
        for worker in self._workers:
            self._queue.extend(worker.runs)
            worker.runs.clear()
        while self._queue:
            future = self._queue.popleft().future
            if self._error is None:
                future.cancel()
            elif future.running() or future.set_running_or_notify_cancel():
                future.set_exception(self._error)

    def _start_workers(self) -> None:
        """Start as many workers as there is work for. If none can start, the machine is at fault, not the runs."""
        if self._failed_starts >= MAX_FAILED_STARTS:
            raise NfbenchError(
                f"worker processes cannot start: {self._last_output}. A script that calls nfbench.run must do so below "
                f'`if __name__ == "__main__":`, because workers import the script'
            )
        idle = sum(not worker.runs for worker in self._workers)
        for _ in range(min(self._jobs - len(self._workers), len(self._queue) - idle)):
            ours, theirs = self._spawn.Pipe()
            arguments = (theirs, self._plugins, str(self._folder.path), GROWTH_MB)
            process = self._spawn.Process(target=serve, args=arguments, daemon=True)
            process.start()
            theirs.close()
            self._workers.append(_Worker(process, ours, _exit_descriptor(process)))

    def _assign(self) -> None:
        for worker in self._workers:
            while self._queue and worker.ready and worker.may_take():
                run = self._queue.popleft()
                if run.future.running() or run.future.set_running_or_notify_cancel():
                    self._send(worker, run)

    def _send(self, worker: _Worker, run: _Run) -> None:
        message = ForkingPickler.dumps(run.spec)
        worker.runs.append(run)
        worker.sizes.append(len(message))
        if len(worker.runs) == 1:
            worker.start_first()
        with contextlib.suppress(OSError):  # it has died; reading its pipe will show that
            worker.pipe.send_bytes(message)

    def _listen(self) -> None:
        """Wait for a message or the death of a worker, a deadline, or a new run; then handle it."""
        pipes: dict[object, _Worker] = {worker.pipe: worker for worker in self._workers}
        exits: dict[object, _Worker] = {worker.exit: worker for worker in self._workers if worker.exit >= 0}
        remaining = min((worker.deadline for worker in self._workers), default=math.inf) - time.monotonic()
        timeout = min(max(remaining, 0.0), LONGEST_WAIT_S if exits or not pipes else POLL_S)
        readable = wait([*pipes, *exits, self._woken], timeout)  # type: ignore[list-item]
        if self._woken in readable:
            while self._woken.poll():
                self._woken.recv_bytes()
        for worker in list(self._workers):
            if worker.pipe in readable:
                self._receive(worker)
            elif worker.exit in readable or (worker.exit < 0 and not worker.process.is_alive()):
                self._report_death(worker)  # its pipe is still held by a process that it has started
            elif time.monotonic() >= worker.deadline:
                limit = worker.runs[0].spec.method.run_timeout_s if worker.runs else None
                text = f"stopped after run_timeout_s = {limit:g} s"
                self._fail_worker(worker, Status.TIMEOUT, text, limit or math.nan)

    def _receive(self, worker: _Worker) -> None:
        try:
            message = worker.pipe.recv()
        except Exception:  # the pipe was closed, or only part of a message was sent
            self._report_death(worker)
            return
        if not worker.ready:
            worker.ready, self._failed_starts = True, 0
            return
        try:
            record, replace = message
            expected = isinstance(record, RunRecord) and record.run_id == worker.runs[0].spec.run_id
        except Exception:
            expected = False
        if not expected:
            return  # from another process that holds the pipe: a run's record is accepted from its own run only
        future = worker.runs.popleft().future
        worker.sizes.popleft()
        worker.is_fast = time.monotonic() - worker.started < FAST_S
        worker.start_first()
        if replace:
            self._remove(worker)
        future.set_result(record)

    def _report_death(self, worker: _Worker) -> None:
        """The worker has died, or has closed its pipe and is killed: its run ends as crashed."""
        worker.process.join(CLOSING_S)
        output = last_output(str(self._folder.path), worker.process.pid)
        cause = f"its process died: {cause_of_end(worker.process.exitcode)}{f': {output}' if output else ''}"
        self._fail_worker(worker, Status.CRASHED, cause)

    def _fail_worker(self, worker: _Worker, status: Status, message: str, runtime_s: float = math.nan) -> None:
        """Remove a worker that is dead or must be killed; the run that it executes, if any, ends with this status."""
        failed = worker.runs.popleft() if worker.runs else None
        self._remove(worker)
        if not worker.ready:
            killed = worker.process.exitcode == -signal.SIGKILL  # by somebody else, who may do it again and again
            self._failed_starts += 0.1 if killed else 1
            self._last_output = message
        if failed:
            failed.future.set_result(RunRecord(failed.spec.run_id, status, message, runtime_s=runtime_s))

    def _remove(self, worker: _Worker) -> None:
        """Kill a worker; other workers take the runs that it has not started."""
        self._workers.remove(worker)
        self._queue.extendleft(reversed(worker.runs))
        worker.runs.clear()
        _kill(worker)

    def _end_workers(self) -> None:
        if not self._killing:
            for worker in self._workers:
                worker.pipe.close()  # an idle worker ends when its pipe is closed
            deadline = time.monotonic() + CLOSING_S
            for worker in self._workers:
                worker.process.join(max(deadline - time.monotonic(), 0.0))
        for worker in self._workers:
            _kill(worker)


def _kill(worker: _Worker) -> None:
    """Kill the process with every process that it has started, and close its descriptors."""
    pid = worker.process.pid
    if worker.ready and pid is not None:  # it leads its own group since it reported that it is ready
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
    worker.process.kill()
    worker.process.join()
    worker.pipe.close()
    if worker.exit >= 0:
        os.close(worker.exit)


def _exit_descriptor(process: BaseProcess) -> int:
    """A descriptor that becomes readable when the process ends; -1 where the system has none."""
    if not hasattr(os, "pidfd_open") or process.pid is None:
        return -1
    try:
        return os.pidfd_open(process.pid)
    except OSError:
        return -1
