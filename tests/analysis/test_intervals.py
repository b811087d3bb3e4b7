"""Intervals: reference values, edge cases, and the coverage that docs/intervals.md promises."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binomtest, quantile_test

from nfbench.analysis import intervals
from nfbench.analysis.intervals import (
    bounded_mean_interval,
    ecdf_band,
    ecdf_pointwise,
    ert,
    ert_interval,
    mean_pvalue,
    quantile_interval,
    ratio_interval,
    rms_of_solved_interval,
    share_interval,
    variance_components,
)

INF, NAN = math.inf, math.nan
D = np.array([0.5, -0.3, 0.8, 0.2, 1.1, 0.9, -0.1, 0.4, 0.7, 0.6])
LONGER = np.append(D, [0.3, 0.35, 1.3, -0.2, 0.05])
SPENT = np.array([1000, 2000, 1500, 10000, 3000, 2500, 10000, 800, 1200, 4000])
HITS = np.array([1, 1, 1, 0, 1, 1, 0, 1, 1, 1])


def simulations():
    """The module tests/benchmarks/interval_coverage.py."""
    path = Path(__file__).parents[1] / "benchmarks" / "interval_coverage.py"
    spec = importlib.util.spec_from_file_location("interval_coverage", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SIMULATED = simulations()


# shares


def test_shares_reference_values():
    assert share_interval(9, 10) == pytest.approx((0.5550, 0.9975), abs=5e-5)
    assert share_interval(10, 10) == pytest.approx((0.6915, 1), abs=5e-5)
    assert share_interval(95, 100) == pytest.approx((0.8872, 0.9836), abs=5e-5)


@pytest.mark.parametrize(("hits", "n"), [(0, 1), (0, 8), (3, 8), (8, 8), (299, 1000)])
def test_shares_match_scipy(hits, n):
    expected = binomtest(hits, n).proportion_ci(0.9, method="exact")
    assert share_interval(hits, n, 0.9) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_impossible_counts_are_refused():
    with pytest.raises(ValueError, match="hits: expected 0 to n = 5, and n at least 1, got 6"):
        share_interval(6, 5)


def test_bands_of_distribution_functions():
    assert [ecdf_band(n) for n in (10, 15, 30, 100)] == pytest.approx([0.409, 0.338, 0.242, 0.134], abs=5e-4)
    low, high = ecdf_pointwise(np.array([0, 4, 10]), 10)
    assert [share_interval(h, 10) for h in (0, 4, 10)] == list(zip(low, high, strict=True))


# quantiles


def test_quantiles_reference_values():
    assert quantile_interval(np.arange(1, 11)) == (2, 9)
    assert quantile_interval(np.arange(1, 7)) == (1, 6)
    assert np.isnan(quantile_interval(np.arange(1, 6))).all()
    assert quantile_interval(np.arange(1, 37), 0.9) == (29, 36)
    low, high = quantile_interval(np.arange(1, 36), 0.9)
    assert low == 28
    assert math.isnan(high)


def test_quantiles_match_scipy():
    rng = np.random.default_rng(0)
    for n in (1, 5, 6, 17, 40, 100):
        for q, level in ((0.5, 0.95), (0.9, 0.95), (0.25, 0.8)):
            x = rng.normal(size=n)
            expected = quantile_test(x, p=q).confidence_interval(level)
            assert quantile_interval(x, q, level) == pytest.approx((expected.low, expected.high), nan_ok=True)


def test_quantiles_of_infinite_values():
    assert quantile_interval(np.array([1, 2, 3, 4, 5, INF, INF, INF])) == (1, INF)
    assert np.isnan(quantile_interval(np.array([]))).all()


# ratios


def test_ratios_reference_values():
    assert ratio_interval(D) == pytest.approx((1.648721, 1.161834, 2.225541), abs=5e-7)
    value, low, high = ratio_interval(D, 1 - 0.05 / 36)
    assert value == pytest.approx(1.648721, abs=5e-7)
    assert np.isnan([low, high]).all()
    assert ratio_interval(LONGER, 1 - 0.05 / 36) == pytest.approx((1.548830, 0.927743, 2.585710), abs=5e-7)


def test_the_interval_holds_the_ratios_that_the_exact_test_does_not_reject():
    """The ends are where the p-value of the test of §2 crosses the level."""
    from nfbench.analysis.sign_flips import sign_flip_pvalue, signed_ranks

    rng = np.random.default_rng(0)
    for n in (8, 15, 40):
        d = rng.normal(0.3, 1, size=n)
        _, low, high = ratio_interval(d)
        for end, inwards in ((math.log(low), 1e-9), (math.log(high), -1e-9)):
            assert sign_flip_pvalue(signed_ranks(d - end - inwards)) > 0.05
            assert sign_flip_pvalue(signed_ranks(d - end + inwards)) <= 0.05


def test_ratios_with_failures():
    value, low, high = ratio_interval(np.append(D, [INF, INF, INF, -INF]))
    assert 1.6 < value < 2.5
    assert low == pytest.approx(1.161834, abs=5e-7)
    assert high == INF
    assert ratio_interval(np.full(9, INF)) == (INF, INF, INF)
    assert ratio_interval(np.array([INF, -INF] * 5))[0] == 1
    assert ratio_interval(np.full(8, -INF)) == (0, 0, 0)


def test_ratios_beyond_the_exact_law_agree_with_the_normal_one():
    d = np.random.default_rng(1).normal(0.1, 1, size=201)
    _, low, high = ratio_interval(d)
    _, exact_low, exact_high = ratio_interval(d[:200])
    assert (low, high) == pytest.approx((exact_low, exact_high), rel=0.02)


# means and expected running times


def test_ert_reference_values():
    assert ert(SPENT, HITS) == 4500
    assert ert_interval(SPENT, HITS, 1, 10000) == pytest.approx((1835, 14596), rel=0.01)


def test_ert_without_a_hit_or_a_cap():
    low, high = ert_interval(SPENT, HITS * 0, 1, 10000)
    assert low > 4500
    assert high == INF
    assert ert(SPENT, HITS * 0) == INF
    for cap in (INF, NAN):
        low, high = ert_interval(SPENT, HITS, 1, cap)
        assert low == pytest.approx(1835, rel=0.01)
        assert high == INF


def test_rms_of_solved_reference_values():
    errors = np.array([0.02, 0.03, 0.01, 0.05, 0.04, 0.02, 0.06, 0.03, 0.02, 0.08])
    expected = (0.041473, 0.0273, 0.0669)
    assert rms_of_solved_interval(errors, 0.1) == pytest.approx(expected, rel=0.01)
    assert rms_of_solved_interval(np.append(errors, [0.11, INF]), 0.1) == pytest.approx(expected, rel=0.01)
    assert np.isnan(rms_of_solved_interval(np.array([0.01, INF, 0.2]), 0.1)).all()


def test_means_of_bounded_values():
    assert bounded_mean_interval(np.array([])) == (0, 1)
    low, high = bounded_mean_interval(np.ones(10))
    assert high == 1
    assert low == pytest.approx(share_interval(10, 10)[0], abs=0.01)  # as Clopper–Pearson for a share
    assert bounded_mean_interval(np.array([4.0, 8.0] * 20), 2, 12) == pytest.approx(
        2 + 10 * np.array(bounded_mean_interval(np.array([0.2, 0.6] * 20))), abs=1e-9
    )
    with pytest.raises(ValueError, match=r"values: expected values from 0\.0 to 1\.0, got 0\.5 to 1\.5"):
        bounded_mean_interval(np.array([0.5, 1.5]))


def test_the_p_value_of_a_mean_agrees_with_its_interval():
    x = np.random.default_rng(0).beta(2, 5, size=40)
    low, high = bounded_mean_interval(x)
    assert mean_pvalue(x, low) == pytest.approx(0.025, abs=1e-3)
    assert mean_pvalue(1 - x, 1 - high) == pytest.approx(0.025, abs=1e-3)


def test_variance_components():
    assert variance_components(np.array([[1, 2], [3, 5], [4, 4]])) == pytest.approx((0.8333, 1.6667, 0.6667), abs=5e-5)
    rng = np.random.default_rng(0)
    x = 2 * rng.normal(size=(4000, 1)) + rng.normal(size=(4000, 3))
    assert variance_components(x) == pytest.approx((1, 4, 0.8), rel=0.08)
    with pytest.raises(ValueError, match=r"logs: expected finite values, \(n, r\) with n and r at least 2"):
        variance_components(np.array([[1, INF], [1, 2]]))


@pytest.mark.parametrize(
    "call",
    [
        lambda: quantile_interval(np.array([1, NAN])),
        lambda: ratio_interval(np.array([1, NAN])),
        lambda: bounded_mean_interval(np.array([0.5, NAN])),
        lambda: ert_interval(np.array([1, NAN]), np.array([1, 1]), 1, 10),
        lambda: rms_of_solved_interval(np.array([1, NAN]), 1),
    ],
)
def test_nan_is_an_error_of_the_program(call):
    with pytest.raises(ValueError, match=r"expected an array \(n,\) without NaN, got"):
        call()


# coverage


def at_least(share, level, repeats):
    return share >= level - 3 * math.sqrt(level * (1 - level) / repeats)


def test_coverage_in_short():
    assert [SIMULATED.share_coverage(n) for n in (10, 15, 30, 100)] == pytest.approx(
        [0.961, 0.952, 0.954, 0.954], abs=0.002
    )
    assert at_least(SIMULATED.quantile_coverage(30, 0.5, 0.05, 200), 0.95, 200)
    assert at_least(SIMULATED.ratio_coverage(15, "skewed", 400), 0.93, 400)
    assert at_least(SIMULATED.ert_coverage(10, 0.5, 150), 0.95, 150)
    assert at_least(SIMULATED.solved_coverage(10, "lognormal", 3.0, 100), 0.95, 100)
    assert SIMULATED.band_coverage(30, True, 4000) == pytest.approx(0.95, abs=0.011)
    assert SIMULATED.band_coverage(30, False, 4000) == pytest.approx(0.59, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "expected"), [(6, 0.969), (10, 0.979), (30, 0.957), (100, 0.965)])
def test_coverage_of_the_median(n, expected):
    assert SIMULATED.quantile_coverage(n, 0.5, 0.0, 8000) == pytest.approx(expected, abs=0.008)


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("kind", SIMULATED.DIFFERENCES)
def test_coverage_of_ratios(n, kind):
    """Near ties and failures make the law discrete, so that the interval covers more than it must."""
    share = SIMULATED.ratio_coverage(n, kind, 1000)
    assert at_least(share, 0.935, 1000)


@pytest.mark.slow
@pytest.mark.parametrize("n", [30, 100])
def test_coverage_of_all_pairs_at_once(n):
    assert at_least(SIMULATED.table_coverage(n, 200), 0.95, 200)


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("kind", SIMULATED.MEANS)
def test_coverage_of_bounded_means(n, kind):
    assert at_least(SIMULATED.mean_coverage(n, kind, 800), 0.95, 800)


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("kind", SIMULATED.ERRORS)
def test_coverage_of_the_rms_of_solved_scenes(n, kind):
    for multiple in (3.0, 7.0):
        assert at_least(SIMULATED.solved_coverage(n, kind, multiple, 500), 0.95, 500)


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.9, 1.0])
def test_coverage_of_the_expected_running_time(n, share):
    assert at_least(SIMULATED.ert_coverage(n, share, 800), 0.95, 800)


@pytest.mark.parametrize("share", [0.002, 0.1, 0.9, 0.999])
def test_intervals_of_very_many_scenes_are_those_of_exact_weights(share, monkeypatch):
    rng = np.random.default_rng(5)
    hits = rng.random(800) < share
    spent = np.where(hits, rng.lognormal(5.0, 1.0, 800), 1000.0)
    found = [*ert_interval(spent, hits.astype(float), 1, 1000.0), *bounded_mean_interval(hits.astype(float))]
    monkeypatch.setattr(intervals, "MANY", 10_000)
    exact = [*ert_interval(spent, hits.astype(float), 1, 1000.0), *bounded_mean_interval(hits.astype(float))]
    assert_allclose(found, exact, rtol=0.06)
