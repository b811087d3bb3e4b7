"""The code of a worker process, which executes one run after another, isolated from the parent process."""

from __future__ import annotations

import contextlib
import contextvars
import faulthandler
import os
import resource
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType

from threadpoolctl import threadpool_limits

from nfbench.core import Status, die_with_parent, printable
from nfbench.plugins import Containment, Registry, moved_up
from nfbench.study import RunRecord, RunSpec

from .environment import THREAD_VARIABLES
from .run_one import execute

__all__ = ["BLOCKED_AT_START", "last_output", "serve"]

BLOCKED_AT_START = (signal.SIGINT, signal.SIGTERM)  # until the worker has its own handlers
THOROUGH_EVERY = 32  # runs of a method after which shared modules are compared again, from the first run on
LARGEST_ADDRESS = 2**62  # more than any process has [bytes]
TAIL = 400  # characters kept of a dead worker's output


def serve(pipe: Connection, plugins: tuple[str | Path, ...], folder: str, growth_mb: float) -> None:
    """Report that the worker is ready, then receive specs and send back their records until the pipe is closed.

    Each record comes with a flag that says whether the worker must be replaced, because the next run might be affected:
    the run did not end well, it changed something in the process (see ``containment``), or the memory has grown by more
    than ``growth_mb`` [MiB] since the first run, as with a library that never frees it.
    """
    pipe = Connection(moved_up(os.dup(pipe.fileno())))
    worker = _Worker(plugins, folder, pipe.fileno())
    pipe.send(None)
    before = None
    while True:
        try:
            spec = pipe.recv()
        except EOFError:
            return
        record, replace = worker.execute(spec)
        if os.getpid() != worker.pid:  # a copy of the worker that the run has forked
            os._exit(0)
        before = _resident_mb() if before is None else before
        replace = replace or (_peak_mb() - before > growth_mb and _resident_mb() - before > growth_mb)
        pipe.send((record, replace))
        while replace:  # runs that wait in the pipe are for another worker
            signal.pause()


class _Worker:
    """The state of the process: its plugins, where its output goes, and what a run must not change."""

    def __init__(self, plugins: tuple[str | Path, ...], folder: str, pipe: int) -> None:
        self.pid = os.getpid()
        _separate_from_parent()
        output = os.open(_output(folder, self.pid), os.O_CREAT | os.O_RDWR | os.O_APPEND | os.O_TRUNC, 0o600)
        self._output = moved_up(output)
        for stream in (1, 2):
            os.dup2(self._output, stream)
        sys.stdout = os.fdopen(1, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)
        sys.stderr = os.fdopen(2, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)
        faulthandler.enable(self._output)
        for name in THREAD_VARIABLES:  # for libraries loaded from now on; threadpool_limits covers the loaded ones
            os.environ[name] = "1"
        self._registry = Registry(plugins)
        threadpool_limits(1)  # one BLAS thread, so that sums are bit-for-bit the same on any number of workers
        self._containment = Containment([pipe, self._output])
        self._runs: Counter[str] = Counter()  # by method

    def execute(self, spec: RunSpec) -> tuple[RunRecord, bool]:
        """Execute one run; say whether the process must be replaced after it.

        The output file is emptied first, so that it holds the output of one run only.
        """
        os.ftruncate(self._output, 0)
        with _memory_limit(spec.method.run_memory_mb):
            context = contextvars.copy_context()  # np.seterr in a run, for example, changes only this copy
            record = context.run(execute, spec, self._registry, interruptible=False)
        number = self._runs[spec.method.label]
        self._runs[spec.method.label] += 1
        ended_well = record.status in (Status.OK, Status.SKIPPED)
        return record, not ended_well or self._containment.changed(number % THOROUGH_EVERY == 0) is not None


def _separate_from_parent() -> None:
    """Make the process the leader of its own session, which is killed as a whole and not reached by Ctrl-C.

    SIGINT and SIGTERM have no effect here: the parent process decides whether a run is finished or killed. Processes
    that a run starts are not affected by that, so that a library can end its own.
    """
    if parent := parent_process():
        assert parent.pid is not None
        die_with_parent(parent.pid)
    with contextlib.suppress(OSError):
        os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _ignore)  # a handler, other than SIG_IGN, is not inherited by a program that is started
    os.register_at_fork(after_in_child=_restore_signals)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, BLOCKED_AT_START)


def _ignore(number: int, frame: FrameType | None) -> None:
    """Do nothing."""


def _restore_signals() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def last_output(folder: str, pid: int | None) -> str:
    """The last output of a dead worker, or the start of Python's fatal error, in one line. Removes its file."""
    path = _output(folder, pid or 0)
    try:
        text = path.read_bytes()[-20_000:].decode("utf-8", errors="replace")
    except OSError:
        return ""
    path.unlink(missing_ok=True)
    lines = [line.strip() for line in text.splitlines()]
    shown = [line for line in lines if line and not line.startswith(("Extension modules:", "Current thread", "Thread"))]
    joined = printable(" | ".join(shown), limit=10**6)
    return joined[-TAIL:] if "Fatal Python error" not in text else joined[:TAIL]


def _peak_mb() -> float:
    """The largest resident memory that this process ever had [MiB], which is found faster than that of now."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


def _resident_mb() -> float:
    """Resident memory of this process [MiB]; 0 if /proc is not available."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _output(folder: str, pid: int) -> Path:
    return Path(folder) / f"worker-{pid}.log"


@contextlib.contextmanager
def _memory_limit(megabytes: int | None) -> Iterator[None]:
    """Limit the address space that the process may add in this context [MiB]; further allocations fail."""
    if megabytes is None:
        yield
        return
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + megabytes * 2**20
    largest = LARGEST_ADDRESS if hard == resource.RLIM_INFINITY else hard
    resource.setrlimit(resource.RLIMIT_AS, (min(limit, largest), hard))
    try:
        yield
    finally:
        with contextlib.suppress(OSError, ValueError):  # the run has lowered the hard limit; the worker is replaced
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
