"""The result of minimizing one problem with one solver."""

from __future__ import annotations

import math
from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray

from .status import Status
from .trace import Trace

__all__ = ["Minimum"]


@dataclass(frozen=True)
class Minimum:
    """The result of a minimization.

    x: best point, (n,); NaN if no evaluation gave a finite value.
    value: objective value at ``x``; inf if no evaluation gave a finite value.
    evaluations: number of evaluations made.
    gradients: number of evaluations that also computed the gradient.
    nonfinite: number of evaluations that gave NaN or an infinite value.
    runtime_s: wall-clock time of the solver [s].
    status: how the minimization ended.
    message: explanation of the status; empty if there is nothing to explain.
    trace: improvements of the best value, thinned to fewer than 1,000 rows.
    population: last population of the solver, (p, n), best point first; None if the solver keeps no population.
    population_values: objective values of the population, (p,); None if the solver keeps no population.
    evaluation_s: part of ``runtime_s`` inside the problem [s], of single points from a sample; NaN if not known.
    batches: number of calls that evaluated a batch of points.
    batched: number of evaluations made in batches; the others were made one by one.
    reached: whether the best point meets the target of the budget; false if there is no target.
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
    reached: bool = False
    evaluation_s: float = math.nan
    batches: int = 0
    batched: int = 0
