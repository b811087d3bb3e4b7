"""NLopt's global algorithms: seeding, options, infinite values, and the problems that an algorithm declines."""

import nlopt
import numpy as np
import pytest
from bench_problems import Formula, bowl, two_valleys
from numpy.testing import assert_array_equal

from nfbench import Status, minimize
from nfbench.solvers.nlopt_global import AGS, CRS2LM, ESCH, ISRES, MLSL, Direct, DirectL, DirectLRand

ALL = [AGS, CRS2LM, ESCH, ISRES, MLSL, Direct, DirectL, DirectLRand]


def evaluated(solver, seed=0, budget=400, n=2):
    problem = bowl(n)
    minimize(problem, solver, budget, seed)
    return problem.points


@pytest.mark.parametrize("cls", ALL)
def test_the_process_wide_generator_is_seeded_for_each_run(cls):
    first = evaluated(cls(), seed=3)
    nlopt.srand(99)
    evaluated(ISRES(), seed=4, budget=333)  # uses the same generator
    assert_array_equal(evaluated(cls(), seed=3), first)


@pytest.mark.parametrize("cls", [CRS2LM, ESCH, ISRES, MLSL])
def test_the_population_option_reaches_nlopt(cls):
    assert_array_equal(evaluated(cls(population=17))[:1], evaluated(cls())[:1])
    assert not np.array_equal(evaluated(cls(population=17)), evaluated(cls()))


@pytest.mark.parametrize("cls", ALL)
def test_the_deeper_valley_is_found(cls):
    minimum = minimize(two_valleys(width=0.4), cls(), 3000, 2)
    assert minimum.status is Status.OK
    assert minimum.evaluations == 3000
    assert minimum.value < -1.95


@pytest.mark.parametrize("cls", ALL)
def test_every_algorithm_works_with_infinite_values(cls):
    """Without a replacement for +inf, DIRECT would give up and AGS would crash the process."""
    hole = Formula(lambda X: np.where(np.abs(X[:, 0] - 0.5) < 0.9, np.nan, X.sum(axis=1)), [-1, -1], [2, 2])
    minimum = minimize(hole, cls(), 5000, 1)
    assert minimum.status is Status.OK
    assert minimum.evaluations == 5000
    assert minimum.nonfinite > 10
    assert minimum.value < -1.9
    nothing = Formula(lambda X: np.full(len(X), np.nan), [-1, -1], [2, 2])
    minimum = minimize(nothing, cls(), 500)
    assert minimum.status is Status.INVALID
    assert minimum.evaluations == 500


@pytest.mark.parametrize("local", ["sbplx", "nelder-mead", "bobyqa"])
def test_mlsl_converges_with_every_local_search(local):
    minimum = minimize(bowl(3), MLSL(local=local), 3000)
    assert minimum.evaluations == 3000
    assert minimum.value < 1e-10


def test_mlsl_with_looser_tolerances_is_less_precise():
    tight, loose = bowl(2), bowl(2)
    exact = minimize(tight, MLSL(xtol=1e-12, ftol=0.0), 2000).value
    rough = minimize(loose, MLSL(xtol=1e-1), 2000).value
    assert exact < rough < 1e-2


def test_direct_variants_evaluate_the_centre_first_and_then_differ():
    runs = [evaluated(cls(), budget=300, n=5) for cls in (Direct, DirectL, DirectLRand)]
    for points in runs:
        np.testing.assert_allclose(points[0], 0.5)
    assert not np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[1], runs[2])


def test_unsuitable_problems_are_declined_with_the_reason():
    minimum = minimize(bowl(11), AGS(), 100)
    assert (minimum.status, minimum.message) == (
        Status.SKIPPED,
        "nlopt-ags: expected a problem with at most 10 unknowns, got 11",
    )
    assert minimize(bowl(10), AGS(), 100).status is Status.OK
    minimum = minimize(bowl(5), CRS2LM(population=5), 100)
    assert (minimum.status, minimum.message) == (
        Status.SKIPPED,
        "population: expected at least 6 for 5 unknowns, got 5",
    )
    assert minimize(bowl(5), CRS2LM(population=6), 100).status is Status.OK
