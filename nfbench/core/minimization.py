"""Minimizes one problem with one solver. Studies use this function for their runs, and notebooks can call it too."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .budget import Budget
from .errors import BudgetExhausted, Incompatible, explain, message_of
from .meter import MeteredProblem
from .minimum import Minimum
from .problem import Problem
from .solver import Solver
from .status import Status
from .trace import Recorder

__all__ = ["budget_problem", "budget_warning", "common_start", "minimize", "start_problem"]


def minimize(
    problem: Problem,
    solver: Solver,
    budget: Budget | int,
    seed: int | np.random.Generator = 0,
    *,
    start: Float[ndarray, "p n"] | None = None,
    reached: Callable[[Float[ndarray, " n"], float], bool] | None = None,
) -> Minimum:
    """Minimize ``problem`` with ``solver`` within ``budget``, which is a Budget or a number of evaluations.

    The solver draws all random numbers from one generator, seeded with ``seed`` or given as ``seed``, so the same
    arguments give the same result. An exception raised by the solver is returned as the status and message of the
    result, except for MemoryError and exceptions such as KeyboardInterrupt, which are passed on. Raises ValueError if
    the budget or the bounds of the problem are invalid.

    start: points (p, n) in the box that are evaluated first, within the budget, and from which the solver continues;
        the status is ``skipped`` if the solver does not accept a start.
    reached: function of the best point (n,) and its value that replaces the target of the budget. It is called when the
        best value has improved, and the run ends if it returns True.
    """
    budget = Budget(evaluations=budget) if isinstance(budget, int) else budget
    reason = budget_problem(solver, budget) or (start_problem(solver) if start is not None else None)
    try:
        if reason:
            raise Incompatible(reason)
        solver.warm_up()
        meter = MeteredProblem(problem, budget, reached)
    except Incompatible as error:
        return _no_result(problem.dimension, 0.0, message_of(error), Status.SKIPPED)
    dimension = meter.dimension
    clock = time.perf_counter()
    status, message = _run_solver(solver, meter, np.random.default_rng(seed), start)
    runtime_s = time.perf_counter() - clock
    try:
        return _result(meter, budget, runtime_s, status, message)
    except MemoryError:
        raise
    except Exception as error:  # the solver wrote to private attributes of the meter
        message = f"the solver damaged the meter: {explain(error)}"
        return _no_result(dimension, runtime_s, message)


def budget_problem(solver: Solver, budget: Budget) -> str | None:
    """Return why ``solver`` cannot run with ``budget``; None if it can."""
    if solver.info.needs_evaluations and budget.evaluations is None:
        return (
            f"{type(solver).__name__} needs a limit on evaluations, because its search depends on the share of them "
            "that is spent; give evaluations in the budget, or as an option of the solver if it has one"
        )
    return None


def budget_warning(solver: Solver, budget: Budget) -> str | None:
    """Return a sentence if ``solver`` plans for a number of evaluations that ``budget`` does not give, else None."""
    if solver.info.plans_evaluations and budget.evaluations is None:
        return (
            f"{type(solver).__name__} adapts its search to the number of evaluations, and the budget does not limit "
            f"them: it plans for horizon = {getattr(solver, 'horizon', None)}"
        )
    return None


def start_problem(solver: Solver) -> str | None:
    """Return why ``solver`` cannot continue from points that are given; None if it can."""
    return None if solver.info.accepts_start else f"{type(solver).__name__} does not accept a start"


def common_start(problem: Problem, points: int, seed: int | list[int]) -> Float[ndarray, "p n"]:
    """Return a Latin hypercube sample of ``points`` points in the box, the same for the same seed: a start for solvers.

    Each coordinate has exactly one point in each of ``points`` intervals of equal width.
    """
    rng, n = np.random.default_rng(seed), problem.dimension
    order = rng.permuted(np.tile(np.arange(points)[:, None], (1, n)), axis=0)
    U = (order + rng.random((points, n))) / points
    return np.clip(problem.lower + U * (problem.upper - problem.lower), problem.lower, problem.upper)


def _result(meter: MeteredProblem, budget: Budget, runtime_s: float, status: Status, message: str) -> Minimum:
    """What the meter recorded, unless it contradicts the budget."""
    if (contradiction := meter.audit(budget)) is not None:
        status, message = Status.INVALID, contradiction
    population, values = meter.population, meter.population_values
    if population is not None and values is not None:
        order = np.argsort(values, kind="stable")
        population, values = population[order], values[order]
    return Minimum(
        x=np.full(meter.dimension, np.nan) if meter.best_point is None else meter.best_point,
        value=meter.best_value if isinstance(meter.best_value, float) else math.nan,
        evaluations=int(meter.evaluations),
        gradients=int(meter.gradients),
        nonfinite=int(meter.nonfinite),
        runtime_s=runtime_s,
        status=status,
        message=message,
        trace=meter.trace,
        population=population,
        population_values=values,
        reached=isinstance(meter.best_value, float) and meter.reached,
        evaluation_s=min(meter.spending.inside_s(meter.evaluations, meter.gradients), runtime_s),
        batches=meter.spending.batches,
        batched=meter.spending.batched,
    )


def _no_result(dimension: int, runtime_s: float, message: str, status: Status = Status.INVALID) -> Minimum:
    nothing = Recorder().trace(dimension, 0, runtime_s)
    return Minimum(np.full(dimension, np.nan), math.nan, 0, 0, 0, runtime_s, status, message, nothing)


def _run_solver(
    solver: Solver, meter: MeteredProblem, rng: np.random.Generator, start: ndarray | None
) -> tuple[Status, str]:
    """Run the solver and return the status and the message of the run."""
    if solver.info.needs_gradient and not meter.has_gradient:
        return Status.SKIPPED, f"{type(solver).__name__} needs a gradient, but the problem has none"
    try:
        if start is not None:
            meter.begin(start)
        solver.minimize(meter, rng)
    except BudgetExhausted:
        pass
    except Incompatible as error:
        return Status.SKIPPED, message_of(error)
    except MemoryError:
        raise  # concerns the whole run, which ends as crashed
    except Exception as error:
        if meter.fault is None:
            return Status.FAILED, explain(error)
    if meter.fault is not None:
        return Status.INVALID, meter.fault
    if not meter.evaluations:
        what = (
            "evaluated no point within the seconds of the budget"
            if meter.spent
            else "returned without evaluating a point"
        )
        return Status.FAILED, f"{type(solver).__name__} {what}"
    if meter.best_point is None:
        return Status.INVALID, f"none of {meter.evaluations} evaluations gave a finite value"
    if meter.nonfinite:
        return Status.OK, f"{meter.nonfinite} of {meter.evaluations} evaluations gave NaN or an infinite value"
    return Status.OK, ""
