"""Checks in a separate process, so that a plugin that hangs or crashes fails one check and not the others."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from nfbench.core import (
    NfbenchError,
    PluginError,
    Scenario,
    Solver,
    cause_of_end,
    die_with_parent,
    end_group_at_eof,
    explain,
)
from nfbench.plugins import CONTRACTS, Registry
from nfbench.study import load_study

from .checks import CheckResult, check_names, solver_checks
from .scenario_checks import scenario_check_names, scenario_checks, solved_by

__all__ = ["Job", "check_jobs", "watched_checks"]

END_S = 5.0  # time for a process that has closed its connection to end [s]
START_S = 120.0  # time limit [s] for the process to import the plugin, in addition to that of the first check


@dataclass(frozen=True)
class Job:
    """A plugin to check.

    kind: "solver" or "scenario".
    name: registered name of the plugin.
    files: plugin files to load.
    options: options of the plugin, by name.
    """

    kind: str
    name: str
    files: tuple[str | Path, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)


def check_jobs(
    kind: str, name: str, plugins: Iterable[Path] = (), options: Mapping[str, Any] | None = None
) -> Iterator[Job]:
    """Yield what to check.

    ``name`` is the name of a plugin, a plugin file (all plugins of that kind in it are checked) or, for the kind
    "scenario", a manifest (its first scenario is checked). Raises PluginError if there is no such plugin or it cannot
    be imported, and OptionError if the options are invalid.
    """
    options = dict(options or {})
    if name.endswith(".toml"):
        study = load_study(name, plugins)
        scenario = study.points[0].scenario
        yield Job(kind, scenario.kind, study.plugins, {**scenario.options, **options})
        return
    is_file = name.endswith(".py") or Path(name).is_file()
    registry = Registry([*plugins, name] if is_file else plugins)
    for file, reason in registry.broken.items():
        raise PluginError(f"plugin {file.name} failed to import: {reason}")
    names = [name]
    if is_file:
        names = [n for n in registry.names(kind) if registry.find(kind, n).origin == Path(name).name]
        if not names:
            raise PluginError(f"{name}: expected a class derived from nfbench.{CONTRACTS[kind].__name__}, found none")
    for found in names:
        registry.make(kind, found, options)
        yield Job(kind, found, registry.files, options)


def watched_checks(job: Job, timeout_s: float) -> Iterator[CheckResult]:
    """Run the checks of a solver or scenario; a check that takes longer than ``timeout_s`` [s] is stopped and fails.

    Raises NfbenchError if the process cannot construct the plugin.
    """
    remaining = check_names() if job.kind == "solver" else scenario_check_names()
    while remaining:
        for result in _in_process(job, remaining, timeout_s):
            remaining = remaining[1:]
            yield result


def _in_process(job: Job, checks: list[str], timeout_s: float) -> Iterator[CheckResult]:
    """Yield the results of one process: those of all checks, or those up to the check that ended the process."""
    spawn = get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    alive, held = spawn.Pipe(duplex=False)  # we hold one end as long as we live
    process = spawn.Process(target=_serve, args=(theirs, alive, os.getpid(), job, checks), daemon=True)
    process.start()
    theirs.close()
    alive.close()
    try:
        error = _receive(ours, process, START_S)
        if error:
            raise NfbenchError(f"{job.kind} {job.name} cannot be constructed in a separate process: {error}")
        for check in checks:
            result = _receive(ours, process, timeout_s)
            if not isinstance(result, CheckResult):
                _kill(process)  # now, as the caller may take its time before it asks for the next result
                yield CheckResult(check, False, str(result))
                return
            yield result
    finally:
        _kill(process)
        ours.close()
        held.close()


def _receive(pipe: Connection, process: BaseProcess, seconds: float) -> Any:
    """Return the next object that the process sends or, as text, the reason why it sends none."""
    if not pipe.poll(seconds):
        return f"expected the check to end within {seconds:g} s, got no result. {_FIX_HANG}"
    try:
        return pipe.recv()
    except Exception:  # the end of the pipe, or an answer that a killed process has not written to its end
        process.join(END_S)
        cause = "it closed its connection" if process.is_alive() else f"its end by {cause_of_end(process.exitcode)}"
        return f"expected the process of the check to stay alive, got {cause}. {_FIX_CRASH}"


def _serve(pipe: Connection, alive: Connection, parent: int, job: Job, checks: list[str]) -> None:
    os.setsid()  # so that processes started by a check are killed together with this one
    end_group_at_eof(os.dup(alive.fileno()))
    alive.close()
    die_with_parent(parent)
    try:
        registry = Registry(job.files)
        plugin = registry.make(job.kind, job.name, job.options)
        if isinstance(plugin, Solver):
            results = solver_checks(plugin, checks)
        else:
            assert isinstance(plugin, Scenario)
            results = scenario_checks(plugin, solved_by(registry, plugin), checks)
    except Exception as error:
        pipe.send(explain(error))
        return
    pipe.send("")
    for result in results:
        pipe.send(result)


def _kill(process: BaseProcess) -> None:
    """Kill the process and every process in its group, also if the process itself has ended."""
    if process.pid is not None:
        with contextlib.suppress(ProcessLookupError, PermissionError):  # no group yet, or nothing left of it
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()


_FIX_HANG = (
    "Call problem.evaluate or problem(x) in every iteration of a loop, because only these calls can end the run; if "
    "the check is merely slow, give it more time with --timeout."
)
_FIX_CRASH = (
    "Remove any call of exit; if there is none, native code crashed: run nfbench.minimize(problem, solver, budget) "
    "under `python -X faulthandler` to find out where."
)
