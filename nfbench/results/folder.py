"""Creates, locks and moves aside results folders, and writes their files whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from nfbench.core import StoreError

__all__ = ["locked", "prepare", "whole_folder", "write_whole"]


def prepare(folder: Path, fresh: bool) -> None:
    """Create the folder; with ``fresh``, first move an existing one aside. Raises StoreError if that fails."""
    try:
        if fresh and folder.exists():
            locked(folder).release()  # raises StoreError if another process is writing there
            folder.rename(folder.with_name(f"{folder.name}.{datetime.now():%Y%m%d-%H%M%S}"))
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: {error.strerror or error}") from error


def locked(folder: Path) -> FileLock:
    """Acquire the folder's write lock and return it. Raises StoreError if another process holds the lock."""
    lock = FileLock(folder / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise StoreError(
            f"{folder}: another nfbench process is writing to this folder; wait until it ends, or choose another "
            f"folder with --out"
        ) from None
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror or error}") from error
    return lock


def write_whole(path: Path, make: Callable[[Path], object], kept: str = "runs.sqlite") -> None:
    """Write a file whole or not at all, even if the power fails.

    make: function that writes the file at the path it receives. kept: name of the file that keeps the finished rows,
    for the error message. Raises StoreError if writing fails; the old file is then unchanged.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        make(draft)
        with draft.open("r+b") as file:
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror or error}; finished rows are kept in {kept}") from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink()


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder. It is renamed to ``path`` at the end, or removed on any exception.

    Raises StoreError if the folder cannot be written, or if ``path`` is already in use.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.mkdir(parents=True)
        yield draft
        draft.rename(path)
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
