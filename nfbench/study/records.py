"""A run as plain data: its specification (``RunSpec``) and its result (``RunRecord``)."""

from __future__ import annotations

import math
import os
import socket
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from nfbench.core import Status, Trace

__all__ = ["Method", "PluginSpec", "Point", "RunRecord", "RunSpec", "swept_column"]


@dataclass(frozen=True)
class PluginSpec:
    """One scenario, formulation or solver with its options, as plain data.

    kind: name under which the plugin is registered.
    label: name shown in tables.
    options: all options in canonical form, including defaults.
    chosen: options in canonical form that differ from their defaults.
    version: version of the plugin, followed by the versions of the plugins in its options.
    broken: reason why the plugin is not available, e.g. a plugin file that fails to import; its runs fail with this
    message. None if the plugin is available.
    """

    kind: str
    label: str
    options: dict[str, Any]
    chosen: dict[str, Any]
    version: str
    broken: str | None = None

    @property
    def identity(self) -> dict[str, Any]:
        """The kind and the chosen options. Neither the label nor a new option with a default changes them."""
        return {"kind": self.kind, **self.chosen}


def swept_column(key: str) -> str:
    """Return the name of the column of a swept key in tables: ``scenario.snr_db``, ``budget.evaluations``."""
    return key if key.startswith("budget.") else f"scenario.{key}"


@dataclass(frozen=True)
class Point:
    """One point of the sweep.

    scenario: scenario at this point.
    swept: value of each swept key at this point; keys of the budget start with ``budget.``.
    budget: limits of the budget that are swept, as the options of Budget.
    """

    scenario: PluginSpec
    swept: dict[str, Any]
    budget: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Method:
    """One formulation, with a solver and a budget if it needs them.

    formulation: formulation.
    solver: solver; None if the formulation needs none.
    budget: limits on what the solver may spend on each problem, as the options of Budget; None without a solver.
    label: name shown in tables.
    run_timeout_s: time after which a run is killed [s]; None for no limit.
    run_memory_mb: memory that a run may allocate [MiB]; None for no limit.
    is_stochastic: whether another run on the same scene can have another result.
    """

    formulation: PluginSpec
    solver: PluginSpec | None
    budget: dict[str, Any] | None
    label: str
    run_timeout_s: float | None = None
    run_memory_mb: int | None = None
    is_stochastic: bool = True

    def with_budget(self, swept: dict[str, Any]) -> Method:
        """Return this method with the limits that are swept; the method itself if it has no solver."""
        return replace(self, budget={**self.budget, **swept}) if self.budget is not None and swept else self


@dataclass(frozen=True)
class RunSpec:
    """The specification of one run as text and numbers, which can be stored and is the same on every machine.

    run_id: hash of everything that determines the result: the options of the scenario, formulation and solver that
    differ from their defaults, the budget, the study's seed, the numbers of the scene and of the run on it, and the
    plugin versions. Labels, timeouts, worker counts and paths do not enter it.
    study: name of the study.
    point: point of the sweep.
    method: method to run.
    repetition: number of the scene, from 0, times the study's runs per scene, plus the number of the run on it.
    instance_seed: seed of the scene. It depends on the study's seed and the number of the scene only, so that every
    swept value, method and run sees the same scene as far as possible, and comparisons are paired.
    solver_seed: seed of the solver. It depends on everything that determines the result except plugin versions.
    asks: what is computed: the estimate of the method, or the proven optimum of the first problem of its formulation.
    An optimum is no run of the study, but it is computed like one; its identity has no solver and no budget.
    scene: number of the scene, from 0.
    """

    run_id: str
    study: str
    point: Point
    method: Method
    repetition: int
    instance_seed: int
    solver_seed: int
    asks: Literal["estimate", "reference"] = "estimate"
    scene: int = 0


@dataclass(frozen=True)
class RunRecord:
    """The result of one run.

    That of a proven optimum has the smallest value as ``objective``, the point as ``estimate``, and ``gap``,
    ``certified``, ``step`` and further columns as ``scores``.

    run_id: identity of the run, as in its specification.
    status: how the run ended.
    message: explanation of the status; empty if there is nothing to explain.
    objective: best value of the last problem minimized, in the problem's unit; NaN if there was none.
    evaluations: number of evaluations over all problems that the run minimized.
    runtime_s: wall-clock time of the formulation's ``solve`` [s]; NaN if it is not known.
    cpu_s: CPU time of the process during ``solve`` [s]; NaN if it is not known.
    scores: scores of the estimate by column name.
    estimate: estimate that the formulation returned, as nested lists; None if it returned none.
    positions: true positions, and the estimates in the order of ``Instance.positions``, as lists of points [m]; None if
    the instance has none, or if the run is not ok.
    traces: one trace for each problem that was minimized, together fewer than 1,000 rows.
    host: name of the machine that executed the run.
    worker: id of the process that executed the run.
    """

    run_id: str
    status: Status
    message: str = ""
    objective: float = math.nan
    evaluations: int = 0
    runtime_s: float = math.nan
    cpu_s: float = math.nan
    scores: dict[str, float] = field(default_factory=dict)
    estimate: list[Any] | None = None
    positions: tuple[list[list[float]], list[list[float]]] | None = None
    traces: tuple[Trace, ...] = ()
    host: str = field(default_factory=socket.gethostname)
    worker: int = field(default_factory=os.getpid)
