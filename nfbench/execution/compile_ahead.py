"""Compiles and loads what the runs of a study need, before any run is timed."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterable
from multiprocessing import get_context
from typing import Any

from nfbench.core import Formulation, NfbenchError, Scenario, Solver
from nfbench.plugins import Registry
from nfbench.study import PluginSpec, Study

__all__ = ["warm_up"]

LONGEST_S = 600.0  # time limit for the warm-up of one plugin of somebody else


def warm_up(study: Study, solvers: Iterable[PluginSpec] | None = None) -> None:
    """Warm up the scenario, the formulations and the solvers, where the user sees their messages.

    Workers then find the compiled code. A plugin that cannot be made, or whose ``warm_up`` fails, is left out: its runs
    fail later, with the reason. The ``warm_up`` of a plugin that is not nfbench's own runs in a process of its own.

    study: the study whose scenario and formulations are warmed up.
    solvers: the solvers to warm up; None: all solvers of the study.

    Raises NfbenchError if nfbench's own kernels cannot be compiled.
    """
    registry = Registry(study.plugins)
    if solvers is None:
        solvers = [method.solver for method in study.methods if method.solver]
    _warm_up_one(registry, study, "scenario", study.points[0].scenario)
    for formulation in {repr(method.formulation): method.formulation for method in study.methods}.values():
        _warm_up_one(registry, study, "formulation", formulation)
    for solver in {solver.kind: solver for solver in solvers}.values():
        _warm_up_one(registry, study, "solver", solver)


def _warm_up_one(registry: Registry, study: Study, kind: str, spec: PluginSpec) -> None:
    if spec.broken:
        return
    try:
        plugin = registry.make(kind, spec.kind, spec.options)
    except NfbenchError:
        return
    assert isinstance(plugin, Scenario | Formulation | Solver)
    if type(plugin).warm_up in (Scenario.warm_up, Formulation.warm_up, Solver.warm_up):
        return
    if registry.find(kind, spec.kind).origin.partition(" ")[0] == "nfbench":
        plugin.warm_up()
        return
    process = get_context("spawn").Process(
        target=_warm_up_elsewhere, args=(study.plugins, kind, spec.kind, spec.options), daemon=True
    )
    process.start()
    process.join(LONGEST_S)
    if process.pid is not None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)  # and what it has started
    process.kill()
    process.join()


def _warm_up_elsewhere(plugins: tuple[str, ...], kind: str, name: str, options: dict[str, Any]) -> None:
    os.setsid()
    with contextlib.suppress(BaseException):  # the plugin's runs fail for the same reason, and report it
        plugin = Registry(plugins).make(kind, name, options)
        assert isinstance(plugin, Scenario | Formulation | Solver)
        plugin.warm_up()
    os._exit(0)
