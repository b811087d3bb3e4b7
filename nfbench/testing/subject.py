"""The solver under test, run in the same way as in a study, and the exceptions by which a check fails."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import warnings
from typing import Any

import numpy as np

from nfbench.core import Budget, Incompatible, Minimum, Solver, Status, minimize

from .probe import Probe

DIMENSIONS = (2, 5, 1, 10, 40)


class Failed(Exception):
    """Raised when a check fails; the message addresses the author of the solver."""


class Broken(ValueError):
    """An error that a probe raises, to check that the solver does not catch it."""


def need(condition: object, expected: str, got: str, remedy: str) -> None:
    """Raise Failed, with what was expected, what came and how to fix it, unless ``condition`` is true."""
    if not condition:
        raise Failed(f"expected {expected}, got {got}. {remedy}")


@dataclasses.dataclass(frozen=True)
class Subject:
    """The solver under test."""

    solver: Solver

    @functools.cached_property
    def dimension(self) -> int:
        """The first of ``DIMENSIONS`` that the solver accepts; raises Incompatible if it declines all of them."""
        for n in DIMENSIONS:
            outcome = self.run(self.probe(n), 1).minimum
            if outcome.status is not Status.SKIPPED:
                return n
        raise Incompatible(f"the solver declines every dimension of {DIMENSIONS}: {outcome.message}")

    def probe(self, n: int | None = None, shape: str = "bowl", **more: Any) -> Probe:
        """Return a probe in n dimensions (default: ``dimension``) whose bounds are not binary fractions."""
        n = self.dimension if n is None else n
        lower, upper = np.resize([-1 / 3, 0.1, -7.7], n), np.resize([0.7, 3.3, 0.1], n)
        return Probe(lower, upper, shape, **{"gradient": self.solver.info.needs_gradient, **more})

    def run(self, probe: Probe, budget: Budget | int, seed: int = 1) -> Outcome:
        """Minimize the probe in the same way as a study does, and capture warnings and output."""
        printed = io.StringIO()
        with (
            warnings.catch_warnings(record=True) as caught,
            contextlib.redirect_stdout(printed),
            contextlib.redirect_stderr(printed),
        ):
            warnings.simplefilter("always")
            minimum = minimize(probe, self.solver, budget, seed)
        return Outcome(minimum, [f"{w.category.__name__}: {w.message}" for w in caught], printed.getvalue())


@dataclasses.dataclass(frozen=True)
class Outcome:
    """The result of a run, its warnings, and what it printed."""

    minimum: Minimum
    warnings: list[str]
    printed: str


def ended_ok(outcome: Outcome, where: str) -> None:
    """Fail unless the run ended with status ok; raise Incompatible if the solver declined the problem."""
    minimum = outcome.minimum
    if minimum.status is Status.SKIPPED:
        raise Incompatible(minimum.message)
    need(minimum.status is Status.OK, f"status ok {where}", f"{minimum.status}: {minimum.message}", _FIX_STATUS)


_FIX_STATUS = (
    "Run nfbench.minimize(problem, solver, budget) on that case and fix the reported problem; if the algorithm cannot "
    "handle the case, raise Incompatible with the reason."
)
