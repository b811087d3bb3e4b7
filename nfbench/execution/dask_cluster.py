"""The cluster engine: runs specs on the workers of a dask.distributed scheduler, each behind the same wall as here."""

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
    raise NfbenchError("running on a cluster needs dask.distributed: pip install 'nfbench[dask]'") from None

__all__ = ["run_on_cluster"]

AHEAD = 4  # tasks in flight for each slot (thread of a worker): its memory and ours stay flat however long the study
LARGEST = 32  # runs in a task, which otherwise costs more than a short run
SLICE = 0.2  # seconds after which a task begins no further run and hands back what is left of it
PATIENCE = 0.05  # seconds in which finished tasks are gathered into one batch
LOOK = 1.0  # seconds between looks at how many workers there are
CONNECT = 10.0  # seconds in which the scheduler must answer
DYING = 1.0  # seconds in which a worker learns that not just its run was killed, but itself
SILENT = logging.CRITICAL + 1

VERSION = version("nfbench")


def run_on_cluster(
    specs: Iterable[RunSpec], plugins: Iterable[str | Path], address: str, stop: Callable[[], bool]
) -> Batches:
    """Run specs on a cluster and yield finished ones in batches, in any order, each with its record.

    address: of a dask.distributed scheduler, e.g. ``tcp://host:8786``, or ``local:N`` for N workers of our own on
    this machine. Plugin files are sent along. Once ``stop()`` is true, runs that have started are finished and no
    other is. Raises NfbenchError where the cluster cannot be used, or is lost on the way.
    """
    feed = iter(specs)
    first = next(feed, None)
    if first is None:
        return  # a finished study needs no cluster
    crew = Crew([(Path(file).name, Path(file).read_bytes()) for file in plugins], _local_workers(address) > 0)
    with _connected(address) as client:
        with _in_our_words(address):
            _refuse_other_versions(client)
        yield from _Session(client, crew, itertools.chain([first], feed), address, stop).run()


class _Session:
    """One study on one cluster, seen from this side."""

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
        self._again: deque[list[RunSpec]] = deque()  # handed back by a task: each goes out on its own
        self._size = 1  # runs in the next task
        self._waiting: dict[distributed.Future[Any], list[RunSpec]] = {}
        self._done: queue.SimpleQueue[tuple[distributed.Future[Any], Any]] = queue.SimpleQueue()
        self._suspects: set[str] = set()  # runs that were held by too many lost workers
        self._error: NfbenchError | None = None  # to be raised once the rows that are here are out
        self._slots = -1
        self._stopping = False
        self._looked = -math.inf

    def run(self) -> Batches:
        """The batches. When this ends, however it does, the cluster is as it was before."""
        try:
            with _in_our_words(self._address):
                self._client.register_plugin(self._crew, name=self._name)
            while True:
                with _in_our_words(self._address):
                    self._look_around()
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
                with contextlib.suppress(Exception):  # a scheduler that goes away now has nothing left to tidy up
                    self._client.cancel(list(self._waiting))
                    self._client.unregister_worker_plugin(self._name)

    def _look_around(self) -> None:
        """Every now and then: how many workers there are, and whether they know that it is time to stop."""
        stopping = self._stop()
        if stopping == self._stopping and time.monotonic() < self._looked + LOOK:
            return
        slots = sum(self._client.nthreads().values())
        if not slots and self._slots:
            logging.getLogger("nfbench").warning("no workers at %s; waiting for them", self._address)
        self._slots, self._stopping, self._looked = slots, stopping, time.monotonic()
        if not stopping:
            return
        self._again.clear()
        if slots:  # each time, as workers may have come since the last
            self._client.run(_halt, self._name, on_error="ignore")
        else:
            self._client.cancel(list(self._waiting))
            self._waiting.clear()

    def _fill(self) -> None:
        """Send out tasks, some ahead of what the workers can do now; a few also while there is no worker yet."""
        while len(self._waiting) < AHEAD * max(self._slots, 1):
            specs = self._again.popleft() if self._again else list(itertools.islice(self._specs, self._size))
            if not specs:
                return
            # pickled here, so that the scheduler, which opens what it is sent, has only bytes to pass on
            future = self._client.submit(_work, self._name, pickle.dumps(specs), pure=False)
            self._waiting[future] = specs
            cast(Any, self._client.loop).add_callback(self._collect, future)

    async def _collect(self, future: distributed.Future[Any]) -> None:
        """On dask's own thread: fetch the outcome once there is one, be it lost and made again meanwhile."""
        try:
            outcome = await future
        except (Exception, asyncio.CancelledError) as error:
            outcome = error
        self._done.put((future, outcome))

    def _finished(self) -> list[tuple[RunSpec, RunRecord]]:
        """What is finished now, or within a moment."""
        batch = []
        with contextlib.suppress(queue.Empty):
            outcomes = [self._done.get(timeout=PATIENCE)]
            while not self._done.empty():
                outcomes.append(self._done.get_nowait())
            for future, outcome in outcomes:
                if future in self._waiting:
                    batch += self._rows(self._waiting.pop(future), outcome)
        if self._client.status != "running":
            self._error = self._error or _lost(self._address, "it is gone")
        return batch

    def _rows(self, specs: list[RunSpec], outcome: Any) -> list[tuple[RunSpec, RunRecord]]:
        """The rows of one task; the runs it did not come to are sent again, unless we stop."""
        if isinstance(outcome, distributed.KilledWorker):
            if len(specs) == 1 and specs[0].run_id in self._suspects:
                words = (
                    f"the cluster lost {2 * (outcome.allowed_failures + 1)} workers that held this run, the last of "
                    f"them {outcome.last_worker.address}; their logs may tell why"
                )
                return [(specs[0], RunRecord(specs[0].run_id, Status.CRASHED, words))]
            # dask blames also what merely waited on a lost worker: each gets a second time, alone
            self._suspects.update(spec.run_id for spec in specs)
            outcome = []
        elif isinstance(outcome, CancelledError | asyncio.CancelledError):
            self._error, outcome = _lost(self._address, "it dropped the runs it was given"), []
        elif isinstance(outcome, NfbenchError):
            self._error, outcome = outcome, []
        elif isinstance(outcome, OSError):  # also dask's CommClosedError: the connection broke while a result came
            self._error, outcome = _lost(self._address, explain(outcome)), []
        elif isinstance(outcome, BaseException):
            words = f"the cluster at {self._address} cannot take runs: {explain(outcome)}; finished rows are kept"
            self._error, outcome = NfbenchError(words), []
        records = cast(list[RunRecord], outcome)
        if len(records) == len(specs):
            self._size = min(max(self._size, 2 * len(specs)), LARGEST)
        elif not self._stopping:
            self._size = max(len(records), 1)
            self._again.extend([spec] for spec in specs[len(records) :])
        return list(zip(specs, records, strict=False))


class Crew(distributed.WorkerPlugin):
    """What a dask worker holds for one study: its plugin files, and processes of its own that may hang and die.

    files: name and content of each plugin file. ours: whether the worker is one that we started.
    """

    def __init__(self, files: list[tuple[str, bytes]], ours: bool) -> None:
        self.version = VERSION
        self._files = files
        self._ours = ours

    def setup(self, worker: distributed.Worker) -> None:
        """Called by dask on each worker, before it takes runs."""
        # A nanny starts its worker as a daemon, to which multiprocessing forbids children for fear that they outlive
        # it. Ours end with their pool, and are killed by the kernel when their parent is.
        multiprocessing.current_process().daemon = False
        if self._ours:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the parent
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
        """Begin no further run."""
        self._halted.set()

    def run(self, specs: list[RunSpec]) -> list[RunRecord]:
        """The records of the first of these: those that are begun before the time slice is over."""
        records: list[RunRecord] = []
        end = time.monotonic() + SLICE
        for spec in specs:
            if self._halted.is_set() or (records and time.monotonic() > end):
                break
            records.append(self._record(spec))
        return records

    def _record(self, spec: RunSpec) -> RunRecord:
        with self._lock:
            self._go_on()
            self._pool = self._pool or ProcessPool(self._unpacked(), self._jobs)
            future = self._pool.submit(spec)
        while not wait([future], timeout=0.1).done:
            self._go_on()  # a pool that is killed leaves the runs it has without an end
        record = future.result()
        if record.status == Status.CRASHED and re.search(r"\((SIGTERM|SIGKILL)\)", record.message):
            self._closed.wait(DYING)  # who ends a job ends all of its processes: then the run is not to blame
        self._go_on()
        return record

    def _go_on(self) -> None:
        if self._closed.is_set():
            raise distributed.Reschedule

    def _unpacked(self) -> list[Path]:
        """The plugin files, each in a folder of its own, as two may have one name."""
        self._folder = tempfile.TemporaryDirectory(prefix="nfbench-", dir=self._within, ignore_cleanup_errors=True)
        paths = [Path(self._folder.name) / str(number) / name for number, (name, _) in enumerate(self._files)]
        for path, (_, content) in zip(paths, self._files, strict=True):
            path.parent.mkdir()
            path.write_bytes(content)
        return paths


def _work(name: str, specs: bytes) -> list[RunRecord]:
    """A task: what a dask worker does."""
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
        where, why = f"worker {worker.address} on {socket.gethostname()}", explain(error)
        if isinstance(error, NfbenchError):
            why = str(error)
        raise NfbenchError(f"{where} cannot take runs: {why}; finished rows are kept") from error


def _halt(name: str, dask_worker: distributed.Worker) -> None:
    if name in dask_worker.plugins:
        cast(Crew, dask_worker.plugins[name]).halt()


@contextlib.contextmanager
def _connected(address: str) -> Iterator[distributed.Client]:
    """A client of the scheduler there, or of a cluster of our own, which is closed at the end; both in silence."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(silence_logging_cmgr(SILENT))
        if workers := _local_workers(address):
            address = stack.enter_context(_our_cluster(workers)).scheduler_address
        try:
            client = distributed.Client(address, timeout=CONNECT, set_as_default=False, name="nfbench")
        except (OSError, ValueError, ImportError) as error:
            raise NfbenchError(
                f"no dask scheduler answers at {address!r} within {CONNECT:g} s ({explain(error)}); expected an "
                f"address such as tcp://host:8786, as `dask scheduler` prints it, or local:N"
            ) from None
        yield stack.enter_context(client)


def _our_cluster(workers: int) -> distributed.LocalCluster:
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # health checks, without which there is no scheduler
        memory_limit=0,  # a run's memory is its own process's, which run_memory_mb limits
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
    """Raise NfbenchError unless the scheduler and the workers of now have our version; later ones tell in _work."""
    found = client.run(version, "nfbench", on_error="return")
    try:
        scheduler = client.run_on_scheduler(version, "nfbench")
    except Exception as error:  # of another package, or not allowed to ask
        scheduler = error
    for where, theirs in [
        ("the scheduler", scheduler),
        *((f"worker {name}", theirs) for name, theirs in found.items()),
    ]:
        if isinstance(theirs, ImportError):
            raise NfbenchError(f"nfbench is not installed where {where} runs; it needs version {VERSION}, as here")
        if isinstance(theirs, str) and theirs != VERSION:
            raise NfbenchError(_mismatch(where, theirs, VERSION))


def _mismatch(where: str, theirs: str, ours: str) -> str:
    return f"{where} has nfbench {theirs}, the study was started with {ours}; install the same version everywhere"


@contextlib.contextmanager
def _in_our_words(address: str) -> Iterator[None]:
    """The loss of the scheduler, in whichever way dask tells it."""
    try:
        yield
    except (OSError, RuntimeError, CancelledError) as error:
        raise _lost(address, explain(error)) from error


def _lost(address: str, why: str) -> NfbenchError:
    return NfbenchError(
        f"lost the dask scheduler at {address}: {why}; finished rows are kept, and the same command goes on from there"
    )
