"""The child processes of this process, including those that their own parents have left."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from multiprocessing import resource_tracker
from pathlib import Path

__all__ = ["adopt_orphans", "children", "end_children"]

_PR_SET_CHILD_SUBREAPER = 36


def adopt_orphans() -> None:
    """Make this process, on Linux, the parent of every descendant whose own parent ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def children() -> dict[int, str]:
    """Return the children by number, each with its name; empty where /proc is not available.

    The resource tracker of multiprocessing, which Python ends itself, is left out.
    """
    tracker = getattr(getattr(resource_tracker, "_resource_tracker", None), "_pid", None)
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            head, _, rest = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")
            if int(rest.split()[1]) == os.getpid() and int(folder.name) != tracker:
                found[int(folder.name)] = head.partition("(")[2]
    return found


def end_children(numbers: dict[int, str]) -> None:
    """Kill children and wait for them."""
    for number in numbers:
        with contextlib.suppress(OSError):
            os.kill(number, signal.SIGKILL)
        with contextlib.suppress(OSError):
            os.waitpid(number, 0)
