"""The solvers of SciPy: options, stopping rules and accuracy."""

import typing

import numpy as np
import pytest
from bench_problems import Formula, bowl, ramp, two_valleys
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import OptionError, Status, minimize
from nfbench.solvers.scipy_de import ScipyDE
from nfbench.solvers.scipy_direct import ScipyDirect
from nfbench.solvers.scipy_dual_annealing import ScipyDualAnnealing
from nfbench.solvers.scipy_shgo import ScipySHGO

STRATEGIES = typing.get_args(typing.get_type_hints(ScipyDE)["strategy"])


def unit(points):
    """Map points of [-1, 2]ⁿ to [0, 1]ⁿ."""
    return (points + 1) / 3


@pytest.mark.parametrize("n", [1, 4])
def test_de_population_is_an_absolute_number_and_evaluated_in_one_batch(n):
    problem = bowl(n)
    minimize(problem, ScipyDE(population=23), 23 * 40)
    assert {len(batch) for batch in problem.batches} == {23}


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_de_every_strategy_converges_in_one_valley(strategy):
    assert minimize(bowl(2), ScipyDE(strategy=strategy, population=30), 6000).value < 1e-6


def test_de_every_option_changes_the_points():
    def points(**options):
        problem = bowl(3)
        minimize(problem, ScipyDE(population=10, **options), 100)
        return problem.points

    default = points()
    for other in ({"strategy": "rand1bin"}, {"mutation": 0.3}, {"recombination": 0.1}, {"init": "uniform"}):
        assert not np.array_equal(points(**other), default)
    assert_array_equal(points(), default)


def test_de_latin_hypercube_fills_every_row_and_column():
    problem = bowl(3)
    minimize(problem, ScipyDE(population=20), 20)
    cells = np.sort((unit(problem.points) * 20).astype(int), axis=0)
    assert_array_equal(cells, np.tile(np.arange(20)[:, None], 3))


def test_de_tolerance_ends_the_run_and_polishing_is_counted():
    raised = Formula(lambda X: 1 + ((X - 0.3) ** 2).sum(axis=1), [-1, -1, -1], [2, 2, 2])
    plain = minimize(raised, ScipyDE(tol=0.01, polish=False), 50_000)
    polished = minimize(raised, ScipyDE(tol=0.01), 50_000)
    assert plain.evaluations < polished.evaluations < 2000
    assert 1 <= polished.value < 1 + 1e-12 < plain.value


def test_de_without_tolerance_ends_early_only_if_all_values_are_equal():
    slanted = minimize(ramp(2), ScipyDE(strategy="rand1bin"), 3000)
    assert slanted.evaluations == 3000
    flat = minimize(Formula(lambda X: np.ones(len(X)), [0.0], [1.0]), ScipyDE(polish=False), 3000)
    assert flat.evaluations == 100  # the initial population and one generation


def test_dual_annealing_finds_the_deeper_valley_and_local_search_refines_it():
    rough = minimize(two_valleys(), ScipyDualAnnealing(local_search=False), 20_000)
    sharp = minimize(two_valleys(), ScipyDualAnnealing(), 20_000)
    assert rough.evaluations == sharp.evaluations == 20_000
    assert sharp.value <= rough.value < -1.9


def test_dual_annealing_ends_if_no_value_is_finite():
    nothing = Formula(lambda X: np.full(len(X), np.nan), [0.0], [1.0])
    minimum = minimize(nothing, ScipyDualAnnealing(), 5000)
    assert minimum.status is Status.INVALID
    assert minimum.message == "none of 1001 evaluations gave a finite value"


def test_dual_annealing_does_not_catch_a_value_error_of_the_problem():
    def broken(X):
        raise ValueError("no such source")

    minimum = minimize(Formula(broken, [0.0], [1.0]), ScipyDualAnnealing(), 5000)
    assert minimum.status is Status.FAILED
    assert "no such source" in minimum.message


def test_direct_starts_in_the_centre_and_converges_without_tolerances():
    problem = bowl(2)
    minimum = minimize(problem, ScipyDirect(), 3000)
    assert_allclose(problem.points[0], 0.5)
    assert minimum.evaluations == 3000
    assert minimum.value < 1e-20


def test_direct_locally_biased_variant_converges_faster_on_a_bowl():
    local, original = bowl(5), bowl(5)
    biased = minimize(local, ScipyDirect(), 2000).value
    plain = minimize(original, ScipyDirect(locally_biased=False), 2000).value
    assert biased < plain < 0.1


def test_direct_max_evaluations_ends_the_run():
    minimum = minimize(bowl(2), ScipyDirect(max_evaluations=500), 3000)
    assert minimum.status is Status.OK
    assert 500 <= minimum.evaluations < 700  # SciPy completes the current division


@pytest.mark.parametrize("sampling", ["simplicial", "sobol", "halton"])
@pytest.mark.parametrize("local", ["SLSQP", "L-BFGS-B"])
def test_shgo_finds_the_narrow_valley(sampling, local):
    minimum = minimize(two_valleys(), ScipySHGO(points=64, sampling=sampling, local=local), 1500)
    assert minimum.evaluations == 1500
    assert minimum.value < -1.99


def test_shgo_samplings_differ_and_sobol_uses_a_power_of_two():
    first = {}
    for sampling in ("simplicial", "sobol", "halton"):
        problem = ramp(2)
        minimize(problem, ScipySHGO(points=9, sampling=sampling), 9)
        first[sampling] = unit(problem.points)
    assert {(0.0, 0.0), (1.0, 1.0), (0.5, 0.5)} <= {tuple(u) for u in first["simplicial"]}  # two corners and the centre
    assert_allclose((first["sobol"] * 16) % 1, 0, atol=1e-9)
    assert not np.allclose((first["halton"] * 16) % 1, 0, atol=1e-9)


@pytest.mark.parametrize("sampling", ["sobol", "halton"])
def test_shgo_declines_a_triangulation_that_would_take_too_long(sampling):
    minimum = minimize(bowl(4), ScipySHGO(sampling=sampling), 100)
    assert minimum.status is Status.SKIPPED
    assert minimum.message == (
        f"sampling='{sampling}': expected at most 3 unknowns, because it triangulates its points, got 4; "
        'use sampling="simplicial"'
    )


@pytest.mark.parametrize(
    ("cls", "options", "message"),
    [
        (ScipyDE, {"population": 4}, "population: expected greater than or equal to 5, got 4"),
        (ScipyDE, {"mutation": (0.9, 0.1)}, "mutation: expected (low, high) with low <= high, got (0.9, 0.1)"),
        (ScipyDE, {"mutation": 2.5}, "mutation: expected less than or equal to 2"),
        (ScipyDE, {"strategy": "best3bin"}, "strategy: expected 'best1bin'"),
        (ScipyDualAnnealing, {"visit": 1.0}, "visit: expected greater than 1, got 1.0"),
        (ScipyDualAnnealing, {"accept": 0.0}, "accept: expected less than or equal to -5, got 0.0"),
        (ScipyDirect, {"eps": 0.0}, "eps: expected greater than 0, got 0.0"),
        (ScipySHGO, {"sampling": "grid"}, "sampling: expected 'simplicial', 'sobol' or 'halton', got 'grid'"),
    ],
)
def test_invalid_options_are_named(cls, options, message):
    with pytest.raises(OptionError) as caught:
        cls(**options)
    assert message in str(caught.value)
