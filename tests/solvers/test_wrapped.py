"""Helpers of the library adapters: points outside the box, exceptions, planned evaluations, global random states."""

import random
import sys

import numpy as np
import pytest
from bench_problems import bowl

from nfbench import Budget, BudgetExhausted, InvalidEvaluation, MeteredProblem
from nfbench.solvers._wrapped import Stop, from_unit, global_random, planned


def meter(**budget):
    return MeteredProblem(bowl(), Budget(**{"evaluations": 10, **budget}))


def test_rounding_errors_are_clipped_and_points_outside_are_refused():
    problem = meter()
    assert np.array_equal(from_unit(problem, np.array([-1e-12, 1.0 + 1e-12])), [-1.0, 2.0])
    assert np.array_equal(from_unit(problem, np.array([[0.0, 0.5]])), [[-1.0, 0.5]])
    for outside in ([0.5, 1.01], [-0.01, 0.5], [0.5, np.nan]):
        with pytest.raises(InvalidEvaluation):
            problem(from_unit(problem, np.array(outside)))
    assert problem.evaluations == 0


def test_planned_evaluations_are_the_remaining_budget_or_the_horizon():
    problem = meter(evaluations=10)
    problem(problem.lower)
    assert planned(problem, 500) == 9
    unlimited = MeteredProblem(bowl(), Budget(seconds=60.0))
    unlimited(unlimited.lower)
    assert planned(unlimited, 500) == 500 < sys.maxsize


@pytest.mark.parametrize("library", ["passes", "swallows", "replaces", "continues"])
def test_the_exception_that_ends_a_run_is_preserved(library):
    stop, evaluated = Stop(), []

    def objective(x):
        evaluated.append(x)
        if x == 2:
            raise BudgetExhausted("over")
        return x

    guarded = stop.guard(objective)

    def run():
        for x in range(5):
            try:
                guarded(x)
            except BaseException as error:
                if library == "passes":
                    raise
                if library == "replaces":
                    raise RuntimeError("objective failed") from error
                if library == "swallows":
                    return

    with pytest.raises(BudgetExhausted, match="over"):
        stop.run(run)
    assert evaluated == [0, 1, 2]


def test_an_error_of_the_library_itself_is_raised():
    with pytest.raises(ZeroDivisionError):
        Stop().run(lambda: 1 / 0)


def test_global_random_states_are_seeded_and_restored():
    np.random.seed(5)  # noqa: NPY002
    random.seed(5)
    expected = np.random.random(), random.random()  # noqa: NPY002
    drawn = []
    for _ in range(2):
        np.random.seed(5)  # noqa: NPY002
        random.seed(5)
        with pytest.raises(BudgetExhausted), global_random(9):
            drawn.append((np.random.random(), random.random()))  # noqa: NPY002
            raise BudgetExhausted
        assert (np.random.random(), random.random()) == expected  # noqa: NPY002
    assert drawn[0] == drawn[1] != expected
