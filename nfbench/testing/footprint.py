"""What a solver changes in its process: the settings, files, threads and processes that would affect other runs."""

from __future__ import annotations

import builtins
import contextlib
import decimal
import gc
import importlib
import locale
import logging
import math
import multiprocessing
import os
import random
import resource
import signal
import socket
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nfbench.core import Budget, BudgetExhausted, MeteredProblem, Problem, Solver

from .probe import Probe
from .processes import adopt_orphans, children, end_children
from .subject import Broken, Subject

__all__ = ["footprint"]

RUNS = (  # (what the run is, shape of the problem, number of the evaluation that raises, its exception)
    ("a run", "bowl", None, None),
    ("a run with NaN values", "plateau", None, None),
    ("a run whose problem raises", "bowl", 21, Broken),
    ("an interrupted run", "bowl", 35, KeyboardInterrupt),
    ("a run", "bowl", None, None),
)
EVALUATIONS = 300
FORKS = ("os.fork", "os.forkpty")
RESTORE = "Restore it before minimize ends, in a `finally` block, because an exception ends every run."
RESTORE_IMPORT = "Restore it where the library is imported, because importing a solver must not affect the others."
Found = tuple[str, str, str]  # what was expected, what was found, and the remedy


def footprint(load: Callable[[], Solver]) -> Found | None:
    """Load and run a solver and return the first trace it leaves; None if there is none. Needs a process of its own."""
    forks: list[str] = []
    sys.addaudithook(lambda event, _: forks.append(event) if event in FORKS else None)
    adopt_orphans()
    before = _state()
    solver = load()
    solver.warm_up()
    if changed := _changed(before, _state(), "importing the solver and its libraries", RESTORE_IMPORT):
        return changed
    subject = Subject(solver)
    counts = None
    for what, shape, raise_at, error in RUNS:
        probe = subject.probe(shape=shape, stop=error, stop_at=raise_at or 0)  # the first one tries dimensions
        _run(solver, probe)
        found = _changed(before, _state(), what) or _evaluated_elsewhere(probe, forks) or _left_running()
        if found:
            return found
        if counts is None:
            counts = _counts()  # the first run may start the pool of threads of a library
    return _grown(counts or {}, _counts())


def _run(solver: Solver, probe: Probe) -> None:
    """Run the solver without capturing its output or its warnings, so that nothing but the solver restores them.

    Whether the solver itself fails is the subject of other checks.
    """
    with contextlib.suppress(BudgetExhausted, KeyboardInterrupt, Exception):
        solver.minimize(MeteredProblem(probe, Budget(evaluations=EVALUATIONS)), np.random.default_rng(1))


def _state() -> dict[str, Any]:
    """Return the settings of the process by what they are."""
    found: dict[str, Any] = {name: read() for name, read in _SETTINGS.items()}
    found["warnings.filters"] = _filters()
    for number in sorted(map(int, signal.valid_signals())):
        found[f"the handler of signal {number}"] = signal.getsignal(number)
    for name in (name for name in dir(resource) if name.startswith("RLIMIT_")):
        found[f"the resource limit {name}"] = resource.getrlimit(getattr(resource, name))
    for descriptor, stream in enumerate(("standard input", "standard output", "standard error")):
        found[f"descriptor {descriptor} ({stream})"] = _file(descriptor)
    for variable in sorted({*os.environ}):
        found[f"the environment variable {variable}"] = os.environ[variable]
    for owner in _OWNERS:
        for name, value in list(vars(owner).items()):
            if callable(value):
                found[f"{owner.__name__}.{name}"] = value
    return found


def _changed(before: dict[str, Any], after: dict[str, Any], what: str, remedy: str = RESTORE) -> Found | None:
    """Return the first setting that differs; a function that has been added to a module is not a difference."""
    for name in [*before, *(name for name in after if name.startswith("the environment variable "))]:
        old, new = before.get(name), after.get(name)
        if old is not new and old != new:
            old, new = _different_part(old, new)
            return f"{name} to be unchanged after {what}, {_show(old)}", _show(new), remedy
    return None


def _different_part(old: Any, new: Any) -> tuple[Any, Any]:
    """Return the items of two tables or lists that differ; two other objects as they are."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
        return {name: old.get(name) for name in names}, {name: new.get(name) for name in names}
    if isinstance(old, list) and isinstance(new, list) and {*map(repr, old)} != {*map(repr, new)}:
        return [item for item in old if item not in new], [item for item in new if item not in old]
    return old, new


def _show(value: Any) -> str:
    return "nothing" if value in (None, [], {}) else repr(value)[:200]


def _evaluated_elsewhere(probe: Probe, forks: list[str]) -> Found | None:
    if probe.threads - {threading.get_ident()}:
        return (
            "every evaluation to come from the thread that called minimize",
            f"evaluations from {len(probe.threads)} threads",
            "Evaluate in one thread: a study runs one run per processor core, and the order in which threads evaluate "
            "changes from run to run. Switch off the library's workers or parallel evaluation.",
        )
    if forks:
        return (
            "a solver that does not fork",
            f"{len(forks)} call(s) of {forks[0]}",
            "Do not use multiprocessing or os.fork: evaluations in another process are not counted, and a copy of the "
            "process may write to the results. To run an external program, use subprocess.",
        )
    return None


def _left_running() -> Found | None:
    """Return what still runs or remains after a run."""
    threads = [thread.name for thread in threading.enumerate() if thread is not threading.current_thread()]
    if threads:
        remedy = "Join the thread, or shut down the pool, in a `finally` block."
        return "no thread to be left running after a run", ", ".join(threads), remedy
    if running := children():
        end_children(running)
        remedy = "End the process and wait for it in a `finally` block."
        return "no child process to be left after a run", ", ".join(running.values()), remedy
    if files := sorted(path.name for path in Path.cwd().iterdir()):
        remedy = "Switch off the library's log and output files; remove temporary files in a `finally` block."
        return "no file to be left in the working directory or TMPDIR after a run", ", ".join(files[:5]), remedy
    return None


def _counts() -> dict[str, int]:
    """Return the numbers that must not grow with the number of runs, where the system knows them."""
    gc.collect()
    folders = {"open file descriptors": "/proc/self/fd", "threads of native code": "/proc/self/task"}
    return {name: len(list(Path(path).iterdir())) for name, path in folders.items() if Path(path).is_dir()}


def _grown(before: dict[str, int], after: dict[str, int]) -> Found | None:
    for name, count in before.items():
        if after[name] > count:
            remedy = "Close or join in a `finally` block what a run opens or starts; a long study would run out of it."
            return f"the number of {name} not to grow with every run, {count}", str(after[name]), remedy
    return None


def _filters() -> list[str]:
    """Return the filters for all warnings of a built-in category; libraries add filters of their own when imported."""
    return [
        repr(entry)
        for entry in warnings.filters
        if entry[1] is None and entry[3] is None and entry[2].__module__ == "builtins"
    ]


def _file(descriptor: int) -> tuple[int, int] | None:
    try:
        status = os.fstat(descriptor)
    except OSError:
        return None  # closed
    return status.st_dev, status.st_ino


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _arithmetic() -> str:
    """Return the mode of the floating-point unit, which a library compiled with -ffast-math changes when it is loaded.

    The operands are arrays, so that no constant is computed in advance.
    """
    tiny, third = np.array([2.3e-308]) / 4.0, np.array([1.0]) / np.array([3.0])
    return f"{'with' if tiny[0] != 0.0 else 'without'} subnormal numbers, 1/3 = {third[0].hex()}"


_SETTINGS: dict[str, Callable[[], Any]] = {
    "the working directory": os.getcwd,
    "the umask": _umask,
    "the processor cores that may be used": lambda: getattr(os, "sched_getaffinity", lambda _: None)(0),
    "the priority (nice value)": lambda: os.getpriority(os.PRIO_PROCESS, 0),
    "the blocked signals": lambda: signal.pthread_sigmask(signal.SIG_BLOCK, []),
    "the alarm timer": lambda: signal.getitimer(signal.ITIMER_REAL)[0] > 0.0,
    "the locale": lambda: locale.setlocale(locale.LC_ALL),
    "the time zone": lambda: time.tzname,
    "the rounding and precision of floating-point numbers": _arithmetic,
    "np.geterr()": np.geterr,
    "np.geterrcall()": np.geterrcall,
    "np.get_printoptions()": np.get_printoptions,
    "the context of decimal": lambda: repr(decimal.getcontext()),
    "warnings.showwarning": lambda: warnings.showwarning,
    "sys.stdout": lambda: sys.stdout,
    "sys.stderr": lambda: sys.stderr,
    "sys.stdin": lambda: sys.stdin,
    "sys.excepthook": lambda: sys.excepthook,
    "threading.excepthook": lambda: threading.excepthook,
    "the trace function": sys.gettrace,
    "the profile function": sys.getprofile,
    "the recursion limit": sys.getrecursionlimit,
    "the thread switch interval": sys.getswitchinterval,
    "gc.isenabled()": gc.isenabled,
    "gc.get_threshold()": gc.get_threshold,
    "the start method of multiprocessing": lambda: multiprocessing.get_start_method(allow_none=True),
    "the default timeout of sockets": socket.getdefaulttimeout,
    "the folder of temporary files": tempfile.gettempdir,
    "the level of the root logger": lambda: (logging.root.level, logging.root.manager.disable),
    "the handlers of the root logger": lambda: list(logging.root.handlers),
    "sys.path": lambda: list(sys.path),
}


def _owners() -> Iterator[Any]:
    """Yield the modules and classes whose functions a solver must not replace."""
    yield from (builtins, math, os, random, sys, time, signal, threading, np, np.random, np.linalg)
    yield from (np.random.Generator, MeteredProblem, Problem, Solver, Probe)
    yield from (importlib.import_module(f"nfbench.core.{name}") for name in ("meter", "minimization", "budget"))


_OWNERS = tuple(_owners())
