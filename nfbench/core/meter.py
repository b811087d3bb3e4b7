"""The meter, through which a solver sees a problem. It counts the evaluations and enforces the budget."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from operator import le
from typing import final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .budget import Budget, objective_target
from .errors import BudgetExhausted, InvalidEvaluation
from .problem import Problem, check_box
from .spending import EVERY, Spending
from .starting import first_point, first_population
from .trace import Recorder, Trace

__all__ = ["MeteredProblem"]

_FLOAT64 = np.dtype(np.float64)
_SLICE_S, _SLICE_SHARE = 0.0005, 0.05  # a batch is divided near the deadline; time of one part: [s] + share of seconds
_SMALL = 32  # up to this dimension, a Python loop over the bounds is faster than NumPy


@final
class MeteredProblem(Problem):
    """Counts every evaluation of ``problem``, keeps the best point, and stops the solver at the budget.

    * No evaluation beyond the budget is made. A batch that would exceed the budget is truncated, the remaining
      evaluations are made, and BudgetExhausted is raised. Every later call raises BudgetExhausted too. A batch that
      will not end before the deadline is evaluated in parts, and it is truncated where the deadline has passed.
      BudgetExhausted is also raised instead of returning values if the solver would use them only after the deadline,
      judging by the time between its last two calls.
    * A point outside the box or of the wrong shape is not evaluated. The call raises InvalidEvaluation, and the run
      becomes ``invalid``. Evaluation never clips a point.
    * A value that is NaN or infinite is returned to the solver as +inf and never becomes the best value;
      ``nonfinite`` counts these values.
    * ``lower``, ``upper`` and ``best_point`` are read-only, and so are the counts and the best value. The solver may
      change the arrays that a call returns.
    * ``start`` holds the points that were evaluated before the solver began, for solvers that can continue from them.
    * Threads may share a meter: each of their evaluations counts, and none is made beyond the budget.
    """

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        reached: Callable[[Float[ndarray, " n"], float], bool] | None = None,
    ) -> None:
        self.lower, self.upper = check_box(problem.lower, problem.upper)
        self.has_gradient = problem.has_gradient  # type: ignore[misc]  # depends on the wrapped problem
        self.fault: str | None = None
        self.population: Float[ndarray, "p n"] | None = None
        self.population_values: Float[ndarray, " p"] | None = None
        self.start: Float[ndarray, "p n"] | None = None
        self.start_values: Float[ndarray, " p"] | None = None
        self._evaluations = self._gradients = self._nonfinite = 0
        self._best_value = math.inf
        self._best_point: Float[ndarray, " n"] | None = None
        self._spending = Spending()
        self._lock = threading.Lock()  # for the record of improvements
        self._problem = problem
        self._value = problem.value
        self._limit = budget.evaluations if budget.evaluations is not None else sys.maxsize
        self._reached = reached
        self._target = objective_target(problem, budget, reached)
        self._shape = self.lower.shape
        self._lower, self._upper = self.lower.tolist(), self.upper.tolist()
        self._lowers, self._uppers = self.lower[None], self.upper[None]  # one row per point, as broadcasting is slower
        self._small = len(self._lower) <= _SMALL
        self._recorder = Recorder()
        self._cost_s = math.inf  # time of one evaluation of the last batch; this and the following are for the deadline
        self._pause_s = 0.0  # time of the solver between its last two calls
        self._slice_s = _SLICE_S + _SLICE_SHARE * (budget.seconds or 0.0)
        self._start = self._returned = time.perf_counter()
        self._deadline = self._start + budget.seconds if budget.seconds is not None else None

    @property
    def evaluations(self) -> int:
        """Number of evaluations made."""
        return self._evaluations

    @property
    def gradients(self) -> int:
        """Number of evaluations that also gave the gradient."""
        return self._gradients

    @property
    def nonfinite(self) -> int:
        """Number of evaluations whose value was NaN or infinite."""
        return self._nonfinite

    @property
    def spending(self) -> Spending:
        """Batches made, and the time inside the problem."""
        return self._spending

    @property
    def best_value(self) -> float:
        """The smallest finite value so far; +inf before there is one."""
        return self._best_value

    @property
    def best_point(self) -> Float[ndarray, " n"] | None:
        """The first point with the best value; None before there is one."""
        return self._best_point

    @property
    def remaining(self) -> int:
        """Number of evaluations left; without a limit on evaluations, ``sys.maxsize`` minus those made."""
        return self._limit - self.evaluations

    @property
    def remaining_s(self) -> float:
        """Wall-clock time left [s], at least 0; infinity without a limit on seconds."""
        return math.inf if self._deadline is None else max(self._deadline - time.perf_counter(), 0.0)

    @property
    def reached(self) -> bool:
        """Whether the best point meets the target of the budget; false if there is no target."""
        return self.best_value <= self._target

    @property
    def spent(self) -> bool:
        """Whether the budget is used up or its target has been reached."""
        if self.evaluations >= self._limit or self.reached:
            return True
        return self._deadline is not None and time.perf_counter() >= self._deadline

    @property
    def seconds(self) -> float:
        """Wall-clock time [s] since the meter was created."""
        return time.perf_counter() - self._start

    @property
    def trace(self) -> Trace:
        """The improvements of the best value so far, thinned to fewer than 1,000 rows."""
        return self._recorder.trace(self.dimension, self.evaluations, self.seconds)

    def from_unit(self, U: Float[ndarray, "*p n"]) -> Float[ndarray, "*p n"]:
        """Map points of the unit box [0, 1]ⁿ to this box; the result is clipped, as rounding may cross an edge."""
        X = self.lower + U * (self.upper - self.lower)
        return np.minimum(np.maximum(X, self.lower, out=X), self.upper, out=X)  # np.clip takes three times as long

    def to_unit(self, X: Float[ndarray, "*p n"]) -> Float[ndarray, "*p n"]:
        """Map points of this box to the unit box [0, 1]ⁿ."""
        return (X - self.lower) / (self.upper - self.lower)

    def __call__(self, x: Float[ndarray, " n"]) -> float:
        """Evaluate one point ``(n,)`` and return its value."""
        if type(x) is not ndarray or x.dtype is not _FLOAT64:
            x = np.asarray(x, dtype=np.float64)
        self._check_point(x)
        if self._evaluations >= self._limit:  # another thread made the last evaluation since the check
            raise BudgetExhausted
        self._evaluations += 1  # before the evaluation; without a call since the comparison, threads cannot interleave
        number = self._evaluations
        value = self._value(x) if number % EVERY != 2 else self._spending.time_one(self._value, x)
        if type(value) is not float:
            value = self._scalar(value)
        if not self._best_value <= value < math.inf:  # the rare case; true for NaN
            value = self._record(number, x, value)
        if self._deadline is not None:
            self._look_ahead(self._deadline)
        return value

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        """Evaluate p points, one per row, and return their values."""
        X = np.asarray(X, dtype=np.float64)
        if X.ndim != 2 or X.shape[1:] != self._shape:
            self._reject(f"expected a batch of shape (p, {self.dimension}), got {X.shape}")
        if not len(X):
            return np.empty(0)
        self._check_budget()
        self._check_batch(X)
        self._spending.batches += 1
        return self._evaluate(X) if self._deadline is None else self._evaluate_until(self._deadline, X)

    def _evaluate(self, X: ndarray) -> ndarray:
        """Evaluate points that have been checked."""
        count, before = len(X), self._evaluations
        if count > self._limit - before:
            count = self._limit - before
        self._evaluations = before + count  # as for a single point: no call since ``before``
        batch = X[:count]
        if not len(batch):  # another thread made the last evaluation since the check
            raise BudgetExhausted
        clock = time.perf_counter()
        values = np.array(self._problem.evaluate(batch), dtype=np.float64)
        clock = time.perf_counter() - clock
        spending = self._spending
        spending.batched_s += clock
        spending.batched += count
        if values.shape != (len(batch),):
            self._reject(f"the problem: expected values of shape ({len(batch)},), got {values.shape}")
        smallest = values[values.argmin()]
        if not (smallest > -math.inf and values[values.argmax()] < math.inf):  # false for NaN too
            finite = np.isfinite(values)
            with self._lock:
                self._nonfinite += int(np.count_nonzero(~finite))
            values[~finite] = math.inf
            smallest = values.min()
        if smallest < self._best_value or not before:
            self._record_batch(before, batch, values)
        if len(batch) < len(X):
            raise BudgetExhausted
        return values

    def _evaluate_until(self, deadline: float, X: ndarray) -> ndarray:
        """Evaluate points that have been checked; in parts, unless half of the time left is expected to suffice."""
        parts, done, now = [], 0, time.perf_counter()
        while done < len(X):
            if done and (now >= deadline or self._evaluations >= self._limit):
                raise BudgetExhausted
            time_s = max(self._slice_s, 0.5 * (deadline - now))
            size = max(int(min(time_s / self._cost_s, len(X) - done)), 1)
            parts.append(self._evaluate(X[done : done + size]))
            done += size
            before, now = now, time.perf_counter()
            self._cost_s = max((now - before) / size, 1e-9)
        self._look_ahead(deadline)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def begin(self, start: Float[ndarray, "p n"]) -> None:
        """Evaluate the points from which the run starts, and keep them as ``start`` with ``start_values``."""
        values = self.evaluate(start)
        self.start, self.start_values = np.array(start, dtype=np.float64), values

    def first_population(
        self, size: int, rng: np.random.Generator
    ) -> tuple[Float[ndarray, "size n"], Float[ndarray, " size"]]:
        """Return an evaluated initial population ``(size, n)`` and its values ``(size,)``.

        It consists of the best points of ``start``, in their order, completed by uniform random points.
        """
        return first_population(self, size, rng)

    def first_point(self, rng: np.random.Generator) -> Float[ndarray, " n"]:
        """Return a point of the unit box (n,) to start at: the best of ``start``, or else a uniform random point."""
        return first_point(self, rng)

    def keep_population(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        """Keep the solver's current population and its values, for formulations that use more than the best point.

        Calling this method is optional. The arrays are not copied: a solver that updates the same arrays in place,
        each point together with its value, calls it once; a solver that creates new arrays calls it in every
        generation. All points must have been evaluated.
        """
        if X.ndim != 2 or X.shape[1:] != self._shape or values.shape != X.shape[:1]:
            self._reject(
                f"expected a population (p, {self.dimension}) and p values, got shapes {X.shape}, {values.shape}"
            )
        self.population, self.population_values = X, values
        if isinstance(self._problem, MeteredProblem):  # this meter was returned by part()
            self._problem.keep_population(X, values)

    def part(self, share: float = 1.0, evaluations: int | None = None) -> MeteredProblem:
        """Return a meter of this problem with a smaller budget, without ``start``.

        The new budget is the ``share``, in (0, 1], of the evaluations and seconds that are left here, and at most
        ``evaluations`` evaluations if that is given. The share of the evaluations is rounded, but is at least 1.
        Evaluations made through the new meter count here too. Raises BudgetExhausted if the budget is used up.
        """
        self._check_budget()
        limits = [] if evaluations is None else [evaluations]
        if self._limit < sys.maxsize:
            limits.append(max(round(share * self.remaining), 1))
        seconds = None if self._deadline is None else share * max(self._deadline - time.perf_counter(), 1e-9)
        return MeteredProblem(self, Budget(evaluations=min(limits, default=None), seconds=seconds))

    def value(self, x: Float[ndarray, " n"]) -> float:
        """Evaluate one point and return its value, as calling the meter does."""
        return self(x)

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """Return the value and the gradient at one point. This counts as one evaluation and one gradient."""
        x = np.asarray(x, dtype=np.float64)
        self._check_point(x)
        if self._evaluations >= self._limit:
            raise BudgetExhausted
        self._evaluations += 1
        number = self._evaluations
        clock = time.perf_counter()
        value, gradient = self._problem.value_and_gradient(x)
        clock = time.perf_counter() - clock
        with self._lock:
            self._gradients += 1
            self._spending.gradients_s += clock
        value = self._record(number, x, self._scalar(value))
        if self._deadline is not None:
            self._look_ahead(self._deadline)
        return value, np.array(gradient, dtype=np.float64)

    def audit(self, budget: Budget) -> str | None:
        """What contradicts the budget or the trace, if the solver wrote to this meter's private state; otherwise None.

        Nothing can be evaluated after this.
        """
        with self._lock:
            limit = sys.maxsize if budget.evaluations is None else budget.evaluations
            self._limit = self._deadline = 0  # a thread that the solver left running ends here
        return self._recorder.contradiction(self._evaluations, self._best_value, limit)

    def _check_point(self, x: ndarray) -> None:
        """Raise an exception if the budget is used up or the point is invalid."""
        self._check_budget()
        if x.shape != self._shape:
            self._reject(f"expected a point of shape {self._shape}, got {x.shape}")
        if self._small:
            point = x.tolist()
            inside = all(map(le, self._lower, point)) and all(map(le, point, self._upper))  # false for NaN too
        else:
            inside = bool((self.lower <= x).all() and (x <= self.upper).all())
        if not inside:
            self._reject(self._outside(x))

    def _check_batch(self, X: ndarray) -> None:
        """Raise an exception if any of the points lies outside the box."""
        if len(X) != len(self._lowers):
            self._lowers, self._uppers = (np.tile(bound, (len(X), 1)) for bound in (self.lower, self.upper))
        inside = np.logical_and(self._lowers <= X, self._uppers >= X)  # false for NaN too
        if np.count_nonzero(inside) < inside.size:
            self._reject(self._outside(X[~inside.all(axis=1)][0]))

    def _check_budget(self) -> None:
        if self._evaluations >= self._limit or self._best_value <= self._target:  # the same as ``spent``, but faster
            raise BudgetExhausted
        if self._deadline is not None:
            now = time.perf_counter()
            if now >= self._deadline:
                raise BudgetExhausted
            if self._evaluations:
                self._pause_s = now - self._returned
        if self.fault is not None:
            raise InvalidEvaluation(self.fault)

    def _look_ahead(self, deadline: float) -> None:
        """Raise BudgetExhausted if the solver's next call would come clearly after the deadline."""
        self._returned = time.perf_counter()
        if self._returned + self._pause_s > deadline + self._slice_s:
            self._deadline = self._start  # no call is accepted any more
            raise BudgetExhausted

    def _record(self, number: int, x: ndarray, value: float) -> float:
        """Record the value of the evaluation with this number; the value that the solver receives."""
        with self._lock:
            if not math.isfinite(value):
                self._nonfinite += 1
                value = math.inf
            if value < self._best_value or not self._recorder.rows:
                self._improve(number, x, value)
                self._judge()
        return value

    def _record_batch(self, before: int, batch: ndarray, values: ndarray) -> None:
        """Record each improvement with its position in the batch, as if the points had been evaluated one by one."""
        with self._lock:
            best_before = np.minimum.accumulate(np.concatenate([[self._best_value], values[:-1]]))
            improved = values < best_before
            improved[0] |= not self._recorder.rows
            for i in np.flatnonzero(improved):
                self._improve(before + int(i) + 1, batch[i], float(values[i]))
            self._judge()

    def _judge(self) -> None:
        """Apply the predicate ``reached`` to the best point, and end the run if it is true."""
        if self._reached is not None and self._best_point is not None:
            self._target = math.inf if self._reached(self._best_point, self._best_value) else -math.inf

    def _improve(self, number: int, x: ndarray, value: float) -> None:
        point = x.copy()
        point.flags.writeable = False
        if value < math.inf:
            self._best_value, self._best_point = value, point
        rows = self._recorder.rows
        number = max(number, rows[-1][0]) if rows else number  # a thread may be late
        self._recorder.add(number, self.seconds, value, point)

    def _scalar(self, value: object) -> float:
        array = np.asarray(value, dtype=np.float64)
        if array.ndim:
            self._reject(f"the problem: expected one number for one point, got shape {array.shape}")
        return float(array)

    def _outside(self, x: ndarray) -> str:
        j = int(np.flatnonzero(~((self.lower <= x) & (x <= self.upper)))[0])
        return f"x[{j}]: expected a number within [{self._lower[j]!r}, {self._upper[j]!r}], got {float(x[j])!r}"

    def _reject(self, fault: str) -> None:
        """Raise InvalidEvaluation and keep the fault, so that it counts even if a library swallows the exception."""
        self.fault = self.fault or fault
        if isinstance(self._problem, MeteredProblem):  # this meter was returned by part()
            self._problem._reject(fault)
        raise InvalidEvaluation(fault)
