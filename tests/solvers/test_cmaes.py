"""CMA-ES: restarts, population sizes, precision and side effects."""

import os
import warnings

import numpy as np
import pytest
from bench_problems import Formula, bowl, two_valleys
from numpy.testing import assert_allclose

from nfbench import OptionError, minimize
from nfbench.solvers.cmaes import CMAES


def sizes(problem):
    """Return the population sizes of the successive runs: the batch sizes without repetition."""
    lengths = [len(batch) for batch in problem.batches[:-1]]  # the budget truncates the last one
    return [a for a, b in zip(lengths, [None, *lengths], strict=False) if a != b]


def test_a_single_run_ends_by_itself_with_high_precision():
    problem = bowl(4)
    minimum = minimize(problem, CMAES(restarts="none"), 100_000)
    assert minimum.evaluations < 3000
    assert minimum.value < 1e-12
    assert sizes(problem) == [4 + int(3 * np.log(4))]


def test_ipop_doubles_the_population_in_every_run():
    problem = bowl(2)
    assert minimize(problem, CMAES(restarts="ipop", population=5), 10_000).evaluations == 10_000
    assert sizes(problem)[:4] == [5, 10, 20, 40]


def test_bipop_uses_as_many_evaluations_in_small_runs_as_in_large_ones():
    problem = bowl(3)
    minimize(problem, CMAES(restarts="bipop", population=7), 30_000)
    lengths = [len(batch) for batch in problem.batches[:-1]]
    record, spent, balances = 7, {"large": 0, "small": 0}, []
    for length in lengths[lengths.index(14) :]:
        if length > record:  # a large run starts, because the small runs have caught up
            assert length == 2 * record
            balances.append(dict(spent))
            record = length
        assert length == record or length <= record / 2
        spent["large" if length == record else "small"] += length
    assert len(balances) >= 5
    for balance in balances[1:]:
        assert balance["large"] <= balance["small"] < 1.6 * balance["large"]


def test_sigma0_is_the_spread_of_the_first_generation():
    spread = {}
    for sigma0 in (0.01, 0.1):
        problem = bowl(3)
        minimize(problem, CMAES(sigma0=sigma0, population=200), 200)
        spread[sigma0] = problem.points.std(axis=0, ddof=1).mean() / 3  # the box is 3 wide
    assert_allclose(spread[0.01], 0.01, rtol=0.15)
    assert_allclose(spread[0.1], 0.1, rtol=0.3)  # smaller near a bound


def test_restarts_find_the_narrow_valley_that_a_single_run_may_miss():
    missed = [minimize(two_valleys(width=0.2), CMAES(restarts="none"), 8000, seed).value > -1.5 for seed in range(6)]
    found = [minimize(two_valleys(width=0.2), CMAES(), 8000, seed).value < -1.5 for seed in range(6)]
    assert any(missed)
    assert all(found)


@pytest.mark.parametrize("seed", range(12))
def test_a_single_unknown_works_although_pycma_warns_about_it(seed):
    minimum = minimize(bowl(1), CMAES(), 1500, seed)
    assert minimum.status == "ok"
    assert minimum.evaluations == 1500
    assert minimum.value < 1e-12


def test_the_precision_does_not_depend_on_the_scale_of_the_values():
    for scale in (1e-9, 1.0, 1e9):
        problem = Formula(lambda X, scale=scale: scale * ((X - 0.3) ** 2).sum(axis=1) + 5 * scale, [-1, -1], [2, 2])
        minimum = minimize(problem, CMAES(restarts="none"), 20_000)
        assert_allclose(minimum.value, 5 * scale, rtol=1e-12)
        assert minimum.evaluations < 1000


def test_the_search_converges_despite_infinite_values():
    hole = Formula(lambda X: np.where(X[:, 0] > 0.5, np.nan, ((X - 0.3) ** 2).mean(axis=1)), [-1, -1], [2, 2])
    minimum = minimize(hole, CMAES(), 4000)
    assert minimum.status == "ok"
    assert minimum.nonfinite > 20
    assert minimum.value < 1e-12


def test_no_file_is_written_and_the_warning_filters_are_unchanged(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cma_signals.in").write_text("{'timeout': 0}")  # pycma would read this file and stop at once
    before = list(warnings.filters)
    assert minimize(bowl(3), CMAES(), 3000).evaluations == 3000
    assert warnings.filters == before
    assert os.listdir(tmp_path) == ["cma_signals.in"]  # noqa: PTH208


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma0": 0.0}, "sigma0: expected greater than 0, got 0.0"),
        ({"population": 1}, "population: expected greater than or equal to 2, got 1"),
        ({"restarts": "jpop"}, "restarts: expected 'none', 'ipop' or 'bipop', got 'jpop'"),
    ],
)
def test_invalid_options_are_named(options, message):
    with pytest.raises(OptionError) as caught:
        CMAES(**options)
    assert message in str(caught.value)
