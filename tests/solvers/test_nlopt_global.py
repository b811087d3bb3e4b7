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
def test_the_process_wide_seed_is_set_anew_for_each_run(cls):
    first = evaluated(cls(), seed=3)
    nlopt.srand(99)
    evaluated(ISRES(), seed=4, budget=333)  # draws from the same generator
    assert_array_equal(evaluated(cls(), seed=3), first)


@pytest.mark.parametrize("cls", [CRS2LM, ESCH, ISRES, MLSL])
def test_population_is_passed_on(cls):
    assert_array_equal(evaluated(cls(population=17))[:1], evaluated(cls())[:1])
    assert not np.array_equal(evaluated(cls(population=17)), evaluated(cls()))


@pytest.mark.parametrize("cls", ALL)
def test_the_deeper_valley_is_found(cls):
    minimum = minimize(two_valleys(width=0.4), cls(), 3000, 2)
    assert minimum.status is Status.OK
    assert minimum.evaluations == 3000
    assert minimum.value < -1.95


@pytest.mark.parametrize("cls", ALL)
def test_infinite_values_break_none_of_them(cls):
    """DIRECT gives up and AGS crashes the process where NLopt is given +inf."""
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
def test_mlsl_every_local_search_sharpens(local):
    minimum = minimize(bowl(3), MLSL(local=local), 3000)
    assert minimum.evaluations == 3000
    assert minimum.value < 1e-10


def test_mlsl_looser_tolerances_leave_more_local_searches():
    tight, loose = bowl(2), bowl(2)
    exact = minimize(tight, MLSL(xtol=1e-12, ftol=0.0), 2000).value
    rough = minimize(loose, MLSL(xtol=1e-1), 2000).value
    assert exact < rough < 1e-2


def test_direct_variants_evaluate_the_centre_first_and_go_apart():
    runs = [evaluated(cls(), budget=300, n=5) for cls in (Direct, DirectL, DirectLRand)]
    for points in runs:
        np.testing.assert_allclose(points[0], 0.5)
    assert not np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[1], runs[2])


def test_what_they_cannot_do_is_declined_with_the_reason():
    minimum = minimize(bowl(11), AGS(), 100)
    assert (minimum.status, minimum.message) == (
        Status.SKIPPED,
        "AGS handles at most 10 unknowns, and the problem has 11",
    )
    assert minimize(bowl(10), AGS(), 100).status is Status.OK
    minimum = minimize(bowl(5), CRS2LM(population=5), 100)
    assert (minimum.status, minimum.message) == (
        Status.SKIPPED,
        "population: expected at least 6 for 5 unknowns, got 5",
    )
    assert minimize(bowl(5), CRS2LM(population=6), 100).status is Status.OK
