"""Tests that solvers which accept a start evaluate it first, and continue from it without evaluating it again."""

import numpy as np
import pytest

import nfbench
from nfbench import Budget, Problem, SolverInfo, Status
from nfbench.core import common_start
from nfbench.plugins import Registry

POPULATIONS = ("crowding-de", "de", "jade", "jso", "l-shade", "pso", "pygmo", "scipy-de", "shade")
POINTS = ("basin-hopping", "cmaes", "minionpy", "multistart-lbfgsb", "nlopt-crs2-lm", "nlopt-mlsl-lds")
OPTIONS = {"scipy-de": {"population": 12}, "pso": {"swarm": 12}, "pygmo": {"population": 12}}


class Recorded(Problem):
    """A shifted parabola that keeps every point it evaluates."""

    has_gradient = True

    def __init__(self):
        self.lower, self.upper = np.array([-2.0, -1.0, 0.0]), np.array([2.0, 5.0, 3.0])
        self.points = []

    def evaluate(self, X):
        self.points += X.tolist()
        return ((X - [0.3, 1.0, 2.0]) ** 2).sum(axis=1)

    def value_and_gradient(self, x):
        return float(self.evaluate(x[None])[0]), 2 * (x - [0.3, 1.0, 2.0])


def accepting():
    registry = Registry()
    names = [name for name in registry.names("solver") if not registry.find("solver", name).missing()]
    return [name for name in names if registry.make("solver", name, {}).info.accepts_start]


def make(name):
    options = {"population": 12} if name in ("crowding-de", "de", "jade", "jso", "l-shade", "shade") else {}
    return nfbench.solver(name, **options, **OPTIONS.get(name, {}))


@pytest.mark.parametrize("name", accepting())
def test_the_first_evaluations_are_the_given_sample(name):
    start = common_start(Recorded(), 20, seed=1)
    for seed in (1, 2):
        found = nfbench.minimize(problem := Recorded(), make(name), 150, seed, start=start)
        assert found.status is Status.OK, found.message
        assert problem.points[:20] == start.tolist()
        assert found.evaluations == len(problem.points) <= 150
        assert found.value <= ((start - [0.3, 1.0, 2.0]) ** 2).sum(axis=1).min()


@pytest.mark.parametrize("name", [name for name in POPULATIONS if name in accepting()])
def test_a_population_is_the_best_part_of_the_start_and_is_not_evaluated_again(name):
    start = common_start(Recorded(), 20, seed=1)
    found = nfbench.minimize(problem := Recorded(), make(name), 150, 3, start=start)
    assert not {tuple(x) for x in problem.points[20:]} & {tuple(x) for x in start.tolist()}
    assert found.evaluations > 20


@pytest.mark.parametrize("name", [name for name in POINTS if name in accepting()])
def test_a_single_starting_point_is_the_best_of_the_start(name):
    start = common_start(Recorded(), 20, seed=1)
    best = start[((start - [0.3, 1.0, 2.0]) ** 2).sum(axis=1).argmin()]
    nfbench.minimize(problem := Recorded(), make(name), 150, 3, start=start)
    nfbench.minimize(other := Recorded(), make(name), 150, 3, start=start[::-1])
    after = np.array(problem.points[20:])
    width = problem.upper - problem.lower
    if name == "cmaes":  # it samples around its start
        assert np.abs(((after[:70] - best) / width).mean(axis=0)).max() < 0.25
    elif name == "basin-hopping":
        assert np.allclose(after[0], best)
    else:
        assert np.isclose(after, best, atol=1e-9).all(axis=1).any()
    assert other.points[20:] == problem.points[20:]


def test_a_solver_that_accepts_no_start_says_so_before_it_evaluates():
    start = common_start(Recorded(), 20, seed=1)
    for name in ("nlopt-direct", "scipy-direct", "scipy-shgo", "nlopt-ags"):
        found = nfbench.minimize(problem := Recorded(), nfbench.solver(name), 100, start=start)
        assert found.status is Status.SKIPPED and found.message.endswith("does not accept a start")
        assert not problem.points


def test_the_solvers_that_need_evaluations_or_plan_for_them_are_known():
    def named(field):
        registry = Registry()
        names = registry.names("solver")
        usable = [name for name in names if not registry.find("solver", name).missing()]
        return {name for name in usable if getattr(registry.make("solver", name, {}).info, field)}

    assert named("needs_evaluations") == {"jso", "l-shade"}
    assert named("plans_evaluations") <= {"minionpy", "nevergrad"}
    inner = {"solver": {"kind": "l-shade"}}
    assert nfbench.solver("restarts", **inner).info.needs_evaluations
    assert not nfbench.solver("restarts", **inner, evaluations=100).info.needs_evaluations
    assert nfbench.solver("portfolio", solvers=[{"kind": "de"}, {"kind": "jso"}]).info.needs_evaluations
    assert not nfbench.solver("portfolio", solvers=[{"kind": "de"}]).info.needs_evaluations
    found = nfbench.minimize(Recorded(), nfbench.solver("restarts", **inner, evaluations=100), Budget(seconds=0.05))
    assert found.status is Status.OK and found.evaluations > 100
    assert SolverInfo().needs_evaluations is SolverInfo().accepts_start is False
