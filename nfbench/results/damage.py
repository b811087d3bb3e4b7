"""Damaged results: the error that names the file and what to do, and the place where every reading error becomes it."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from nfbench.core import NfbenchError, StoreError, printable

__all__ = ["Damaged", "guarded", "is_locked", "patiently", "remedy"]

TOLD_AFTER_S = 1.0  # how long a locked file is waited for in silence [s]
SHOWN = 300  # characters of a reason

log = logging.getLogger("nfbench.results")  # prints warnings to standard error unless the caller configures logging


class Damaged(StoreError):
    """A file of a results folder cannot be read, or holds values that no run can have."""


def remedy(folder: Path) -> str:
    """What a user can do about a damaged results folder, as the end of a sentence."""
    return (
        f"`nfbench merge {folder} --out NEW` keeps every run that can be read, and `nfbench run STUDY.toml --out NEW` "
        f"then repeats the others; `nfbench run STUDY.toml --fresh` moves the folder aside and starts over"
    )


@contextlib.contextmanager
def guarded(path: Path) -> Iterator[None]:
    """Turn any exception while reading the file into an error of nfbench that names the file and the remedy.

    The content of the file is foreign data, and every exception that it causes means that it is damaged, whichever
    library finds out: SQLite, JSON, zlib, NumPy, or our own checks.
    """
    try:
        yield
    except NfbenchError:
        raise
    except Exception as error:
        raise Damaged(f"{path} {_what(error)}; {remedy(path.parent)}") from error


def _what(error: Exception) -> str:
    reason = f"{type(error).__name__}: {error}"
    if isinstance(error, sqlite3.Error | ValueError):  # whose messages need no type before them
        reason = str(error)
    elif isinstance(error, OSError):
        reason = error.strerror or str(error)
    refused = isinstance(error, OSError) or getattr(error, "sqlite_errorcode", 0) & 0xFF in _REFUSED
    return f"{'cannot be read' if refused else 'is damaged'} ({printable(reason, SHOWN)})"


_REFUSED = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR)


def is_locked(error: sqlite3.Error) -> bool:
    """Whether the error says that another program has locked the file."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


def patiently(db: sqlite3.Connection, path: Path, wait_s: float, sql: str, args: Sequence[Any] = ()) -> sqlite3.Cursor:
    """Execute SQL. If another program has locked the file, say so and wait for at most ``wait_s`` seconds.

    Raises StoreError when the wait is over. Ctrl-C works while waiting, if the connection's own timeout is short.
    """
    begun, told = time.monotonic(), False
    while True:
        try:
            return db.execute(sql, args)
        except sqlite3.OperationalError as error:
            if not is_locked(error):
                raise
            waited = time.monotonic() - begun
            if waited >= wait_s:
                raise StoreError(
                    f"{path} has been locked by another program for {waited:.0f} s; close that program, such as a "
                    f"database browser or a backup, and run the command again; rows written earlier are kept"
                ) from error
            if not told and waited >= TOLD_AFTER_S:
                told = True
                log.warning("nfbench: %s is locked by another program; waiting for at most %.0f s", path, wait_s)
            time.sleep(0.05)
