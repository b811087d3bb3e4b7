"""The meter: a problem as a solver sees it, counted and limited."""

from __future__ import annotations

import math
import sys
import time
from operator import le
from typing import final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .budget import Budget
from .errors import BudgetExhausted, InvalidEvaluation
from .problem import Problem, check_box
from .trace import Recorder, Trace

__all__ = ["MeteredProblem"]

_FLOAT64 = np.dtype(np.float64)
_SMALL = 32  # up to this dimension a Python loop over the bounds is faster than NumPy's


@final
class MeteredProblem(Problem):
    """Counts every evaluation of ``problem``, keeps the best point, and stops the solver at the budget.

    * The evaluation beyond the budget is never made: a batch that would cross it is cut, evaluated up to the
      budget, and BudgetExhausted is raised; so it is on every later call.
    * A point outside the box, or of a wrong shape, is not evaluated: InvalidEvaluation, and the run is ``invalid``.
      Nothing is clipped.
    * A value that is NaN or infinite reaches the solver as +inf and never becomes the best; ``nonfinite`` counts them.
    * ``lower``, ``upper`` and the arrays it keeps are read-only; what it returns is the solver's own.
    """

    def __init__(self, problem: Problem, budget: Budget) -> None:
        self.lower, self.upper = check_box(problem.lower, problem.upper)
        self.has_gradient = problem.has_gradient  # type: ignore[misc]  # the instance speaks for what it wraps
        self.evaluations = 0
        self.gradients = 0
        self.nonfinite = 0
        self.best_value = math.inf
        self.best_point: Float[ndarray, " n"] | None = None
        self.fault: str | None = None
        self.population: Float[ndarray, "p n"] | None = None
        self.population_values: Float[ndarray, " p"] | None = None
        self._problem = problem
        self._value = problem.value
        self._limit = budget.evaluations if budget.evaluations is not None else sys.maxsize
        self._target = budget.target if budget.target is not None else -math.inf
        self._shape = self.lower.shape
        self._lower, self._upper = self.lower.tolist(), self.upper.tolist()
        self._lowers, self._uppers = self.lower[None], self.upper[None]  # a row a point: faster than to broadcast
        self._small = len(self._lower) <= _SMALL
        self._recorder = Recorder()
        self._start = time.perf_counter()
        self._deadline = self._start + budget.seconds if budget.seconds is not None else None

    @property
    def remaining(self) -> int:
        """Evaluations left; ``sys.maxsize`` less those made where the budget does not count them."""
        return self._limit - self.evaluations

    @property
    def spent(self) -> bool:
        """Whether the budget is used up, or its target reached."""
        if self.evaluations >= self._limit or self.best_value <= self._target:
            return True
        return self._deadline is not None and time.perf_counter() >= self._deadline

    @property
    def seconds(self) -> float:
        """Wall-clock time since the meter was made [s]."""
        return time.perf_counter() - self._start

    @property
    def trace(self) -> Trace:
        """Every improvement so far, thinned to under 1,000 rows."""
        return self._recorder.trace(self.dimension, self.evaluations, self.seconds)

    def from_unit(self, U: Float[ndarray, "*p n"]) -> Float[ndarray, "*p n"]:
        """Points of the unit box [0, 1]ⁿ as points of this box, safe against rounding past its edge."""
        X = self.lower + U * (self.upper - self.lower)
        return np.minimum(np.maximum(X, self.lower, out=X), self.upper, out=X)  # np.clip takes three times as long

    def to_unit(self, X: Float[ndarray, "*p n"]) -> Float[ndarray, "*p n"]:
        """Points of this box as points of the unit box [0, 1]ⁿ."""
        return (X - self.lower) / (self.upper - self.lower)

    def __call__(self, x: Float[ndarray, " n"]) -> float:
        """The value at one point ``(n,)``."""
        if type(x) is not ndarray or x.dtype is not _FLOAT64:
            x = np.asarray(x, dtype=np.float64)
        self._admit(x)
        value = self._value(x)
        if type(value) is not float:
            value = self._scalar(value)
        if self.best_value <= value < math.inf:  # as almost all are; false for NaN
            self.evaluations += 1
            return value
        return self._note(x, value)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        """The values at p points, one a row."""
        X = np.asarray(X, dtype=np.float64)
        if X.ndim != 2 or X.shape[1:] != self._shape:
            self._refuse(f"expected a batch of shape (p, {self.dimension}), got {X.shape}")
        if not len(X):
            return np.empty(0)
        self._check_budget()
        if len(X) != len(self._lowers):
            self._lowers, self._uppers = (np.tile(bound, (len(X), 1)) for bound in (self.lower, self.upper))
        inside = np.logical_and(self._lowers <= X, self._uppers >= X)  # false for NaN too
        if np.count_nonzero(inside) < inside.size:
            self._refuse(self._outside(X[~inside.all(axis=1)][0]))
        batch = X[: self.remaining]
        values = np.array(self._problem.evaluate(batch), dtype=np.float64)
        if values.shape != (len(batch),):
            self._refuse(f"the problem: expected values of shape ({len(batch)},), got {values.shape}")
        least = values[values.argmin()]
        if not (least > -math.inf and values[values.argmax()] < math.inf):  # false for NaN too
            finite = np.isfinite(values)
            self.nonfinite += int(np.count_nonzero(~finite))
            values[~finite] = math.inf
            least = values.min()
        self._note_batch(batch, values, least)
        if len(batch) < len(X):
            raise BudgetExhausted
        return values

    def keep_population(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        """Remember the solver's present population and its values, for formulations that look at more than the best.

        Optional. No copy is made: a solver that goes on in these arrays, changing a point and its value together, says
        so once; one with new arrays each generation says so each time. Points must have been evaluated.
        """
        if X.ndim != 2 or X.shape[1:] != self._shape or values.shape != X.shape[:1]:
            self._refuse(f"expected a population (p, {self.dimension}) with p values, got {X.shape} and {values.shape}")
        self.population, self.population_values = X, values
        if isinstance(self._problem, MeteredProblem):  # this is a part of it
            self._problem.keep_population(X, values)

    def part(self, share: float = 1.0, evaluations: int | None = None) -> MeteredProblem:
        """This problem with less to spend: a ``share`` in (0, 1] of what is left, and of ``evaluations`` at most.

        What a solver evaluates on the part counts here too. The share of evaluations is rounded, to 1 at least.
        Raises BudgetExhausted where nothing is left.
        """
        self._check_budget()
        limits = [] if evaluations is None else [evaluations]
        if self._limit < sys.maxsize:
            limits.append(max(round(share * self.remaining), 1))
        seconds = None if self._deadline is None else share * max(self._deadline - time.perf_counter(), 1e-9)
        return MeteredProblem(self, Budget(evaluations=min(limits, default=None), seconds=seconds))

    def value(self, x: Float[ndarray, " n"]) -> float:
        """The same as calling the meter: the value at one point."""
        return self(x)

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """The value and gradient at one point; counts as one evaluation, and in ``gradients``."""
        x = np.asarray(x, dtype=np.float64)
        self._admit(x)
        value, gradient = self._problem.value_and_gradient(x)
        self.gradients += 1
        return self._note(x, self._scalar(value)), np.array(gradient, dtype=np.float64)

    def _admit(self, x: ndarray) -> None:
        """Let one point through, or raise."""
        self._check_budget()
        if x.shape != self._shape:
            self._refuse(f"expected a point of shape {self._shape}, got {x.shape}")
        if self._small:
            point = x.tolist()
            inside = all(map(le, self._lower, point)) and all(map(le, point, self._upper))  # false for NaN too
        else:
            inside = bool((self.lower <= x).all() and (x <= self.upper).all())
        if not inside:
            self._refuse(self._outside(x))

    def _check_budget(self) -> None:
        if self.evaluations >= self._limit or self.best_value <= self._target:  # ``spent``, written out as it is faster
            raise BudgetExhausted
        if self._deadline is not None and time.perf_counter() >= self._deadline:
            raise BudgetExhausted
        if self.fault is not None:
            raise InvalidEvaluation(self.fault)

    def _note(self, x: ndarray, value: float) -> float:
        self.evaluations += 1
        if not math.isfinite(value):
            self.nonfinite += 1
            value = math.inf
        if value < self.best_value or self.evaluations == 1:
            self._improve(self.evaluations, x, value)
        return value

    def _note_batch(self, batch: ndarray, values: ndarray, least: float) -> None:
        """Trace each improvement at its own place within the batch, as if evaluated one by one."""
        before = self.evaluations
        self.evaluations += len(values)
        if least >= self.best_value and before:
            return
        best_before = np.minimum.accumulate(np.concatenate([[self.best_value], values[:-1]]))
        improved = values < best_before
        improved[0] |= before == 0
        for i in np.flatnonzero(improved):
            self._improve(before + int(i) + 1, batch[i], float(values[i]))

    def _improve(self, evaluation: int, x: ndarray, value: float) -> None:
        point = x.copy()
        point.flags.writeable = False
        if value < math.inf:
            self.best_value, self.best_point = value, point
        self._recorder.add(evaluation, self.seconds, value, point)

    def _scalar(self, value: object) -> float:
        array = np.asarray(value, dtype=np.float64)
        if array.ndim:
            self._refuse(f"the problem: expected one number for one point, got shape {array.shape}")
        return float(array)

    def _outside(self, x: ndarray) -> str:
        j = int(np.flatnonzero(~((self.lower <= x) & (x <= self.upper)))[0])
        return f"x[{j}]: expected a number within [{self._lower[j]!r}, {self._upper[j]!r}], got {float(x[j])!r}"

    def _refuse(self, fault: str) -> None:
        """Remember the fault, so that it counts even if a library swallows the exception."""
        self.fault = self.fault or fault
        if isinstance(self._problem, MeteredProblem):  # this is a part of it
            self._problem._refuse(fault)
        raise InvalidEvaluation(fault)
