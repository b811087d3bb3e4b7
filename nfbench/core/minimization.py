"""Minimizes one problem with one solver. Studies use this function for their runs, and notebooks can call it too."""

from __future__ import annotations

import math
import time

import numpy as np

from .budget import Budget
from .errors import BudgetExhausted, Incompatible, explain, message_of
from .meter import MeteredProblem
from .minimum import Minimum
from .problem import Problem
from .solver import Solver
from .status import Status
from .trace import Recorder

__all__ = ["minimize"]


def minimize(problem: Problem, solver: Solver, budget: Budget | int, seed: int | np.random.Generator = 0) -> Minimum:
    """Minimize ``problem`` with ``solver`` within ``budget``, which is a Budget or a number of evaluations.

    The solver draws all random numbers from one generator, seeded with ``seed`` or given as ``seed``, so the same
    arguments give the same result. An exception raised by the solver is returned as the status and message of the
    result, except for MemoryError and exceptions such as KeyboardInterrupt, which are passed on. Raises ValueError if
    the budget or the bounds of the problem are invalid.
    """
    budget = Budget(evaluations=budget) if isinstance(budget, int) else budget
    solver.warm_up()
    meter = MeteredProblem(problem, budget)
    dimension = meter.dimension
    start = time.perf_counter()
    status, message = _run_solver(solver, meter, np.random.default_rng(seed))
    runtime_s = time.perf_counter() - start
    try:
        return _result(meter, budget, runtime_s, status, message)
    except MemoryError:
        raise
    except Exception as error:  # the solver wrote to private attributes of the meter
        message = f"the solver damaged the meter: {explain(error)}"
        return _no_result(dimension, runtime_s, message)


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
    )


def _no_result(dimension: int, runtime_s: float, message: str) -> Minimum:
    nothing = Recorder().trace(dimension, 0, runtime_s)
    return Minimum(np.full(dimension, np.nan), math.nan, 0, 0, 0, runtime_s, Status.INVALID, message, nothing)


def _run_solver(solver: Solver, meter: MeteredProblem, rng: np.random.Generator) -> tuple[Status, str]:
    """Run the solver and return the status and the message of the run."""
    if solver.info.needs_gradient and not meter.has_gradient:
        return Status.SKIPPED, f"{type(solver).__name__} needs a gradient, but the problem has none"
    try:
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
        return Status.FAILED, f"{type(solver).__name__} returned without evaluating a point"
    if meter.best_point is None:
        return Status.INVALID, f"none of {meter.evaluations} evaluations gave a finite value"
    if meter.nonfinite:
        return Status.OK, f"{meter.nonfinite} of {meter.evaluations} evaluations gave NaN or an infinite value"
    return Status.OK, ""
