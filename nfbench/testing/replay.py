"""Repeat a run in this process and in a new interpreter; both must agree to the last bit."""

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
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from nfbench.core import Solver

from .subject import Subject, ended_ok, need

__all__ = ["Replay", "replay", "replay_elsewhere", "same"]

Replay = tuple[str, list[ndarray]]


def replay(subject: Subject, n: int) -> Replay:
    """Run the solver and return what must repeat: the digest of all points, and the trace without its times."""
    probe = subject.probe(n)
    outcome = subject.run(probe, 500, seed=7)
    ended_ok(outcome, "on the bowl")
    trace = outcome.minimum.trace
    return probe.digest, [trace.evaluations, trace.values, trace.points]


def same(first: Replay, second: Replay, where: str, remedy: str) -> None:
    """Fail unless both replays are identical; ``where`` and ``remedy`` complete the message."""
    for name, a, b in zip(("evaluations", "values", "points"), first[1], second[1], strict=True):
        rows = min(len(a), len(b))
        differ = np.flatnonzero((a[:rows] != b[:rows]).reshape(rows, -1).any(axis=1))
        row = int(differ[0]) if len(differ) else rows
        need(
            not len(differ) and len(a) == len(b),
            f"identical traces with the same seed {where}",
            f"{name} that differ from row {row} on: {a[row : row + 1].tolist()} and {b[row : row + 1].tolist()}",
            remedy,
        )
    need(first[0] == second[0], f"identical points with the same seed {where}", "points that differ", remedy)


_CHILD = """
import pickle, sys
folder = sys.argv[1]
with open(folder + "/job", "rb") as file:
    job = pickle.load(file)
sys.path[:] = job["path"]
from nfbench.testing.replay import serve
serve(job, folder)
"""


def replay_elsewhere(subject: Subject) -> Replay:
    """Return the same replay from a new interpreter, which loads the solver's class by its module or its file."""
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
        "path": sys.path,
        "class": (cls.__module__, cls.__qualname__, str(file)),
        "options": pickle.dumps(options),
        "dimension": subject.dimension,
    }
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "job").write_bytes(pickle.dumps(job))
        command = [sys.executable, "-c", _CHILD, folder]
        env = {**os.environ, "PYTHONHASHSEED": "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"}
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=env)
        answer = Path(folder) / "answer"
        need(
            answer.is_file(),
            "the run to be repeated in a new process",
            done.stderr.strip().rpartition("\n")[2] or f"exit code {done.returncode}",
            "Make the solver's file importable on its own: it must import everything that it needs.",
        )
        repeated: Replay = pickle.loads(answer.read_bytes())
    return repeated


def serve(job: dict[str, Any], folder: str) -> None:
    """Run the replay that :func:`replay_elsewhere` requests, and write it to ``folder``; runs in the new process."""
    cls = _load(*job["class"])
    solver = cls(**pickle.loads(job["options"]))
    partial = Path(folder) / "partial"
    partial.write_bytes(pickle.dumps(replay(Subject(solver), job["dimension"])))
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
