"""A run as plain data: what is asked for (``RunSpec``) and what came of it (``RunRecord``)."""

from __future__ import annotations

import math
import os
import socket
from dataclasses import dataclass, field
from typing import Any

from nfbench.core import Status, Trace

__all__ = ["Method", "PluginSpec", "Point", "RunRecord", "RunSpec"]


@dataclass(frozen=True)
class PluginSpec:
    """One scenario, formulation or solver with its options, as plain data.

    label: its name in tables. options: canonical, defaults included; chosen: those that differ from their default.
    version: of the plugin that provides it.
    broken: why it cannot be made (a plugin file that fails to import); its runs fail with this message.
    """

    kind: str
    label: str
    options: dict[str, Any]
    chosen: dict[str, Any]
    version: str
    broken: str | None = None

    @property
    def identity(self) -> dict[str, Any]:
        """What it is, whatever it is called; the same when its plugin gains an option."""
        return {"kind": self.kind, **self.chosen}


@dataclass(frozen=True)
class Point:
    """One point of the sweep: the scenario there, and the swept keys' values."""

    scenario: PluginSpec
    swept: dict[str, Any]


@dataclass(frozen=True)
class Method:
    """One formulation with one solver (None where it needs none) and what that solver may spend on each problem."""

    formulation: PluginSpec
    solver: PluginSpec | None
    budget: dict[str, Any] | None
    label: str
    run_timeout_s: float | None = None
    run_memory_mb: int | None = None


@dataclass(frozen=True)
class RunSpec:
    """One run as text and numbers: hashable, storable, and the same on every machine.

    run_id identifies what is computed: the options of scenario, formulation and solver that differ from their
    defaults, budget, study seed, repetition and plugin versions; not labels, timeouts, worker counts or paths.
    instance_seed: the same for every method at a scenario point and repetition, so that comparisons are paired.
    """

    run_id: str
    study: str
    point: Point
    method: Method
    repetition: int
    instance_seed: int
    solver_seed: int


@dataclass(frozen=True)
class RunRecord:
    """What came of one run.

    objective: the best value of the last problem solved. evaluations: over all its problems. runtime_s, cpu_s: of the
    formulation's ``solve``, wall-clock and of this process [s]. scores: by column name. estimate: as the formulation
    gave it. traces: one for each problem it minimized, together under 1,000 rows.
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
    traces: tuple[Trace, ...] = ()
    host: str = field(default_factory=socket.gethostname)
    worker: int = field(default_factory=os.getpid)
