"""Executes one run: takes a spec of plain data and returns one record, whatever happens."""

from __future__ import annotations

import math
import numbers
import time
from typing import Any

import numpy as np

from nfbench.core import (
    MAX_ROWS,
    Budget,
    Incompatible,
    Minimum,
    NfbenchError,
    Problem,
    Reference,
    Solution,
    Status,
    common_start,
    explain,
    message_of,
    minimize,
    printable,
)
from nfbench.plugins import Registry
from nfbench.study import PluginSpec, RunRecord, RunSpec

from .stopping import Stopping
from .storable import Unstorable, plain_columns, plain_estimate, plain_positions, plain_reference, plain_scores

__all__ = ["execute"]


def execute(spec: RunSpec, registry: Registry, *, interruptible: bool = True) -> RunRecord:
    """Draw the instance, and solve it and score the estimate, or prove the optimum of its first problem.

    The record can be stored whatever the plugins did.

    interruptible: whether a KeyboardInterrupt is the user's and passed on. In a worker process it is the plugin's own.
    Raises nothing else.
    """
    attempt = _Proof(spec, registry) if spec.asks == "reference" else _Attempt(spec, registry)
    try:
        status, message = attempt.run()
    except _Ended as ended:
        status, message = ended.status, message_of(ended)
    except Unstorable as error:
        status, message = Status.INVALID, message_of(error)
    except Incompatible as error:
        status, message = Status.SKIPPED, message_of(error)
    except NfbenchError as error:
        status, message = Status.FAILED, message_of(error)
    except MemoryError as error:
        status, message = Status.CRASHED, f"ran out of memory: {explain(error)}"
    except KeyboardInterrupt as error:
        if interruptible:
            raise
        status, message = Status.FAILED, explain(error)
    except BaseException as error:  # a plugin may raise any, such as SystemExit or GeneratorExit
        status, message = Status.FAILED, explain(error)
    return attempt.record(status, printable(message))


class _Ended(Exception):
    """Ends the run with a status other than ok."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


class _Attempt:
    """One run in progress. It keeps intermediate results, so that they are stored even if the run fails later."""

    def __init__(self, spec: RunSpec, registry: Registry) -> None:
        self.spec = spec
        self.registry = registry
        self.minima: list[Minimum] = []
        self.scores: dict[str, float] = {}
        self.estimate: list[Any] | None = None
        self.positions: tuple[list[list[float]], list[list[float]]] | None = None
        self.optimum: Any = None  # known minimum of the first problem
        self.runtime_s = self.cpu_s = math.nan

    def run(self) -> tuple[Status, str]:
        method = self.spec.method
        scenario = self.registry.make("scenario", *_available(self.spec.point.scenario))
        formulation = self.registry.make("formulation", *_available(method.formulation))
        solver = self.registry.make("solver", *_available(method.solver)) if method.solver else None
        limits = dict(method.budget or {})
        start = limits.pop("start", None)
        budget = Budget(**limits) if limits else None
        if solver:
            solver.warm_up()
        formulation.warm_up()
        instance = scenario.draw_scene(np.random.default_rng(self.spec.instance_seed), self.spec.scene)

        stopping = Stopping(budget.target if budget else None, scenario, formulation, instance)

        def minimize_next(problem: Problem) -> Minimum:
            if solver is None or budget is None:
                raise NfbenchError(f"{method.formulation.kind} declares `needs_solver = False` but called `minimize`")
            number = len(self.minima)
            if not number:
                self.optimum = getattr(problem, "minimum", None)
            reached = stopping.test(problem)
            sample = common_start(problem, start, [self.spec.instance_seed, number]) if start else None
            rng = np.random.default_rng([self.spec.solver_seed, number])
            self.minima.append(minimize(problem, solver, budget, rng, start=sample, reached=reached))
            if self.minima[-1].status is not Status.OK:
                raise _Ended(self.minima[-1].status, self.minima[-1].message)
            return self.minima[-1]

        wall, cpu = time.perf_counter(), time.process_time()
        try:
            found = formulation.solve(instance, minimize_next)
        finally:
            self.runtime_s, self.cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        found, columns = (found.estimate, found.columns) if isinstance(found, Solution) else (found, {})
        estimate = plain_estimate(found)
        self.estimate = estimate.tolist()
        try:
            self.scores = plain_scores(instance.score(estimate))
        except ValueError as error:
            raise _Ended(Status.INVALID, f"estimate: {error}") from error
        self.scores |= plain_columns(columns, self.scores)
        measure = scenario.ranked_by()
        if estimate.size and math.isnan(self.scores.get(measure, math.nan)):
            raise _Ended(Status.INVALID, f"{measure} of the estimate is NaN")
        self.positions = plain_positions(instance.positions(estimate))
        return Status.OK, "; ".join(minimum.message for minimum in self.minima if minimum.message)

    def record(self, status: Status, message: str) -> RunRecord:
        """What the run has found until it ended."""
        minima = self.minima
        return RunRecord(
            run_id=self.spec.run_id,
            status=status,
            message=message,
            objective=minima[-1].value if minima else math.nan,
            evaluations=sum(minimum.evaluations for minimum in minima),
            runtime_s=self.runtime_s,
            cpu_s=self.cpu_s,
            scores={**self.scores, **self.facts(status)},
            estimate=self.estimate,
            positions=self.positions,
            traces=tuple(minimum.trace.thinned(max(MAX_ROWS // len(minima), 2)) for minimum in minima),
        )

    def facts(self, status: Status) -> dict[str, float]:
        """What the run records beside the scores of its estimate.

        target_reached: 1 if the best point of every problem reached the target, else 0; only where a target was set.
        optimum: known minimum of the first problem, in its unit; only where it is known.
        gradients: number of gradients over all problems; only if there were any.
        evaluation_s, batches, batched: time inside the problems, number of batches and of the evaluations in them, over
        all problems; only if there were any evaluations. The time is not known of very short runs.
        """
        facts = {}
        target = (self.spec.method.budget or {}).get("target")
        if target is not None and status is not Status.SKIPPED:
            facts["target_reached"] = float(bool(self.minima) and all(minimum.reached for minimum in self.minima))
        if isinstance(self.optimum, numbers.Real):
            facts["optimum"] = float(self.optimum)
        if gradients := sum(minimum.gradients for minimum in self.minima):
            facts["gradients"] = float(gradients)
        if any(minimum.evaluations for minimum in self.minima):
            inside_s = sum(minimum.evaluation_s for minimum in self.minima)
            facts |= {} if math.isnan(inside_s) else {"evaluation_s": inside_s}
            facts["batches"] = float(sum(minimum.batches for minimum in self.minima))
            facts["batched"] = float(sum(minimum.batched for minimum in self.minima))
        return facts


class _Proof:
    """One proof of an optimum in progress."""

    def __init__(self, spec: RunSpec, registry: Registry) -> None:
        self.spec = spec
        self.registry = registry
        self.value = math.nan
        self.columns: dict[str, float] = {}
        self.point: list[Any] | None = None
        self.runtime_s = self.cpu_s = math.nan

    def run(self) -> tuple[Status, str]:
        scenario = self.registry.make("scenario", *_available(self.spec.point.scenario))
        formulation = self.registry.make("formulation", *_available(self.spec.method.formulation))
        instance = scenario.draw_scene(np.random.default_rng(self.spec.instance_seed), self.spec.scene)
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            found = formulation.reference(instance)
        finally:
            self.runtime_s, self.cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        if found is None:
            return Status.SKIPPED, "the formulation has no proof for this scene"
        if not isinstance(found, Reference):
            raise Unstorable(f"reference: expected a Reference or None, got {type(found).__name__}")
        self.value, self.columns, point = plain_reference(found)
        self.point = None if point is None else point.tolist()
        return Status.OK, ""

    def record(self, status: Status, message: str) -> RunRecord:
        """What has been proven."""
        return RunRecord(
            run_id=self.spec.run_id,
            status=status,
            message=message,
            objective=self.value,
            runtime_s=self.runtime_s,
            cpu_s=self.cpu_s,
            scores=self.columns,
            estimate=self.point,
        )


def _available(spec: PluginSpec) -> tuple[str, dict[str, Any]]:
    """The name and options of a plugin. Ends the run if the plugin cannot be imported."""
    if spec.broken:
        raise _Ended(Status.FAILED, spec.broken)
    return spec.kind, spec.options
