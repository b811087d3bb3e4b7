"""Minimize one problem with one solver: what a study does for each run, and what a notebook needs."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .budget import Budget, Status
from .errors import BudgetExhausted, Incompatible
from .meter import MeteredProblem
from .problem import Problem
from .solver import Solver
from .trace import Trace

__all__ = ["Minimum", "minimize"]


@dataclass(frozen=True)
class Minimum:
    """What a solver found.

    x: (n,) the best point, NaN if no finite value was met. value: its objective. evaluations: how many were made;
    gradients: how many of them with the gradient; nonfinite: how many gave NaN or ±inf. runtime_s: wall-clock
    time [s]. status, message: how it ended. trace: every improvement, thinned to under 1,000 rows. population: (p, n)
    the solver's last population and population_values: (p,) its values, best first; None where it keeps none.
    """

    x: Float[ndarray, " n"]
    value: float
    evaluations: int
    gradients: int
    nonfinite: int
    runtime_s: float
    status: Status
    message: str
    trace: Trace
    population: Float[ndarray, "p n"] | None = None
    population_values: Float[ndarray, " p"] | None = None


def minimize(problem: Problem, solver: Solver, budget: Budget | int, seed: int | np.random.Generator = 0) -> Minimum:
    """Minimize ``problem`` with ``solver`` within ``budget`` (a Budget, or a number of evaluations).

    The result is a function of its arguments: ``seed`` seeds the only generator the solver has. What the solver
    raises becomes the status and message of the result; only a bad argument raises here (ValueError).
    """
    budget = Budget(evaluations=budget) if isinstance(budget, int) else budget
    solver.warm_up()
    meter = MeteredProblem(problem, budget)
    start = time.perf_counter()
    status, message = _drive(solver, meter, np.random.default_rng(seed))
    runtime_s = time.perf_counter() - start
    population, values = meter.population, meter.population_values
    if population is not None and values is not None:
        order = np.argsort(values, kind="stable")
        population, values = population[order], values[order]
    return Minimum(
        x=np.full(meter.dimension, np.nan) if meter.best_point is None else meter.best_point,
        value=meter.best_value,
        evaluations=meter.evaluations,
        gradients=meter.gradients,
        nonfinite=meter.nonfinite,
        runtime_s=runtime_s,
        status=status,
        message=message,
        trace=meter.trace,
        population=population,
        population_values=values,
    )


def _drive(solver: Solver, meter: MeteredProblem, rng: np.random.Generator) -> tuple[Status, str]:
    """Let the solver run; how it ended, and why."""
    if solver.info.needs_gradient and not meter.has_gradient:
        return Status.SKIPPED, f"{type(solver).__name__} needs a gradient and the problem has none"
    try:
        solver.minimize(meter, rng)
    except BudgetExhausted:
        pass
    except Incompatible as error:
        return Status.SKIPPED, str(error)
    except MemoryError:
        raise  # the run's, not the solver's: it ends as crashed
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
        return Status.OK, f"{meter.nonfinite} of {meter.evaluations} evaluations gave no finite value"
    return Status.OK, ""


def explain(error: BaseException) -> str:
    """An exception in one line: its type, its text, and the file and line it came from."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"
