"""Random search, multistart L-BFGS-B, and the replacement of infinite values."""

import math

import numpy as np
import pytest
from bench_problems import Formula, bowl, ramp, two_valleys
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Status, minimize
from nfbench.problems.functions import Functions
from nfbench.solvers._finite import Finite
from nfbench.solvers.multistart_lbfgsb import MultistartLBFGSB
from nfbench.solvers.random_search import RandomSearch


def test_random_search_is_uniform_and_its_points_do_not_depend_on_the_batch():
    runs = []
    for batch in (1, 256, 5000):
        problem = bowl(2)
        minimize(problem, RandomSearch(batch=batch), 4000, 5)
        runs.append(problem.points)
    assert_array_equal(runs[0], runs[1])
    assert_array_equal(runs[0], runs[2])
    counts, *_ = np.histogram2d(*runs[0].T, bins=4, range=[[-1, 2], [-1, 2]])
    assert counts.sum() == 4000
    assert np.abs(counts - 250).max() < 5 * math.sqrt(250)


def rosenbrock(n=4):
    return Functions(function="rosenbrock", dimension=n, rotated=True).draw(np.random.default_rng(0)).problem


@pytest.mark.parametrize("gradient", ["auto", "difference"])
def test_lbfgsb_converges_in_a_curved_valley(gradient):
    minimum = minimize(rosenbrock(2), MultistartLBFGSB(gradient=gradient), 3000)
    assert minimum.evaluations == 3000
    assert minimum.value < 1e-6


def test_lbfgsb_analytic_gradients_cost_one_evaluation_and_differences_n_plus_one():
    own = minimize(rosenbrock(4), MultistartLBFGSB(starts=1), 10_000)
    assert own.gradients == own.evaluations < 1000
    problem = Formula(rosenbrock(4).evaluate, rosenbrock(4).lower, rosenbrock(4).upper)
    without = minimize(problem, MultistartLBFGSB(starts=1), 10_000)
    assert without.gradients == 0
    assert {len(batch) for batch in problem.batches} == {5}
    forced = minimize(rosenbrock(4), MultistartLBFGSB(starts=1, gradient="difference"), 10_000)
    assert forced.gradients == 0
    assert forced.evaluations == without.evaluations


def test_lbfgsb_differences_step_along_each_axis():
    problem = bowl(3)
    minimize(problem, MultistartLBFGSB(starts=1, step=1e-3), 4)
    base, *others = problem.points
    assert_allclose(np.array(others) - base, 3e-3 * np.eye(3), atol=1e-15)  # the box is 3 wide


def test_lbfgsb_differences_step_inwards_at_the_upper_corner():
    problem = ramp(3)
    minimum = minimize(problem, MultistartLBFGSB(starts=3), 10_000)
    assert minimum.status is Status.OK
    assert problem.points.max() == 2.0
    assert_allclose(minimum.value, -6, atol=1e-12)


def test_lbfgsb_starts_are_counted_and_independent():
    values = [minimize(two_valleys(), MultistartLBFGSB(starts=1), 10_000, seed).value for seed in range(12)]
    assert min(values) < -1.9 < max(values)  # a single start may find either valley
    best = minimize(two_valleys(), MultistartLBFGSB(starts=40), 10_000)
    assert best.evaluations < 10_000
    assert best.value < -1.99


def test_lbfgsb_restarts_after_a_start_on_a_plateau_of_infinity():
    hole = Formula(lambda X: np.where(X[:, 0] > -0.4, np.nan, ((X + 0.7) ** 2).sum(axis=1)), [-1, -1], [2, 2])
    minimum = minimize(hole, MultistartLBFGSB(), 1000)
    assert minimum.status is Status.OK
    assert minimum.nonfinite > 0
    assert minimum.value < 1e-12


def test_infinity_is_replaced_by_the_worst_finite_value():
    finite = Finite(start=7.0)
    assert finite.one(math.inf) == 7.0
    assert finite.one(-3.0) == -3.0
    assert finite.one(math.inf) == -3.0
    assert_array_equal(finite.many(np.array([1.0, math.inf, 2.0])), [1.0, 2.0, 2.0])
    assert_array_equal(finite.many(np.array([0.0, math.inf])), [0.0, 2.0])
    assert_array_equal(Finite(start=0.0).many(np.array([math.inf, math.inf])), [0.0, 0.0])
