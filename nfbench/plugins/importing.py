"""Imports plugin files, first in a child process, so that a file that hangs or ends its process does no harm."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import select
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from nfbench.core import explain, printable

from .containment import Containment

__all__ = ["IMPORT_S", "import_file"]

IMPORT_S = 120.0  # time limit for importing a plugin file [s]
LONGEST = 2**16  # bytes of a child's answer
_probed: dict[str, str] = {}  # module name → why it cannot be imported; empty if it can


def import_file(file: Path, version: str) -> ModuleType:
    """Import a file under a unique module name, registered in sys.modules because dataclasses and pickle need it.

    The working directory is restored afterwards. Raises ImportError, with the reason, if the file raises any exception,
    ends or kills its process, or takes longer than IMPORT_S.
    """
    name = f"nfbench_plugin_{re.sub(r'[^0-9a-zA-Z]', '_', file.stem)}_{version}"
    if name in sys.modules:
        return sys.modules[name]
    if name not in _probed:
        _probed[name] = _why_not(file, name)
    if _probed[name]:
        raise ImportError(_probed[name])
    return _load(file, name)


def _load(file: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError("expected a Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with _restored():
            spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        raise ImportError(_reason(error)) from error
    return module


def _reason(error: BaseException) -> str:
    hint = "; put @dataclass(frozen=True) above its classes" if "non-frozen dataclass" in str(error) else ""
    return printable(f"{explain(error)}{hint}")


@contextlib.contextmanager
def _restored() -> Iterator[None]:
    """Restore afterwards what a plugin file may change by habit: the working directory and NumPy's error handling."""
    before = os.getcwd()  # noqa: PTH109  # restored by name
    try:
        with np.errstate():
            yield
    finally:
        os.chdir(before)


def _why_not(file: Path, name: str) -> str:
    """Why the file cannot be imported, found out in a child process; empty if it can, or where there is no fork."""
    if not hasattr(os, "fork"):
        return ""
    readable, writable = os.pipe()
    pid = _fork()
    if pid == 0:
        _probe(file, name, writable)
    os.close(writable)
    try:
        answer = _answer(readable, time.monotonic() + IMPORT_S)
    finally:
        os.close(readable)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)  # and whatever the import started
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)  # in case it has not become the leader of its group yet
        _, status = os.waitpid(pid, 0)
    if answer is None:
        return f"was not imported within {IMPORT_S:g} s; move slow code into minimize, draw or solve"
    if not answer:
        code = os.waitstatus_to_exitcode(status)
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        return f"ended the process {how} while it was imported; a plugin file must only define classes"
    return answer[1:].decode("utf-8", "replace")


def _fork() -> int:
    import warnings

    with warnings.catch_warnings():  # Python warns of forks beside threads; the child only imports, under a deadline
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _probe(file: Path, name: str, answer: int) -> None:
    """The child: import the file, and answer ``+`` and why it cannot be imported. Never returns."""
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    reason, state = "", Containment([answer])
    try:
        _load(file, name)
        if changed := state.changed():
            reason = f"changes {changed} while it is imported; a plugin file must only define classes"
    except BaseException as error:
        reason = str(error)
    with contextlib.suppress(OSError):
        os.write(answer, b"+" + reason.encode("utf-8", "replace")[: LONGEST - 1])
    os._exit(0)


def _answer(pipe: int, deadline: float) -> bytes | None:
    """What the child has written when it ends; None if the deadline passes before it answers."""
    while (remaining := deadline - time.monotonic()) > 0:
        if select.select([pipe], [], [], remaining)[0]:
            return os.read(pipe, LONGEST)
    return None
