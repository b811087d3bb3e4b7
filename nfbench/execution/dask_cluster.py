"""The cluster engine: runs specs on the workers of a dask.distributed scheduler, isolated as in local workers."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import math
import multiprocessing
import pickle
import queue
import re
import signal
import socket
import tempfile
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, wait
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from nfbench.core import NfbenchError, Status, explain
from nfbench.study import RunRecord, RunSpec

from .engine import Batches
from .process_pool import ProcessPool

try:
    import distributed
    from distributed.utils import silence_logging_cmgr
except ImportError:
    raise NfbenchError("dask.distributed is needed but not installed: pip install 'nfbench[dask]'") from None

__all__ = ["run_on_cluster"]

AHEAD = 4  # tasks in flight per worker thread; a fixed number, so that a long study needs no more memory
LARGEST = 32  # maximum number of runs in a task; short runs share its overhead
SLICE = 0.2  # seconds after which a task starts no further run and hands back the rest
PATIENCE = 0.05  # seconds to wait for a finished task
LOOK = 1.0  # seconds between checks of the number of workers
CONNECT = 10.0  # seconds within which the scheduler must answer
DYING = 1.0  # seconds to wait, after a run was killed, for the news that the whole worker is being shut down
SILENT = logging.CRITICAL + 1

VERSION = version("nfbench")


def run_on_cluster(
    specs: Iterable[RunSpec], plugins: Iterable[str | Path], address: str, stop: Callable[[], bool]
) -> Batches:
    """Run specs on a cluster and yield batches of (spec, record) pairs as the runs finish, in any order.

    specs: the runs to execute.
    plugins: plugin files, which are sent to the workers.
    address: address of a dask.distributed scheduler, e.g. ``tcp://host:8786``, or ``local:N`` to start N workers on
    this machine.
    stop: once it returns True, runs that have started are finished and no other run is started.

    Raises NfbenchError if the cluster cannot be used, or is lost during the study.
    """
    feed = iter(specs)
    first = next(feed, None)
    if first is None:
        return  # a finished study needs no cluster
    crew = Crew([(Path(file).name, Path(file).read_bytes()) for file in plugins], _local_workers(address) > 0)
    with _connected(address) as client:
        with _dask_errors_translated(address):
            _refuse_other_versions(client)
        yield from _Session(client, crew, itertools.chain([first], feed), address, stop).run()


class _Session:
    """One study on one cluster, as the client sees it."""

    def __init__(
        self,
        client: distributed.Client,
        crew: Crew,
        specs: Iterator[RunSpec],
        address: str,
        stop: Callable[[], bool],
    ) -> None:
        self._client = client
        self._crew = crew
        self._name = f"nfbench-{uuid.uuid4().hex}"
        self._address = address
        self._stop = stop
        self._specs = itertools.takewhile(lambda _: not stop(), specs)
        self._again: deque[list[RunSpec]] = deque()  # handed back by a task, each sent again on its own
        self._size = 1  # runs in the next task
        self._waiting: dict[distributed.Future[Any], list[RunSpec]] = {}
        self._done: queue.SimpleQueue[tuple[distributed.Future[Any], Any]] = queue.SimpleQueue()
        self._suspects: set[str] = set()  # runs that dask gave up once, after losing several workers
        self._error: NfbenchError | None = None  # raised once all rows that have arrived are yielded
        self._slots = -1
        self._stopping = False
        self._looked = -math.inf

    def run(self) -> Batches:
        """Yield the batches. However this ends, the cluster is then in the same state as before."""
        try:
            with _dask_errors_translated(self._address):
                self._client.register_plugin(self._crew, name=self._name)
            while True:
                with _dask_errors_translated(self._address):
                    self._check_workers()
                    self._fill()
                    if not self._waiting:
                        return
                    batch = self._finished()
                if batch:
                    yield batch
                if self._error:
                    raise self._error
        finally:
            if self._client.status == "running":
                with contextlib.suppress(Exception):  # if the scheduler disappears now, there is nothing to clean up
                    self._client.cancel(list(self._waiting))
                    self._client.unregister_worker_plugin(self._name)

    def _check_workers(self) -> None:
        """Count the workers and pass on a request to stop: every LOOK seconds, and when the request comes."""
        stopping = self._stop()
        if stopping == self._stopping and time.monotonic() < self._looked + LOOK:
            return
        slots = sum(self._client.nthreads().values())
        if not slots and self._slots:
            logging.getLogger("nfbench").warning(
                "no workers are connected to the scheduler at %s; waiting for workers", self._address
            )
        self._slots, self._stopping, self._looked = slots, stopping, time.monotonic()
        if not stopping:
            return
        self._again.clear()
        if slots:  # at every check, because workers may have joined since the last
            self._client.run(_halt, self._name, on_error="ignore")
        else:
            self._client.cancel(list(self._waiting))
            self._waiting.clear()

    def _fill(self) -> None:
        """Submit more tasks than the workers can start now, and a few even while there is no worker yet."""
        while len(self._waiting) < AHEAD * max(self._slots, 1):
            specs = self._again.popleft() if self._again else list(itertools.islice(self._specs, self._size))
            if not specs:
                return
            # pickled here, because the scheduler unpickles arguments and should only pass on bytes
            future = self._client.submit(_work, self._name, pickle.dumps(specs), pure=False)
            self._waiting[future] = specs
            cast(Any, self._client.loop).add_callback(self._collect, future)

    async def _collect(self, future: distributed.Future[Any]) -> None:
        """Wait on dask's own thread for the outcome, even if it is lost and recomputed in between."""
        try:
            outcome = await future
        except (Exception, asyncio.CancelledError) as error:
            outcome = error
        self._done.put((future, outcome))

    def _finished(self) -> list[tuple[RunSpec, RunRecord]]:
        """The runs that are finished now or within PATIENCE seconds."""
        batch = []
        with contextlib.suppress(queue.Empty):
            outcomes = [self._done.get(timeout=PATIENCE)]
            while not self._done.empty():
                outcomes.append(self._done.get_nowait())
            for future, outcome in outcomes:
                if future in self._waiting:
                    batch += self._rows(self._waiting.pop(future), outcome)
        if self._client.status != "running":
            self._error = self._error or _lost_scheduler(self._address, "the connection is closed")
        return batch

    def _rows(self, specs: list[RunSpec], outcome: Any) -> list[tuple[RunSpec, RunRecord]]:
        """The records of one task. Runs that it did not start are sent again, unless the study is stopping."""
        if isinstance(outcome, distributed.KilledWorker):
            if len(specs) == 1 and specs[0].run_id in self._suspects:
                message = (
                    f"the cluster lost {2 * (outcome.allowed_failures + 1)} workers that held this run, the last of "
                    f"them {outcome.last_worker.address}; their logs may show the reason"
                )
                return [(specs[0], RunRecord(specs[0].run_id, Status.CRASHED, message))]
            # dask also blames runs that merely waited on a lost worker: each gets a second try, alone
            self._suspects.update(spec.run_id for spec in specs)
            outcome = []
        elif isinstance(outcome, CancelledError | asyncio.CancelledError):
            self._error, outcome = _lost_scheduler(self._address, "it cancelled the submitted runs"), []
        elif isinstance(outcome, NfbenchError):
            self._error, outcome = outcome, []
        elif isinstance(outcome, OSError):  # includes dask's CommClosedError: the connection broke during a transfer
            self._error, outcome = _lost_scheduler(self._address, explain(outcome)), []
        elif isinstance(outcome, BaseException):
            message = f"the cluster at {self._address} cannot execute runs: {explain(outcome)}; finished rows are kept"
            self._error, outcome = NfbenchError(message), []
        records = cast(list[RunRecord], outcome)
        if len(records) == len(specs):
            self._size = min(max(self._size, 2 * len(specs)), LARGEST)
        elif not self._stopping:
            self._size = max(len(records), 1)
            self._again.extend([spec] for spec in specs[len(records) :])
        return list(zip(specs, records, strict=False))


class Crew(distributed.WorkerPlugin):
    """What a dask worker holds for one study: the plugin files, and its own pool of processes that execute the runs.

    files: name and content of each plugin file.
    ours: whether the worker belongs to a cluster that nfbench started (``local:N``).
    """

    def __init__(self, files: list[tuple[str, bytes]], ours: bool) -> None:
        self.version = VERSION
        self._files = files
        self._ours = ours

    def setup(self, worker: distributed.Worker) -> None:
        """Called by dask on each worker, before it receives runs."""
        # A nanny starts its worker as a daemonic process, and multiprocessing forbids those to have children, which
        # might outlive them. Our children end with their pool, and the kernel kills them when their parent dies.
        multiprocessing.current_process().daemon = False
        if self._ours:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C in the terminal
        self._jobs = worker.state.nthreads
        self._within = worker.local_directory
        self._lock = threading.Lock()
        self._halted = threading.Event()
        self._closed = threading.Event()
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._pool: ProcessPool | None = None

    def teardown(self, worker: distributed.Worker) -> None:
        """Called by dask when the study or the worker ends."""
        with self._lock:
            self._closed.set()
            if self._pool:
                self._pool.__exit__(Exception)
            if self._folder:
                self._folder.cleanup()

    def halt(self) -> None:
        """Start no further run."""
        self._halted.set()

    def run(self, specs: list[RunSpec]) -> list[RunRecord]:
        """Execute these runs until the time slice is over, at least one unless halted; return their records."""
        records: list[RunRecord] = []
        end = time.monotonic() + SLICE
        for spec in specs:
            if self._halted.is_set() or (records and time.monotonic() > end):
                break
            records.append(self._record(spec))
        return records

    def _record(self, spec: RunSpec) -> RunRecord:
        with self._lock:
            self._raise_if_closed()
            self._pool = self._pool or ProcessPool(self._unpacked(), self._jobs)
            future = self._pool.submit(spec)
        while not wait([future], timeout=0.1).done:
            self._raise_if_closed()  # the futures of a killed pool never finish
        record = future.result()
        if record.status == Status.CRASHED and re.search(r"\((SIGTERM|SIGKILL)\)", record.message):
            self._closed.wait(DYING)  # ending a cluster job kills all of its processes: then the run is not at fault
        self._raise_if_closed()
        return record

    def _raise_if_closed(self) -> None:
        if self._closed.is_set():
            raise distributed.Reschedule

    def _unpacked(self) -> list[Path]:
        """Write the plugin files, each to its own folder because two may have the same name; return the paths."""
        self._folder = tempfile.TemporaryDirectory(prefix="nfbench-", dir=self._within, ignore_cleanup_errors=True)
        paths = [Path(self._folder.name) / str(number) / name for number, (name, _) in enumerate(self._files)]
        for path, (_, content) in zip(paths, self._files, strict=True):
            path.parent.mkdir()
            path.write_bytes(content)
        return paths


def _work(name: str, specs: bytes) -> list[RunRecord]:
    """The task that a dask worker executes: run these pickled specs."""
    worker = distributed.get_worker()
    crew = cast(Crew | None, worker.plugins.get(name))
    if crew is None:  # the worker is closing
        raise distributed.Reschedule
    if crew.version != VERSION:
        raise NfbenchError(_mismatch(f"worker {worker.address}", VERSION, crew.version))
    try:
        return crew.run(pickle.loads(specs))
    except distributed.Reschedule:
        raise
    except Exception as error:
        where, reason = f"worker {worker.address} on {socket.gethostname()}", explain(error)
        if isinstance(error, NfbenchError):
            reason = str(error)
        raise NfbenchError(f"{where} cannot execute runs: {reason}; finished rows are kept") from error


def _halt(name: str, dask_worker: distributed.Worker) -> None:
    if name in dask_worker.plugins:
        cast(Crew, dask_worker.plugins[name]).halt()


@contextlib.contextmanager
def _connected(address: str) -> Iterator[distributed.Client]:
    """A client of the scheduler, or of a new local cluster that is closed at the end. Both log nothing."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(silence_logging_cmgr(SILENT))
        if workers := _local_workers(address):
            address = stack.enter_context(_new_cluster(workers)).scheduler_address
        try:
            client = distributed.Client(address, timeout=CONNECT, set_as_default=False, name="nfbench")
        except (OSError, ValueError, ImportError) as error:
            raise NfbenchError(
                f"no dask scheduler answered at {address!r} within {CONNECT:g} s ({explain(error)}); expected an "
                f"address such as tcp://host:8786, as `dask scheduler` prints it, or local:N"
            ) from None
        yield stack.enter_context(client)


def _new_cluster(workers: int) -> distributed.LocalCluster:
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # serves health checks; the scheduler needs it
        memory_limit=0,  # each run has its own process, whose memory run_memory_mb limits
        silence_logs=SILENT,
    )


def _local_workers(address: str) -> int:
    """N of ``local:N``; 0 for any other address."""
    scheme, _, number = address.partition(":")
    if scheme != "local":
        return 0
    if not (number.isdecimal() and int(number) > 0):
        raise NfbenchError(f"expected local:N with N >= 1 worker processes, e.g. local:4, got {address!r}")
    return int(number)


def _refuse_other_versions(client: distributed.Client) -> None:
    """Raise NfbenchError unless the scheduler and current workers have our version; ``_work`` checks later ones."""
    found = client.run(version, "nfbench", on_error="return")
    try:
        scheduler = client.run_on_scheduler(version, "nfbench")
    except Exception as error:  # e.g. nfbench is not installed there, or the scheduler refuses to run functions
        scheduler = error
    for where, theirs in [
        ("the scheduler", scheduler),
        *((f"worker {name}", theirs) for name, theirs in found.items()),
    ]:
        if isinstance(theirs, ImportError):
            raise NfbenchError(f"nfbench is not installed where {where} runs; install version {VERSION} there")
        if isinstance(theirs, str) and theirs != VERSION:
            raise NfbenchError(_mismatch(where, theirs, VERSION))


def _mismatch(where: str, theirs: str, ours: str) -> str:
    return f"{where} has nfbench {theirs}, but the study was started with {ours}; install the same version everywhere"


@contextlib.contextmanager
def _dask_errors_translated(address: str) -> Iterator[None]:
    """Turn every error by which dask reports the loss of the scheduler into an NfbenchError."""
    try:
        yield
    except (OSError, RuntimeError, CancelledError) as error:
        raise _lost_scheduler(address, explain(error)) from error


def _lost_scheduler(address: str, reason: str) -> NfbenchError:
    return NfbenchError(
        f"lost the dask scheduler at {address}: {reason}; finished rows are kept, run the same command to resume"
    )
