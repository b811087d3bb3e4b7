"""Runs a function of a solver in a new interpreter, which loads the solver's class by its module or its file."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import importlib.util
import inspect
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from nfbench.core import Solver, cause_of_end, die_with_parent

from .subject import Subject, need

__all__ = ["elsewhere"]

T = TypeVar("T")

TIMEOUT_S = 600.0

_CHILD = """
import pickle, sys
folder = sys.argv[1]
with open(folder + "/job", "rb") as file:
    job = pickle.load(file)
sys.path[:] = job["path"]
from nfbench.testing.elsewhere import serve
serve(job, folder)
"""


def elsewhere(
    subject: Subject, function: Callable[..., T], arguments: tuple[Any, ...] = (), *, folder_of_its_own: bool = False
) -> T:
    """Return ``function(load, *arguments)`` from a new interpreter, where ``load()`` returns the solver.

    folder_of_its_own: whether the process works in an empty folder, which also receives the temporary files.
    """
    cls = type(subject.solver)
    file = inspect.getsourcefile(cls) if "<locals>" not in cls.__qualname__ else None
    need(
        file is not None and Path(file).is_file(),
        "a solver class that another process can import",
        f"{cls.__module__}.{cls.__qualname__}, which is defined in a function or without a file",
        "Define the class at the top level of a file.",
    )
    options = {f.name: getattr(subject.solver, f.name) for f in dataclasses.fields(cls) if f.init}
    job = {
        "path": [str(Path(entry).absolute()) for entry in sys.path],
        "class": (cls.__module__, cls.__qualname__, str(Path(str(file)).absolute())),
        "options": pickle.dumps(options),
        "call": pickle.dumps((function, arguments)),
        "parent": os.getpid(),
    }
    with tempfile.TemporaryDirectory(prefix="nfbench-") as folder:
        (Path(folder) / "job").write_bytes(pickle.dumps(job))
        end = _run(folder, folder_of_its_own)
        answer = Path(folder) / "answer"
        need(answer.is_file(), "the run to be repeated in a new process", end, _FIX_IMPORT)
        found: T = pickle.loads(answer.read_bytes())
    return found


def _run(folder: str, folder_of_its_own: bool) -> str:
    """Run the interpreter; return the last line of its output or, if there is none, how it ended."""
    own = Path(folder) / "own"
    own.mkdir()
    env = {**os.environ, "PYTHONHASHSEED": "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"}
    if folder_of_its_own:
        env["TMPDIR"] = str(own)
    output = Path(folder) / "output"
    with output.open("wb") as file:  # a file, because a process that the solver leaves running would hold a pipe open
        try:
            done = subprocess.run(
                [sys.executable, "-c", _CHILD, folder],
                cwd=own if folder_of_its_own else None,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                timeout=TIMEOUT_S,
                check=False,
                env=env,
            )
        except subprocess.TimeoutExpired:
            need(False, f"the run in a new process to end within {TIMEOUT_S:g} s", "no result", _FIX_HANG)
    need(done.returncode >= 0, "the new process to stay alive", f"its end by {cause_of_end(done.returncode)}", _FIX_END)
    last = output.read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
    return last[:400] or cause_of_end(done.returncode)


_FIX_IMPORT = "Make the solver's file importable on its own: it must import everything that it needs."
_FIX_HANG = "Call problem.evaluate or problem(x) in every iteration of a loop."
_FIX_END = "Remove any call that ends the process; if there is none, native code crashed."


def serve(job: dict[str, Any], folder: str) -> None:
    """Run the function that :func:`elsewhere` requests, and write its result to ``folder``; runs in the new process."""
    die_with_parent(job["parent"])
    function, arguments = pickle.loads(job["call"])

    def load() -> Solver:
        return _load(*job["class"])(**pickle.loads(job["options"]))

    result = pickle.dumps(function(load, *arguments))
    partial = Path(folder) / "partial"
    partial.write_bytes(result)
    partial.rename(Path(folder) / "answer")


def _load(module: str, name: str, file: str) -> type[Solver]:
    """Return a class from its module or, if the module cannot be imported, from its file."""
    try:
        if module == "__main__":
            raise ImportError
        found: Any = functools.reduce(getattr, name.split("."), importlib.import_module(module))
    except (ImportError, AttributeError):
        spec = importlib.util.spec_from_file_location(f"{module}_from_file", file)
        if spec is None or spec.loader is None:
            raise
        loaded = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = sys.modules[module] = loaded
        spec.loader.exec_module(loaded)
        found = functools.reduce(getattr, name.split("."), loaded)
    return found
