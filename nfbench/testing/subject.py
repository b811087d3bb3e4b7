"""The solver under test, run as a study runs it, and how a check says that it failed."""

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
    """A check failed; the message is for the solver's author."""


class Broken(ValueError):
    """What a probe raises as an error of its own."""


def need(condition: object, expected: str, got: str, mend: str) -> None:
    if not condition:
        raise Failed(f"expected {expected}, got {got}. {mend}")


@dataclasses.dataclass(frozen=True)
class Subject:
    """The solver under test."""

    solver: Solver

    @functools.cached_property
    def dimension(self) -> int:
        """The first dimension the solver does not decline; Incompatible with its reason where it declines all."""
        for n in DIMENSIONS:
            outcome = self.run(self.probe(n), 1).minimum
            if outcome.status is not Status.SKIPPED:
                return n
        raise Incompatible(f"declines every dimension tried, {DIMENSIONS}: {outcome.message}")

    def probe(self, n: int | None = None, shape: str = "bowl", **more: Any) -> Probe:
        """A probe in n dimensions within bounds that no binary fraction hits."""
        n = self.dimension if n is None else n
        lower, upper = np.resize([-1 / 3, 0.1, -7.7], n), np.resize([0.7, 3.3, 0.1], n)
        return Probe(lower, upper, shape, **{"gradient": self.solver.info.needs_gradient, **more})

    def run(self, probe: Probe, budget: Budget | int, seed: int = 1) -> Outcome:
        """Minimize the probe as a study does, with what it leaks caught."""
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
    minimum: Minimum
    warnings: list[str]
    printed: str


def ended_ok(outcome: Outcome, where: str) -> None:
    minimum = outcome.minimum
    if minimum.status is Status.SKIPPED:
        raise Incompatible(minimum.message)
    need(minimum.status is Status.OK, f"status ok {where}", f"{minimum.status}: {minimum.message}", _MEND_STATUS)


_MEND_STATUS = (
    "Run nfbench.minimize(problem, solver, budget) on that case and mend what the message names; a case that the "
    "algorithm cannot handle raises Incompatible with the reason."
)
