"""Reads the arrays of numbers that files contain. Nothing in a file is executed or unpickled."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

import numpy as np
from numpy import ndarray

__all__ = ["MAX_BYTES", "content_hash", "read_array"]

MAX_BYTES = 2**32  # of a file, and of the array in it


def read_array(path: str, variable: str | None = None) -> ndarray:
    """Return the array of numbers in a file, read-only.

    path: path of the file; its suffix decides how it is read.
    variable: name of the array in a file that can hold several; None: the only one.
    Raises ValueError if there is no such array, or if it does not consist of finite numbers.
    """
    return _read(path, variable, *_stamp(path))


def content_hash(path: str) -> str:
    """Return the SHA-256 hash of a file's contents, in hexadecimal."""
    return _hash(path, *_stamp(path))


def _stamp(path: str) -> tuple[int, int]:
    try:
        found = Path(path).stat()
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}: {path}") from error
    if found.st_size > MAX_BYTES:
        raise ValueError(f"expected a file of at most {MAX_BYTES:,} bytes, got {found.st_size:,}: {path}")
    return found.st_mtime_ns, found.st_size


@functools.lru_cache(maxsize=64)
def _hash(path: str, modified_ns: int, size: int) -> str:
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@functools.lru_cache(maxsize=4)
def _read(path: str, variable: str | None, modified_ns: int, size: int) -> ndarray:
    X = np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    X.flags.writeable = False
    return X
