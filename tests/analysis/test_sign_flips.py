"""The sign-flip test against enumeration, SciPy and reference values, and its size with runs and swept points."""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import PermutationMethod, binomtest, wilcoxon

from nfbench.analysis.sign_flips import (
    hit_scores,
    holm,
    log_ratios,
    one_sided,
    sign_flip_pvalue,
    sign_flip_pvalues,
    signed_ranks,
)

INF = math.inf
D = [0.5, -0.3, 0.8, 0.2, 1.1, 0.9, -0.1, 0.4, 0.7, 0.6]
WITH_ZEROS = [0, 0, 0, 0.5, 0.5, -0.3, 0.8, 0.2, 1.1, INF]


def enumerated(v):
    """The definition: the share of all 2ⁿ sign patterns whose sum is as far from 0."""
    signs = np.array(list(itertools.product([1, -1], repeat=len(v))))
    return np.mean(np.abs(signs @ np.abs(v)) >= abs(np.sum(v)))


# reference values


def test_reference_values_of_signed_ranks():
    assert signed_ranks(np.array(D)).tolist() == [10, -6, 16, 4, 20, 18, -2, 8, 14, 12]
    assert sign_flip_pvalue(signed_ranks(np.array(D))) == 0.013671875
    scores = signed_ranks(np.array(WITH_ZEROS))
    assert scores.tolist() == [0, 0, 0, 13, 13, -10, 16, 8, 18, 20]
    assert sign_flip_pvalue(scores) == 0.046875
    assert sign_flip_pvalue(signed_ranks(np.array([0.0] * 14 + [1.0, 2, 3, 4, 5, 6]))) == 0.03125


def test_reference_values_of_hits():
    assert sign_flip_pvalue(np.array([1] * 6)) == 0.03125
    assert sign_flip_pvalue(np.array([1] * 9 + [-1] * 2)) == 0.0654296875
    assert sign_flip_pvalue(np.array([3, 2, 0, -1, 1, 3, 2, 0, 1, 2])) == 0.03125


def test_reference_values_over_swept_points():
    rows = [
        [0.2, 0.3, 0.1],
        [0.4, -0.1, 0.5],
        [-0.2, -0.3, 0.1],
        [0.6, 0.7, 0.2],
        [0.3, 0.1, 0.4],
        [0.1, 0.2, 0.3],
        [0.5, 0.4, 0.6],
        [-0.1, 0.15, 0.25],
    ]
    scores = signed_ranks(np.array(rows).T).sum(axis=0)
    assert scores.tolist() == [21, 23, -15, 38, 25, 21, 44, 11]
    assert sign_flip_pvalue(scores) == 0.0234375
    # pooled, 24 units instead of 8 scenes
    assert sign_flip_pvalue(signed_ranks(np.array(rows).ravel())) == pytest.approx(0.00027, abs=5e-6)


def test_holm_reference_values():
    assert holm(np.array([0.01, 0.04, 0.03, 0.005])) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm(np.array([[0.01, 0.04], [0.03, 0.005]])).tolist() == holm(np.array([0.01, 0.04, 0.03, 0.005])).reshape(
        2, 2
    ).tolist()  # fmt: skip


# against second implementations


@pytest.mark.parametrize("n", [1, 2, 5, 9, 12])
def test_the_law_matches_enumeration(n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        v = rng.integers(-9, 10, size=n)
        assert sign_flip_pvalue(v) == pytest.approx(enumerated(v), abs=1e-12)


def test_signed_ranks_match_scipys_pratt():
    every = PermutationMethod(n_resamples=10**6)
    rng = np.random.default_rng(5)
    for _ in range(3):
        d = np.round(rng.normal(0.4, 1, size=9), 1)  # with ties and zeros
        expected = wilcoxon(d, zero_method="pratt", method=every).pvalue
        assert sign_flip_pvalue(signed_ranks(d)) == pytest.approx(expected, abs=1e-12)


def test_single_hits_match_mcnemars_exact_test():
    rng = np.random.default_rng(2)
    for n in (10, 40, 150):
        a, b = rng.random((2, n)) < [[0.9], [0.7]]
        expected = binomtest(int(np.sum(a & ~b)), int(np.sum(a != b))).pvalue
        assert sign_flip_pvalue(hit_scores(a, 1, b, 1)) == pytest.approx(expected, rel=1e-10)


def test_many_rows_give_the_same_as_one_at_a_time():
    rng = np.random.default_rng(3)
    v = signed_ranks(np.round(rng.normal(size=(30, 25)), 1))
    v[4] = 0
    assert sign_flip_pvalues(v).tolist() == [sign_flip_pvalue(row) for row in v]
    assert sign_flip_pvalues(v)[4] == 1


def test_beyond_200_scores_the_normal_law_is_close_to_the_exact_one():
    rng = np.random.default_rng(4)
    v = signed_ranks(rng.normal(0.15, 1, size=200))
    longer = np.append(v, [1])  # hardly changes the sum, but changes the rule
    assert sign_flip_pvalue(longer) == pytest.approx(sign_flip_pvalue(v), rel=0.1)
    z = abs(longer.sum()) / math.sqrt(np.sum(longer.astype(float) ** 2))
    assert sign_flip_pvalue(longer) == pytest.approx(math.erfc(z / math.sqrt(2)), rel=1e-12)


# definitions


def test_one_sided_values():
    v = signed_ranks(np.array(D))
    assert one_sided(v) == 0.013671875 / 2
    assert one_sided(-v) == 1 - 0.013671875 / 2
    assert one_sided(np.zeros(5, dtype=int)) == 1
    assert one_sided(np.array([3, -3])) == 1


def test_log_ratios_of_failures_and_ties():
    a = np.array([INF, INF, 1.0, 1.0, 1.005, 2.0, 0.0, 0.0])
    b = np.array([INF, 1.0, INF, 1.005, 1.0, 1.0, 0.0, 1.0])
    assert log_ratios(a, b).tolist() == [0, INF, -INF, 0, 0, math.log(2), 0, -INF]
    assert log_ratios(a, b, ties=False)[3:5] == pytest.approx([-math.log(1.005), math.log(1.005)])
    assert log_ratios(np.array([1.09, 1.11]), np.ones(2), factor=1.1).tolist() == [0, math.log(1.11)]


def test_hits_of_different_numbers_of_runs():
    assert hit_scores(np.array([5, 3, 0]), 5, np.array([1, 0, 1]), 1).tolist() == [0, 3, -5]


@pytest.mark.parametrize(
    "call",
    [
        lambda: sign_flip_pvalue(np.array([1.0, math.nan])),
        lambda: sign_flip_pvalue(np.array([1.0, 0.5])),
        lambda: log_ratios(np.array([math.nan]), np.array([1.0])),
        lambda: log_ratios(np.array([1.0]), np.array([-1.0])),
        lambda: signed_ranks(np.array([math.nan, 1.0])),
        lambda: hit_scores(np.array([math.nan]), 1, np.array([1]), 1),
        lambda: holm(np.array([0.1, math.nan])),
    ],
)
def test_nan_and_impossible_values_are_errors(call):
    with pytest.raises(ValueError, match=r"expected .*, got"):
        call()


# simulations


def rejections(p, level=0.05):
    return np.mean(np.asarray(p) <= level)


@pytest.mark.parametrize(("n", "expected"), [(15, 0.05), (100, 0.05)])
def test_the_size_is_that_of_the_level_and_runs_are_not_scenes(n, expected):
    """R = 5 runs a scene, whose scene effects have the variance of the runs' (§1.1)."""
    rng = np.random.default_rng(n)
    m, runs = (600, 5)
    d = rng.normal(size=(m, n, 1)) * 0.7 + rng.normal(size=(m, n, runs))
    medians = sign_flip_pvalues(signed_ranks(np.median(d, axis=2)))
    assert rejections(medians) == pytest.approx(expected, abs=0.03)  # 3 s.e.
    pooled = sign_flip_pvalues(signed_ranks(d.reshape(m, -1)))
    assert rejections(pooled) > 0.12


def swept(rng, m, n, points, correlation):
    common = math.sqrt(correlation) * rng.normal(size=(m, 1, n))
    return common + math.sqrt(1 - correlation) * rng.normal(size=(m, points, n))


@pytest.mark.parametrize(("correlation", "pooled"), [(0.3, 0.24), (0.7, 0.40)])
def test_points_on_the_same_scenes_are_summed_and_never_pooled(correlation, pooled):
    """Seven correlated points (§1.1): pooled, a 5 % test rejects in 24 or 40 %; summed within scenes, in 5 %."""
    d = swept(np.random.default_rng(7), 800, 28, 7, correlation)
    assert rejections(sign_flip_pvalues(signed_ranks(d.reshape(800, -1)))) == pytest.approx(pooled, abs=0.055)
    assert rejections(sign_flip_pvalues(signed_ranks(d).sum(axis=1))) == pytest.approx(0.05, abs=0.024)


def test_the_power_of_one_pair():
    """Half the error with σ = 1 per method: .38 at 15 scenes, .71 at 30 (§3.5)."""
    rng = np.random.default_rng(11)
    for n, power in ((15, 0.38), (30, 0.71)):
        d = rng.normal(math.log(2), math.sqrt(2), size=(1000, n))
        assert rejections(sign_flip_pvalues(signed_ranks(d))) == pytest.approx(power, abs=0.05)
