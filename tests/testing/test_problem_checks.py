"""Problems and scenarios that each break one rule: the check of that rule must fail with the reason."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from nfbench import Instance, Problem, ProblemInstance, Scenario
from nfbench.plugins.registry import Registry
from nfbench.problems.functions import Direct, Functions
from nfbench.testing import check_problem, check_scenario, problem_checks, scenario_check_names, scenario_checks
from nfbench.testing.scenario_checks import solved_by


class Good(Problem):
    """Mean of (x_j - c_j)² over [-1, 2]ⁿ."""

    has_gradient = True

    def __init__(self, centre):
        self.centre = np.asarray(centre, dtype=float)
        self.lower, self.upper = -np.ones(len(centre)), 2.0 * np.ones(len(centre))

    def evaluate(self, X):
        return ((X - self.centre) ** 2).mean(axis=1)

    def value_and_gradient(self, x):
        return float(self.evaluate(x[None])[0]), 2.0 * (x - self.centre) / len(x)


class Unbounded(Good):
    def __init__(self, centre):
        super().__init__(centre)
        self.upper[0] = np.inf


class Swapped(Good):
    def __init__(self, centre):
        super().__init__(centre)
        self.lower, self.upper = self.upper, self.lower


class Column(Good):
    def evaluate(self, X):
        return super().evaluate(X)[:, None]


class EdgeNaN(Good):
    def evaluate(self, X):
        with np.errstate(all="ignore"):
            return super().evaluate(X) + 0.0 * np.log(X[:, 0] + 1.0)


class Flat(Good):
    has_gradient = False

    def evaluate(self, X):
        return np.ones(len(X))


class AcrossRows(Good):
    def evaluate(self, X):
        return ((X - self.centre) ** 2).mean(axis=1) / np.abs(X).max()


class Noisy(Good):
    def evaluate(self, X):
        return super().evaluate(X) + 1e-12 * np.random.standard_normal(len(X))  # noqa: NPY002


class Greedy(Good):
    def evaluate(self, X):
        X -= self.centre
        return (X**2).mean(axis=1)


class WrongSign(Good):
    def value_and_gradient(self, x):
        value, gradient = super().value_and_gradient(x)
        return value, -gradient


class WrongScale(Good):
    def value_and_gradient(self, x):
        value, gradient = super().value_and_gradient(x)
        return value, gradient * 1.001


class WrongValue(Good):
    def value_and_gradient(self, x):
        value, gradient = super().value_and_gradient(x)
        return value + 1.0, gradient


def failed(results):
    return {result.name: result.message for result in results if not result.passed}


@pytest.mark.parametrize(
    ("cls", "check", "words"),
    [
        (Unbounded, "box", "upper to be a vector of finite numbers"),
        (Swapped, "box", "lower < upper"),
        (Column, "values", "one value per row: shape (64,)"),
        (EdgeNaN, "values", "a number everywhere in the box, including its faces and corners, got nan at x = [-1.0"),
        (Flat, "values", "values that differ between points, got 1.0 at each"),
        (AcrossRows, "batch", "Treat each row of X independently"),
        (Noisy, "repeats", "the same values when the same points are evaluated again, got different values"),
        (Greedy, "input-unchanged", "Copy X before you change it"),
        (WrongSign, "gradient", "check its sign"),
        (WrongScale, "gradient", "the gradient to equal central differences"),
        (WrongValue, "gradient", "value_and_gradient to return the value"),
    ],
)
def test_a_problem_that_breaks_a_rule_fails_its_check(cls, check, words):
    messages = failed(problem_checks(cls([0.3, 0.9, 1.4])))
    assert words in messages[check], messages
    with pytest.raises(AssertionError, match=f"{cls.__name__} fails"):
        check_problem(cls([0.3, 0.9, 1.4]))


def test_a_good_problem_and_the_test_functions_pass():
    check_problem(Good([0.3, 0.9, 1.4]))
    for function in ("sphere", "rosenbrock", "rastrigin", "ackley", "griewank", "schwefel"):
        check_scenario(Functions(function=function, dimension=3, rotated=True), [Direct()])


# --- scenarios --------------------------------------------------------------------------------------------------------


class Hidden(ProblemInstance):
    def __init__(self, centre):
        self.problem = Good(centre)

    def truth(self):
        return self.problem.centre

    def score(self, estimate):
        if np.shape(estimate) != np.shape(self.problem.centre):
            raise ValueError("shape")
        return {"error": float(np.linalg.norm(estimate - self.problem.centre))}


@dataclass(frozen=True)
class Fine(Scenario):
    """A point to find.

    dimension: number of coordinates of the point.
    """

    instance: ClassVar[type[Instance]] = Hidden
    error: ClassVar[str] = "error"
    dimension: int = 2

    def draw(self, rng):
        return Hidden(rng.random(self.dimension))


def test_a_good_scenario_passes_every_check():
    results = list(scenario_checks(Fine(), [Direct()]))
    assert [result.name for result in results] == scenario_check_names()
    assert failed(results) == {}


class Lenient(Hidden):
    def score(self, estimate):
        return {"error": 0.5}


class Mistaken(Hidden):
    def truth(self):
        return self.problem.centre + 0.1


class Renamed(Hidden):
    def score(self, estimate):
        return {"eror": super().score(estimate)["error"]}


class GoodElsewhere(Instance):
    def score(self, estimate):
        return {"error": 0.0}


def drawing(cls, **more):
    @dataclass(frozen=True)
    class Own(Fine):
        """A point to find.

        dimension: number of coordinates of the point.
        """

        instance: ClassVar[type[Instance]] = more.get("instance", cls)

        def draw(self, rng):
            rng = more.get("rng", rng)
            return cls(rng.random(self.dimension) if rng else np.random.random(self.dimension))  # noqa: NPY002

    return Own()


@pytest.mark.parametrize(
    ("scenario", "check", "words"),
    [
        (drawing(Lenient), "score", "expected score to raise ValueError for an estimate of the wrong shape"),
        (drawing(Mistaken), "truth", "error of the truth to be 0, got 0.14"),
        (drawing(Renamed), "score", "a dict that contains 'error', by which methods are ranked, got {'eror'"),
        (drawing(Hidden, instance=GoodElsewhere), "draw", "draw to return a GoodElsewhere, as declared by `instance`"),
        (drawing(Hidden, rng=None), "same-seed", "the same problems from the same seed"),
        (drawing(Hidden, rng=None), "global-random-untouched", "rng.normal() instead of np.random.normal()"),
        (drawing(Hidden, rng=np.random.default_rng(3)), "same-seed", "use no state of the class or the module"),
    ],
)
def test_a_scenario_that_breaks_a_rule_fails_its_check(scenario, check, words):
    messages = failed(scenario_checks(scenario, [Direct()]))
    assert words in messages[check], messages


def test_a_scenario_whose_truth_is_drawn_alone_must_have_the_errors_of_the_scene():
    other = drawing(Hidden)
    type(other).draw_truth = lambda self, rng, number: self.draw(np.random.default_rng(7))
    words = failed(scenario_checks(other, [Direct()]))["truth"]
    assert "draw_truth to give the same error as draw_scene" in words
    type(other).draw_truth = lambda self, rng, number: self.draw(rng)
    assert "truth" not in failed(scenario_checks(other, [Direct()]))


def test_a_scenario_without_a_formulation_fails_with_a_hint():
    messages = failed(scenario_checks(Fine(), []))
    hint = "Derive the instance from nfbench.ProblemInstance, which the formulation `direct` solves"
    assert hint in messages["formulations"]


def test_formulations_are_found_by_the_instances_they_accept():
    registry = Registry()
    assert [type(formulation).__name__ for formulation in solved_by(registry, Fine())] == ["Direct"]
    names = {type(formulation).__name__ for formulation in solved_by(registry, Functions())}
    assert names == {"Direct"}


def test_the_global_random_states_are_restored():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    list(scenario_checks(Fine(), [Direct()]))
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
