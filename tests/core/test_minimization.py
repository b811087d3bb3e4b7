"""Tests that minimize() returns a Minimum with the right status, whatever the solver does."""

import contextlib
import math
from dataclasses import dataclass

import numpy as np
import pytest

from nfbench import Budget, Incompatible, Problem, Solver, SolverInfo, Status, minimize
from nfbench.core import budget_problem, budget_warning, common_start


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


@dataclass(frozen=True)
class Plans(Does):
    """A solver whose search depends on the number of evaluations in the budget."""

    info = SolverInfo(needs_evaluations=True, plans_evaluations=True)


@dataclass(frozen=True)
class Continues(Solver):
    """Evaluates points around the best one of its start."""

    info = SolverInfo(accepts_start=True)

    def minimize(self, problem, rng):
        u = problem.first_point(rng)
        while True:
            problem(problem.from_unit(np.clip(u + rng.uniform(-0.1, 0.1, len(u)), 0.0, 1.0)))


def test_a_solver_that_needs_a_budget_of_evaluations_is_skipped_without_one():
    found = minimize(Sphere(), Plans("early"), Budget(seconds=1.0))
    assert (found.status, found.evaluations) == (Status.SKIPPED, 0)
    assert found.message.startswith("Plans needs a limit on evaluations")
    assert minimize(Sphere(), Plans("early"), Budget(seconds=1.0, evaluations=5)).status is Status.OK
    assert budget_problem(Plans(), Budget(evaluations=5)) is None and budget_problem(Does(), Budget(seconds=1)) is None
    assert "horizon" in budget_warning(Plans(), Budget(seconds=1.0))
    assert budget_warning(Plans(), Budget(evaluations=5)) is None is budget_warning(Does(), Budget(seconds=1.0))


def test_the_start_is_evaluated_first_and_the_solver_continues_from_its_best_point():
    start = common_start(Sphere(), 20, seed=4)
    found = minimize(Sphere(), Continues(), 60, start=start)
    best = (start**2).sum(axis=1)
    assert found.trace.values[0] == best[0] and found.value <= best.min()
    at_start = found.trace.values[found.trace.evaluations <= 20]
    assert at_start[-1] == best.min()
    assert np.abs(found.x - start[best.argmin()]).max() <= 0.2 + 1e-12  # 0.1 of the width of the box


def test_a_start_larger_than_the_budget_is_all_that_is_evaluated():
    found = minimize(Sphere(), Continues(), 7, start=common_start(Sphere(), 20, seed=4))
    assert (found.status, found.evaluations) == (Status.OK, 7)


def test_a_solver_that_accepts_no_start_is_skipped_and_a_start_outside_the_box_is_invalid():
    start = np.zeros((3, 2))
    found = minimize(Sphere(), Does("forever"), 10, start=start)
    assert (found.status, found.message) == (Status.SKIPPED, "Does does not accept a start")
    found = minimize(Sphere(), Continues(), 10, start=start + 2)
    assert (found.status, found.evaluations) == (Status.INVALID, 0)


@pytest.mark.parametrize("points", [1, 2, 50])
def test_a_common_start_is_a_latin_hypercube(points):
    problem = Sphere(3)
    X = common_start(problem, points, [7, 0])
    cells = np.sort(np.floor((X + 1.0) / 2.0 * points), axis=0)
    np.testing.assert_array_equal(cells, np.tile(np.arange(points)[:, None], (1, 3)))
    np.testing.assert_array_equal(X, common_start(problem, points, [7, 0]))
    assert not np.array_equal(X, common_start(problem, points, [7, 1]))


def test_a_gap_ends_the_run_where_the_minimum_is_known():
    class Shifted(Sphere):
        minimum = 3.0

        def evaluate(self, X):
            return super().evaluate(X) + 3.0

    free = minimize(Shifted(), Does("forever"), 500)
    first = free.trace.evaluations[free.trace.values - 3.0 <= 0.1][0]
    found = minimize(Shifted(), Does("forever"), Budget(evaluations=500, target={"gap": 0.1}))
    assert found.reached and found.evaluations == first < 500 and found.value - 3.0 <= 0.1
    assert not free.reached
    found = minimize(Sphere(), Does("forever"), Budget(evaluations=500, target={"gap": 0.1}))
    assert (found.status, found.message) == (Status.SKIPPED, "target.gap: no reference optimum is known for Sphere")
    with pytest.raises(ValueError, match="needs the function `reached`"):
        minimize(Sphere(), Does("forever"), Budget(evaluations=500, target={"error": 0.1}))


def test_a_predicate_replaces_the_target():
    found = minimize(Sphere(), Does("forever"), 500, reached=lambda x, value: abs(x[0]) < 0.05)
    assert found.reached and found.evaluations < 500 and abs(found.x[0]) < 0.05


def test_an_exception_of_the_predicate_is_the_message_of_the_run():
    def reached(x, value):
        raise RuntimeError("no estimate")

    found = minimize(Sphere(), Does("forever"), 500, reached=reached)
    assert found.status is Status.FAILED and found.message.startswith("RuntimeError: no estimate")
