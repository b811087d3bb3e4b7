"""Accuracy tests over all solvers, selected by what their ``info`` promises."""

from importlib.metadata import entry_points

import numpy as np
import pytest

from nfbench import Budget, Status, minimize
from nfbench.problems.functions import Functions

SOLVERS = {point.name: point.load() for point in entry_points(group="nfbench.solvers")}
SOLVERS = {name: cls for name, cls in SOLVERS.items() if not cls.info.extra}  # tested in test_extras.py
CONVERGING = [name for name, cls in SOLVERS.items() if cls.info.converges]
GLOBAL = [name for name, cls in SOLVERS.items() if cls.info.global_search]
BUDGET = 20_000


def gaps(solver, function, dimension, target, runs, **options):
    """Yield the final gap of each of several runs, each on its own instance."""
    scenario = Functions(function=function, dimension=dimension, **options)
    for seed in range(runs):
        instance = scenario.draw(np.random.default_rng(seed))
        minimum = minimize(instance.problem, solver, Budget(evaluations=BUDGET, target=target), seed)
        assert minimum.status is Status.OK
        yield instance.score(minimum.x)["gap"]


@pytest.mark.parametrize("name", CONVERGING)
def test_solvers_that_converge_reach_high_precision_in_one_valley(name):
    assert max(gaps(SOLVERS[name](), "sphere", 3, 1e-8, runs=2, rotated=True)) <= 1e-7


@pytest.mark.parametrize("name", sorted({*GLOBAL} & {*CONVERGING}))
def test_global_solvers_that_converge_find_the_deepest_of_many_valleys(name):
    """In two dimensions, the second-best valley of Rastrigin is 0.99 above the minimum."""
    found = sum(gap < 0.5 for gap in gaps(SOLVERS[name](), "rastrigin", 2, 0.4, runs=4, rotated=True))
    assert found >= 3


@pytest.mark.parametrize("name", GLOBAL)
def test_global_solvers_are_not_misled_by_a_distant_second_best_valley(name):
    """In two dimensions, Schwefel's second-best valley is 118 above the minimum, at the other end of the box."""
    found = sum(gap < 100 for gap in gaps(SOLVERS[name](), "schwefel", 2, 50, runs=4))
    assert found >= 3
