"""Test functions: values, gradients, minima, and the random shift and rotation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, OptionError, minimize
from nfbench.problems.functions import SHAPES, Direct, FunctionProblem, Functions
from nfbench.solvers.de import DE

NAMES = list(SHAPES)
VARIANTS = [(False, False), (True, False), (False, True), (True, True)]


def drawn(name, n=3, shifted=True, rotated=True, seed=0) -> FunctionProblem:
    scenario = Functions(function=name, dimension=n, shifted=shifted, rotated=rotated)
    return scenario.draw(np.random.default_rng(seed)).problem


@pytest.mark.parametrize(
    ("name", "point", "value"),
    [  # by hand from the textbook formulas
        ("sphere", [1, -2], 5),
        ("rosenbrock", [0, 0], 1),
        ("rosenbrock", [-1, 1], 4),
        ("rosenbrock", [2, 3], 101),
        ("rastrigin", [1, 1], 2),
        ("rastrigin", [0.5, 0], 20.25),
        ("ackley", [1, 1], 20 - 20 * np.exp(-0.2)),
        ("griewank", [np.pi, 0], 2 + np.pi**2 / 4000),
        ("schwefel", [0, 0], 2 * 418.9828872724338),
        ("schwefel", [(np.pi / 2) ** 2, 0], 2 * 418.9828872724338 - (np.pi / 2) ** 2),
    ],
)
def test_unmoved_functions_have_the_textbook_values(name, point, value):
    problem = drawn(name, n=2, shifted=False, rotated=False)
    assert_allclose(problem.value(np.array(point, dtype=float)), value, rtol=1e-13)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("shifted", "rotated"), VARIANTS)
@pytest.mark.parametrize("n", [2, 5, 20])
def test_the_optimum_is_inside_the_box_with_value_and_gradient_zero(name, shifted, rotated, n):
    for seed in range(5):
        problem = drawn(name, n, shifted, rotated, seed)
        width = problem.upper - problem.lower
        assert (problem.optimum > problem.lower + 0.05 * width).all()
        assert (problem.optimum < problem.upper - 0.05 * width).all()
        value, gradient = problem.value_and_gradient(problem.optimum)
        assert_allclose(value, 0, atol=1e-12 * n)
        assert_allclose(gradient, 0, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "n"), [(name, n) for name in NAMES for n in (1, 2, 6) if (name, n) != ("rosenbrock", 1)]
)
@pytest.mark.parametrize(("shifted", "rotated"), VARIANTS)
def test_no_point_of_the_box_has_a_value_below_the_optimum(name, shifted, rotated, n):
    rng = np.random.default_rng(n)
    for seed in range(5):
        problem = drawn(name, n, shifted, rotated, seed)
        X = rng.uniform(problem.lower, problem.upper, (10_000, n))
        X[:3000] = np.where(rng.random((3000, n)) < 0.5, X[:3000], problem.upper)  # faces and corners
        X[3000:5000] = np.clip(problem.optimum + 0.01 * (X[3000:5000] - problem.optimum), problem.lower, problem.upper)
        values = problem.evaluate(X)
        far = np.abs(X - problem.optimum).max(axis=1) > 1e-3
        assert values.min() > -1e-9
        assert values[far].min() > 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("shifted", "rotated"), VARIANTS)
def test_gradient_agrees_with_central_differences(name, shifted, rotated):
    problem = drawn(name, 4, shifted, rotated)
    rng = np.random.default_rng(3)
    width = problem.upper - problem.lower
    for x in rng.uniform(problem.lower, problem.upper, (50, 4)):
        value, gradient = problem.value_and_gradient(x)
        h = 1e-6 * width[0]
        steps = h * np.eye(4)
        differences = (problem.evaluate(x + steps) - problem.evaluate(x - steps)) / (2 * h)
        assert_allclose(value, problem.evaluate(x[None, :])[0], rtol=1e-13)
        assert_allclose(gradient, differences, rtol=1e-5, atol=1e-4 * np.abs(differences).max())


@pytest.mark.parametrize("name", NAMES)
def test_shift_and_rotation_move_the_function_without_changing_it(name):
    n = 3
    plain, moved = drawn(name, n, False, False), drawn(name, n, True, True, seed=4)
    z = np.random.default_rng(0).uniform(plain.lower, plain.upper, (100, n))
    x = (z - plain.optimum) @ moved.rotation + moved.optimum
    assert_allclose(moved.evaluate(x), plain.evaluate(z), rtol=1e-9, atol=1e-9)
    assert_allclose(moved.rotation @ moved.rotation.T, np.eye(n), atol=1e-14)


def test_schwefel_beyond_its_domain_rises_above_its_edge():
    problem = drawn("schwefel", 1, False, False)
    edge = problem.value(np.array([500.0]))
    outside = problem.evaluate(np.array([[500.1], [600.0], [-1100.0]]))
    assert_allclose(outside[0], edge + 0.01 * 0.1**2, rtol=1e-12)
    assert_allclose(outside[1], edge + 100, rtol=1e-12)
    assert (outside > 0).all()


def test_a_draw_depends_only_on_the_generator_and_shift_and_rotation_are_independent():
    first, second = drawn("ackley", seed=8), drawn("ackley", seed=8)
    assert_array_equal(first.optimum, second.optimum)
    assert_array_equal(first.rotation, second.rotation)
    assert_array_equal(drawn("ackley", rotated=False, seed=8).optimum, first.optimum)
    assert_array_equal(drawn("ackley", shifted=False, seed=8).rotation, first.rotation)
    assert not np.allclose(drawn("ackley", seed=9).optimum, first.optimum)


def test_scores_are_the_gap_and_the_relative_distance():
    instance = Functions(function="sphere", dimension=2, rotated=True).draw(np.random.default_rng(1))
    problem = instance.problem
    assert instance.score(problem.optimum) == {"gap": 0.0, "distance": 0.0}
    score = instance.score(problem.optimum + np.array([3.0, 4.0]))
    assert_allclose(score["gap"], 25, rtol=1e-12)
    assert_allclose(score["distance"], 5 / (10.24 * np.sqrt(2)), rtol=1e-12)
    with pytest.raises(ValueError, match=r"expected shape \(2,\), got \(3,\)"):
        instance.score(np.zeros(3))


def test_direct_minimizes_the_instances_problem_once():
    instance = Functions(function="rastrigin", dimension=2).draw(np.random.default_rng(1))
    problems = []

    def solve(problem):
        problems.append(problem)
        return minimize(problem, DE(), Budget(evaluations=8000), 0)

    estimate = Direct().solve(instance, solve)
    assert problems == [instance.problem]
    assert instance.score(estimate)["gap"] < 1e-8
    assert issubclass(Functions.instance, Direct.accepts) and Functions.instance is type(instance)


def test_rosenbrock_needs_two_unknowns():
    with pytest.raises(OptionError, match="expected at least 2 for rosenbrock, got 1"):
        Functions(function="rosenbrock", dimension=1)
