"""A temporary folder of a pool; what a killed process has left is removed by the next one."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from pathlib import Path
from typing import final

from filelock import FileLock, Timeout

__all__ = ["ScratchFolder"]

PREFIX = "nfbench-"
LOCK = ".in-use"


@final
class ScratchFolder:
    """A folder in the system's temporary folder that is locked as long as its process lives."""

    def __init__(self) -> None:
        _remove_abandoned(Path(tempfile.gettempdir()))
        self.path, self._lock = _locked_folder()

    def cleanup(self) -> None:
        """Remove the folder."""
        self._lock.release()
        shutil.rmtree(self.path, ignore_errors=True)


def _locked_folder() -> tuple[Path, FileLock]:
    """A new folder and its lock; another one if a process that cleans up has taken it before it was locked."""
    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX))
        lock = FileLock(path / LOCK, timeout=0)
        with contextlib.suppress(Timeout, FileNotFoundError):
            lock.acquire()
            if (path / LOCK).is_file():
                return path, lock
            lock.release()


def _remove_abandoned(parent: Path) -> None:
    """Remove folders whose lock nobody holds: the kernel releases it when a process ends, however it ends."""
    with contextlib.suppress(OSError):
        for folder in parent.glob(f"{PREFIX}*"):
            if not (folder / LOCK).is_file():
                continue  # not ours, or about to be locked
            lock = FileLock(folder / LOCK, timeout=0)
            with contextlib.suppress(Timeout, OSError), lock:
                shutil.rmtree(folder, ignore_errors=True)
