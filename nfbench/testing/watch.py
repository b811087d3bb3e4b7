"""Checks in a process of their own, so that a plugin that hangs or crashes costs one check and not the rest."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from nfbench.core import NfbenchError, PluginError, Scenario, Solver, explain
from nfbench.plugins import CONTRACTS, Registry
from nfbench.study import load_study

from .checks import CheckResult, check_names, solver_checks
from .scenario_checks import scenario_check_names, scenario_checks, solved_by

__all__ = ["Job", "check_jobs", "watched_checks"]

START_S = 120.0  # for the process to import the plugin, beside what the first check may take


@dataclass(frozen=True)
class Job:
    """What to check: a solver or scenario by its name, the plugin files that know it, and its options."""

    kind: str
    name: str
    files: tuple[str | Path, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)


def check_jobs(
    kind: str, name: str, plugins: Iterable[Path] = (), options: Mapping[str, Any] | None = None
) -> Iterator[Job]:
    """What to check: the plugin of that name, all in that file or, of kind "scenario", the first of that manifest.

    Raises PluginError where there is none or it cannot be imported, OptionError where the options do not make it.
    """
    options = dict(options or {})
    if name.endswith(".toml"):
        study = load_study(name, plugins)
        chosen = study.points[0].scenario
        yield Job(kind, chosen.kind, study.plugins, {**chosen.options, **options})
        return
    is_file = name.endswith(".py") or Path(name).is_file()
    registry = Registry([*plugins, name] if is_file else plugins)
    for file, why in registry.broken.items():
        raise PluginError(f"plugin {file.name} failed to import: {why}")
    names = [name]
    if is_file:
        names = [n for n in registry.names(kind) if registry.find(kind, n).origin == Path(name).name]
        if not names:
            raise PluginError(f"{name}: expected a class derived from nfbench.{CONTRACTS[kind].__name__}, found none")
    for found in names:
        registry.make(kind, found, options)
        yield Job(kind, found, registry.files, options)


def watched_checks(job: Job, timeout_s: float) -> Iterator[CheckResult]:
    """The checks of a solver or scenario; one that takes more than ``timeout_s`` is stopped and has failed.

    Raises NfbenchError where the process cannot make the plugin.
    """
    left = check_names() if job.kind == "solver" else scenario_check_names()
    while left:
        for result in _in_process(job, left, timeout_s):
            left = left[1:]
            yield result


def _in_process(job: Job, checks: list[str], timeout_s: float) -> Iterator[CheckResult]:
    """The results of one process: of all the checks, or up to the one that stopped it."""
    spawn = get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_serve, args=(theirs, job, checks), daemon=True)
    process.start()
    theirs.close()
    try:
        error = _heard(ours, process, START_S)
        if error:
            raise NfbenchError(f"{job.kind} {job.name} cannot be made in a process of its own: {error}")
        for check in checks:
            result = _heard(ours, process, timeout_s)
            if not isinstance(result, CheckResult):
                yield CheckResult(check, False, result)
                return
            yield result
    finally:
        _kill(process)


def _heard(pipe: Connection, process: BaseProcess, seconds: float) -> Any:
    """What the process says next or, as text, why it says nothing."""
    if not pipe.poll(seconds):
        return f"expected an end within {seconds:g} s, got none. {_MEND_HANG}"
    try:
        return pipe.recv()
    except EOFError:
        process.join()
        return f"expected its process to survive, got its end by {_cause(process)}. {_MEND_CRASH}"


def _serve(pipe: Connection, job: Job, checks: list[str]) -> None:
    os.setsid()  # so that what a check starts dies with this process
    try:
        registry = Registry(job.files)
        made = registry.make(job.kind, job.name, job.options)
        if isinstance(made, Solver):
            results = solver_checks(made, checks)
        else:
            assert isinstance(made, Scenario)
            results = scenario_checks(made, solved_by(registry, made), checks)
    except Exception as error:
        pipe.send(explain(error))
        return
    pipe.send("")
    for result in results:
        pipe.send(result)


def _kill(process: BaseProcess) -> None:
    if process.is_alive() and process.pid is not None:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:  # it has no group of its own yet
            process.kill()
    process.join()


def _cause(process: BaseProcess) -> str:
    code = process.exitcode or 0
    return f"signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"exit code {code}"


_MEND_HANG = (
    "Ask problem.evaluate or problem(x) in every turn of a loop, as only that can end it; a check that is merely slow "
    "gets more time by --timeout."
)
_MEND_CRASH = (
    "If it calls no exit, something below Python failed: run nfbench.minimize(problem, solver, budget) under "
    "`python -X faulthandler`."
)
