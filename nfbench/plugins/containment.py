"""What a plugin must leave as it was in its process, so that others in the same process are not affected."""

from __future__ import annotations

import builtins
import contextlib
import fcntl
import gc
import json
import logging
import math
import os
import random
import resource
import signal
import sys
import tempfile
import threading
import time
import tracemalloc
import warnings
from collections.abc import Iterable
from types import ModuleType
from typing import Any, final

import numpy as np

__all__ = ["Containment", "moved_up"]

HIGH_DESCRIPTOR = 200  # our own descriptors are above it, where a run that closes the usual ones does not reach them
LEAKED = 64  # descriptors that runs may leave open before the process is replaced
_ALL_LIMITS = [getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")]
_LIMITS = [resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE]  # the usual ones
_SHARED: tuple[ModuleType, ...] = (  # modules whose attributes other plugins rely on
    *(builtins, json, math, os, random, sys, tempfile, threading, time),
    *(np, np.random, np.linalg),
)
_CHANGING = {"_", "last_exc", "last_type", "last_value", "last_traceback", "stdout", "stderr"}


@final
class Containment:
    """Remembers the state of the process, and says what has changed; cheap enough to be asked after every run.

    own: descriptors, in addition to the standard streams, that a run must leave open.
    """

    def __init__(self, own: Iterable[int]) -> None:
        self._descriptors = {descriptor: _identity(descriptor) for descriptor in (0, 1, 2, *own)}
        self._lowest = _lowest_free_descriptor()
        self._directory = _working_directory()
        self._limits, self._all_limits = _limits(_LIMITS), _limits(_ALL_LIMITS)
        self._signals = _signals()
        self._errors = np.geterr()
        self._streams = (sys.stdout, sys.stderr)
        self._interpreter = _interpreter()
        self._variables = list(os.environ)
        self._imported = len(sys.modules)
        self._threads = _threads()
        self._children = _children()
        tempfile.gettempdir()  # sets an attribute at its first call
        self._modules = [(vars(module), dict(vars(module))) for module in _SHARED]

    def changed(self, thorough: bool = True) -> str | None:
        """One thing that is not as it was, in words; None if there is nothing.

        thorough: also compare the attributes of shared modules, which takes several times as long as all else.
        """
        if any(_identity(descriptor) != known for descriptor, known in self._descriptors.items()):
            return "a standard stream"
        if _lowest_free_descriptor() > self._lowest + LEAKED:
            return "the number of open files"
        if _working_directory() != self._directory:
            return "the working directory"
        if _limits(_LIMITS) != self._limits:
            return "a resource limit"
        if _signals() != self._signals:
            return "a signal handler, mask or timer"
        if (sys.stdout, sys.stderr) != self._streams or any(stream and stream.closed for stream in self._streams):
            return "sys.stdout or sys.stderr"
        if _interpreter() != self._interpreter or len(sys.modules) < self._imported:
            return "a setting of the interpreter"
        if _children() - self._children:
            return "a child process that is left"
        if _threads() > self._threads:
            return "a thread that is left"
        if not thorough:
            return None
        if _limits(_ALL_LIMITS) != self._all_limits:
            return "a resource limit"
        if np.geterr() != self._errors:
            return "NumPy's error handling"
        if any(name not in os.environ for name in self._variables):
            return "environment variables"
        return next((f"module {now['__name__']}" for now, known in self._modules if _replaced(now, known)), None)


def _replaced(now: dict[str, Any], known: dict[str, Any]) -> bool:
    """Whether an attribute of a module is another object than before; new ones, as of a late import, are fine."""
    try:
        if now == known:  # in C: the same objects are not compared
            return False
    except Exception:  # of an object that is there instead
        return True
    if any(now.get(name) is not value for name, value in known.items() if name not in _CHANGING):
        return True
    known.clear()
    known.update(now)
    return False


def moved_up(descriptor: int) -> int:
    """A duplicate of a descriptor at HIGH_DESCRIPTOR or above; the original is closed."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        high = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, min(HIGH_DESCRIPTOR, soft // 2))
    except OSError:  # no descriptor is free there
        return descriptor
    os.close(descriptor)
    return high


def _identity(descriptor: int) -> tuple[int, int] | None:
    try:
        status = os.fstat(descriptor)
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _lowest_free_descriptor() -> int:
    """The number that the next open file gets, which rises with the number of open files; 0 if there is none left."""
    try:
        descriptor = os.dup(0)
    except OSError:
        return 0
    os.close(descriptor)
    return descriptor


def _limits(limits: list[int]) -> list[tuple[int, int]]:
    return [resource.getrlimit(limit) for limit in limits]


def _signals() -> tuple[object, ...]:
    handlers = (signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM))
    timer = signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
    return (*handlers, timer, signal.pthread_sigmask(signal.SIG_BLOCK, ()))


def _interpreter() -> tuple[object, ...]:
    """Settings that change how all code runs: recursion, tracing, warnings as errors, garbage, logging."""
    errors = sum(entry[0] == "error" for entry in warnings.filters)
    hooks = sys.gettrace(), sys.getprofile(), gc.isenabled(), tracemalloc.is_tracing()
    return (sys.getrecursionlimit(), errors, *hooks, logging.root.manager.disable)


def _working_directory() -> str | None:
    try:
        return os.getcwd()  # noqa: PTH109  # to compare, not to use
    except OSError:  # it was removed
        return None


def _children() -> set[bytes]:
    """The process ids of the children of the main thread; none where the kernel does not list them."""
    with contextlib.suppress(OSError):
        pid = os.getpid()
        file = os.open(f"/proc/{pid}/task/{pid}/children", os.O_RDONLY | os.O_CLOEXEC)
        try:
            return set(os.read(file, 2**16).split())
        finally:
            os.close(file)
    return set()


def _threads() -> int:
    """The threads that keep a process from ending."""
    return sum(not thread.daemon for thread in threading.enumerate())
