"""Helpers for wrapped libraries: points, planned evaluations, global random numbers, and exceptions."""

from __future__ import annotations

import contextlib
import random
import sys
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Budget, BudgetExhausted, MeteredProblem, Problem, Solver

__all__ = ["Stop", "from_unit", "global_random", "planned", "rehearse"]

ROUNDING = 1e-9  # in widths of the box; a point farther outside is an error of the library

T = TypeVar("T")

_rehearsed: set[tuple[type[Solver], str]] = set()


@final
class _Sphere(Problem):
    """The problem of a rehearsal."""

    has_gradient = True

    def __init__(self) -> None:
        self.lower, self.upper = np.full(2, -1.0), np.full(2, 2.0)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        return np.asarray((X**2).sum(axis=1))

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        return float(x @ x), 2.0 * x


def rehearse(solver: Solver, evaluations: int = 200) -> None:
    """Run the solver once per process and algorithm on a small problem, for its method ``warm_up``.

    Libraries load modules, compile and build tables when they are first used; this takes up to a second, which would
    otherwise count as time of the first run.
    """
    key = type(solver), str(getattr(solver, "algorithm", ""))
    if key in _rehearsed:
        return
    _rehearsed.add(key)
    with contextlib.suppress(Exception, BudgetExhausted):  # a real run reports its errors
        solver.minimize(MeteredProblem(_Sphere(), Budget(evaluations=evaluations)), np.random.default_rng(0))


def from_unit(problem: MeteredProblem, U: Float[ndarray, "*p n"]) -> Float[ndarray, "*p n"]:
    """Map points of the unit box to the problem's box, and clip rounding errors at its bounds.

    A point that lies outside by more than rounding is not clipped silently: it is mapped unchanged, so that the meter
    rejects it.
    """
    if np.all((U >= -ROUNDING) & (U <= 1.0 + ROUNDING)):
        return problem.from_unit(U)
    return np.asarray(problem.lower + U * (problem.upper - problem.lower))


def planned(problem: MeteredProblem, horizon: int) -> int:
    """Return the number of evaluations to plan for: what remains of the budget or, if it has no limit, ``horizon``."""
    return problem.remaining if problem.remaining < sys.maxsize // 2 else horizon


@contextlib.contextmanager
def global_random(seed: int) -> Iterator[None]:
    """Seed the global generators of Python and NumPy within this context, and restore their states afterwards."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


@final
class Stop:
    """Preserves an exception of the objective if the library catches it or replaces it by another exception.

    Wrap the objective with ``guard`` and call the library through ``run``. After the first exception the objective
    raises the same exception again at once, so that nothing is evaluated after the end.
    """

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def guard(self, objective: Callable[..., T]) -> Callable[..., T]:
        """Return the objective wrapped so that its first exception is stored and raised by every later call."""

        def guarded(*arguments: Any) -> T:
            if self.error is not None:
                raise self.error
            try:
                return objective(*arguments)
            except BaseException as error:
                self.error = error
                raise

        return guarded

    def run(self, library: Callable[[], object]) -> None:
        """Call the library, then raise the exception of the objective if there was one."""
        try:
            library()
        except BaseException:
            if self.error is None:
                raise
        if self.error is not None:
            raise self.error
