"""The code of a worker process, which executes one run after another, isolated from the parent process."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import signal
import sys
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

from threadpoolctl import threadpool_limits

from nfbench.plugins import Registry
from nfbench.study import RunRecord, RunSpec

from .environment import THREAD_VARIABLES
from .run_one import execute

__all__ = ["last_output", "serve"]

_registry: Registry | None = None

TAIL = 400  # characters kept of a dead worker's output


def serve(pipe: Connection, plugins: tuple[str | Path, ...], folder: str, growth_mb: float) -> None:
    """Report that the worker is ready, then receive specs and send back their records until the pipe is closed.

    Each record comes with a flag that says whether the worker must be replaced: its memory has grown by more than
    ``growth_mb`` [MiB] since its first run. Otherwise, a library that never frees its memory would fill the machine
    in a long study.
    """
    start(plugins, folder)
    pipe.send(None)
    before = None
    while True:
        try:
            spec = pipe.recv()
        except EOFError:
            return
        record = work(spec)
        before = _resident_mb() if before is None else before
        pipe.send((record, _resident_mb() - before > growth_mb))


def start(plugins: tuple[str | Path, ...], folder: str) -> None:
    """Set up the process: ignore Ctrl-C, send output to a file in ``folder``, use one thread, import plugins."""
    global _registry
    _die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the default ends the process at once, even in native code
    output = os.open(_output(folder, os.getpid()), os.O_CREAT | os.O_RDWR | os.O_APPEND | os.O_TRUNC, 0o600)
    for stream in (1, 2):
        os.dup2(output, stream)
    sys.stdout = os.fdopen(1, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)
    faulthandler.enable(2)
    for name in THREAD_VARIABLES:  # for libraries loaded from now on; threadpool_limits covers the loaded ones
        os.environ[name] = "1"
    _registry = Registry(plugins)
    threadpool_limits(1)  # one BLAS thread, so that sums are bit-for-bit the same on any number of workers


def work(spec: RunSpec) -> RunRecord:
    """Execute one run. The output file is emptied first, so that it holds the output of one run only."""
    assert _registry is not None
    os.ftruncate(1, 0)
    with _memory_limit(spec.method.run_memory_mb):
        return execute(spec, _registry)


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
    return " | ".join(shown)[-TAIL:] if "Fatal Python error" not in text else " | ".join(shown)[:TAIL]


def _die_with_parent() -> None:
    """On Linux, have the kernel kill this process when its parent process ends for any reason."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


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
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + megabytes * 2**20, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
