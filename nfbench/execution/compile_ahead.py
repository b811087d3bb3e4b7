"""Compiles and loads what the runs of a study need, before any run is timed."""

from __future__ import annotations

from collections.abc import Iterable

from nfbench.plugins import Registry
from nfbench.study import PluginSpec, Study

__all__ = ["warm_up"]


def warm_up(study: Study, solvers: Iterable[PluginSpec] | None = None) -> None:
    """Warm up the scenario and the solvers in this process, where the user sees their messages.

    Workers then find the compiled code. Plugins that cannot be imported are skipped; their runs fail later.

    study: the study whose scenario is warmed up.
    solvers: the solvers to warm up; None: all solvers of the study.
    """
    registry = Registry(study.plugins)
    if solvers is None:
        solvers = [method.solver for method in study.methods if method.solver]
    scenario = study.points[0].scenario
    if not scenario.broken:
        registry.make("scenario", scenario.kind, scenario.options).warm_up()
    for solver in {solver.kind: solver for solver in solvers}.values():
        if not solver.broken:
            registry.make("solver", solver.kind, solver.options).warm_up()
