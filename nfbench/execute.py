"""Runs one spec: plain data in, one record out, whatever happens."""

from __future__ import annotations

import math
import os
import socket
import time
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from .budget import Budget, Status
from .errors import Incompatible, NfbenchError
from .formulation import Formulation
from .minimize import Minimum, explain, minimize
from .options import Options
from .problem import Problem
from .registry import Registry
from .scenario import Scenario
from .solver import Solver
from .study import Choice, RunSpec
from .trace import MAX_ROWS, Trace

__all__ = ["RunRecord", "execute"]


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


def execute(spec: RunSpec, registry: Registry) -> RunRecord:
    """Draw the instance, solve it, score it. Never raises, but for KeyboardInterrupt."""
    attempt = _Attempt(spec, registry)
    try:
        status, message = attempt.run()
    except _Ended as ended:
        status, message = ended.status, str(ended)
    except Incompatible as error:
        status, message = Status.SKIPPED, str(error)
    except NfbenchError as error:
        status, message = Status.FAILED, str(error)
    except MemoryError as error:
        status, message = Status.CRASHED, f"ran out of memory: {explain(error)}"
    except (Exception, SystemExit) as error:
        status, message = Status.FAILED, explain(error)
    minima = attempt.minima
    return RunRecord(
        run_id=spec.run_id,
        status=status,
        message=message,
        objective=minima[-1].value if minima else math.nan,
        evaluations=sum(minimum.evaluations for minimum in minima),
        runtime_s=attempt.runtime_s,
        cpu_s=attempt.cpu_s,
        scores=attempt.scores,
        estimate=attempt.estimate,
        traces=tuple(minimum.trace.thinned(max(MAX_ROWS // len(minima), 2)) for minimum in minima),
    )


class _Ended(Exception):
    """The run ends here, in a status other than ok."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


class _Attempt:
    """One run in progress: keeps what it has come to, so that a run that fails half-way still tells."""

    def __init__(self, spec: RunSpec, registry: Registry) -> None:
        self.spec = spec
        self.registry = registry
        self.minima: list[Minimum] = []
        self.scores: dict[str, float] = {}
        self.estimate: list[Any] | None = None
        self.runtime_s = self.cpu_s = math.nan

    def run(self) -> tuple[Status, str]:
        method = self.spec.method
        scenario = cast(Scenario, self._make("scenario", self.spec.point.scenario))
        formulation = cast(Formulation, self._make("formulation", method.formulation))
        solver = cast(Solver, self._make("solver", method.solver)) if method.solver else None
        budget = Budget(**method.budget) if method.budget else None
        if solver:
            solver.warm_up()
        instance = scenario.draw(np.random.default_rng(self.spec.instance_seed))

        def minimize_next(problem: Problem) -> Minimum:
            if solver is None or budget is None:
                raise NfbenchError(f"{method.formulation.kind} says it needs no solver, yet asked for one")
            rng = np.random.default_rng([self.spec.solver_seed, len(self.minima)])
            self.minima.append(minimize(problem, solver, budget, rng))
            if self.minima[-1].status is not Status.OK:
                raise _Ended(self.minima[-1].status, self.minima[-1].message)
            return self.minima[-1]

        wall, cpu = time.perf_counter(), time.process_time()
        try:
            estimate = np.asarray(formulation.solve(instance, minimize_next))
        finally:
            self.runtime_s, self.cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        self.estimate = estimate.tolist()
        try:
            self.scores = {name: float(score) for name, score in instance.score(estimate).items()}
        except ValueError as error:
            raise _Ended(Status.INVALID, f"estimate: {error}") from error
        if estimate.size and math.isnan(self.scores.get(scenario.error, math.nan)):
            raise _Ended(Status.INVALID, f"{scenario.error} of the estimate is not a number")
        return Status.OK, "; ".join(minimum.message for minimum in self.minima if minimum.message)

    def _make(self, kind: str, choice: Choice) -> Options:
        if choice.broken:
            raise _Ended(Status.FAILED, choice.broken)
        return self.registry.make(kind, choice.kind, choice.options)
