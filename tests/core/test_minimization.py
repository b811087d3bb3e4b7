"""Tests that minimize() returns a Minimum with the right status, whatever the solver does."""

import contextlib
import math
from dataclasses import dataclass

import numpy as np
import pytest

from nfbench import Budget, Incompatible, Problem, Solver, SolverInfo, Status, minimize


class Sphere(Problem):
    def __init__(self, n=2):
        self.lower, self.upper = np.full(n, -1.0), np.full(n, 1.0)

    def evaluate(self, X):
        return (X**2).sum(axis=1)


class Nowhere(Sphere):
    def evaluate(self, X):
        return np.full(len(X), math.nan)


@dataclass(frozen=True)
class Does(Solver):
    """Behaves as the option ``what`` says."""

    info = SolverInfo()
    what: str = ""

    def minimize(self, problem, rng):
        match self.what:
            case "forever":
                while True:
                    problem(rng.uniform(problem.lower, problem.upper))
            case "swallow":
                for _ in range(50):
                    with contextlib.suppress(Exception):
                        problem(problem.upper + 1)
            case "raise":
                problem(np.zeros(2))
                raise RuntimeError("no luck")
            case "early":
                problem(np.array([0.5, 0.5]))
            case "decline":
                raise Incompatible("only odd dimensions")
            case "nothing":
                pass


@dataclass(frozen=True)
class NeedsGradient(Solver):
    info = SolverInfo(needs_gradient=True)

    def minimize(self, problem, rng): ...


@pytest.mark.parametrize(
    ("what", "status", "evaluations", "message"),
    [
        ("forever", Status.OK, 100, ""),
        ("early", Status.OK, 1, ""),
        ("swallow", Status.INVALID, 0, "x[0]: expected a number within [-1.0, 1.0], got 2.0"),
        ("raise", Status.FAILED, 1, "RuntimeError: no luck (test_minimization.py:"),
        ("decline", Status.SKIPPED, 0, "only odd dimensions"),
        ("nothing", Status.FAILED, 0, "Does returned without evaluating a point"),
    ],
)
def test_each_way_to_end_has_its_status(what, status, evaluations, message):
    found = minimize(Sphere(), Does(what), 100)
    assert (found.status, found.evaluations) == (status, evaluations)
    assert found.message.startswith(message)


def test_a_minimization_without_a_finite_value_is_invalid():
    found = minimize(Nowhere(), Does("forever"), 7)
    assert (found.status, found.message) == (Status.INVALID, "none of 7 evaluations gave a finite value")
    assert np.isnan(found.x).all() and found.nonfinite == 7


def test_a_solver_that_needs_a_gradient_is_skipped_if_the_problem_has_none():
    assert minimize(Sphere(), NeedsGradient(), 5).status is Status.SKIPPED


def test_the_seed_determines_the_result():
    a, b, c = (minimize(Sphere(), Does("forever"), Budget(evaluations=50), seed) for seed in (1, 1, 2))
    assert a.x.tolist() == b.x.tolist() != c.x.tolist()
    assert a.value == float((a.x**2).sum())
