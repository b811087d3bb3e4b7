"""A results folder: made or moved aside, written by one process at a time, its files whole or not at all."""

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
    """Have the folder exist; with ``fresh``, an old one is moved aside first. Raises StoreError."""
    try:
        if fresh and folder.exists():
            locked(folder).release()  # nobody is writing there
            folder.rename(folder.with_name(f"{folder.name}.{datetime.now():%Y%m%d-%H%M%S}"))
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: {error.strerror or error}") from error


def locked(folder: Path) -> FileLock:
    """The folder's lock, acquired, for the one who writes there. Raises StoreError where somebody else has it."""
    lock = FileLock(folder / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise StoreError(
            f"{folder}: another nfbench is writing here; wait for it, or choose another folder with --out"
        ) from None
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror or error}") from error
    return lock


def write_whole(path: Path, make: Callable[[Path], object], kept: str = "runs.sqlite") -> None:
    """Write a file whole or not at all, also where power fails.

    Raises StoreError, and the old file stays, where that fails; it names what keeps the finished rows.
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
    """A new folder to fill, which becomes ``path`` at the end, and vanishes on any exception.

    Raises StoreError where it cannot be written, or something is there already.
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
