"""Two sets of runs on the same scenes are compared by an exact test, with failures ranked last."""

import math

import numpy as np
import pytest
from scipy.stats import PermutationMethod, wilcoxon

from nfbench.analysis import paired_change, tuning_verdict

RNG = np.random.default_rng(1)
ERRORS = RNG.lognormal(size=30)
JITTER = RNG.lognormal(sigma=0.1, size=30)


def test_the_p_value_is_that_of_wilcoxons_test_with_pratts_zeros():
    first, second = RNG.lognormal(size=(1, 12)), RNG.lognormal(size=(1, 12))
    found = paired_change(first, second)
    d = np.log(second / first)[0]
    method = PermutationMethod(n_resamples=10**6)
    assert found.p == pytest.approx(wilcoxon(d, zero_method="pratt", method=method).pvalue, rel=1e-9)
    walsh = [(d[i] + d[j]) / 2 for i in range(12) for j in range(i, 12)]
    assert found.ratio == pytest.approx(math.exp(np.median(walsh)))
    assert found.low < found.ratio < found.high and found.scenes == 12


def test_points_of_one_scene_are_not_counted_as_scenes():
    """Seven points with the same errors in each scene say no more than one of them."""
    one = paired_change(ERRORS[None], ERRORS[None, ::-1])
    seven = paired_change(np.tile(ERRORS, (7, 1)), np.tile(ERRORS[::-1], (7, 1)))
    assert seven.p == pytest.approx(one.p) and seven.scenes == one.scenes == 30


def test_equal_settings_are_called_different_in_5_percent_of_cases():
    rng = np.random.default_rng(0)
    wrong = sum(paired_change(*rng.lognormal(size=(2, 3, 15))).p <= 0.05 for _ in range(2000))
    assert 0.035 <= wrong / 2000 <= 0.06


def test_the_verdict_on_a_tuning():
    better = tuning_verdict(ERRORS[None], 0.5 * (ERRORS * JITTER)[None])
    assert better.startswith("The tuned setting has 0.496 times") and better.endswith(": it is better.")
    assert "times the default's error on 30 held-out scenes (95\u00a0% interval 0.4" in better
    worse = tuning_verdict(ERRORS[None], 2 * (ERRORS * JITTER)[None])
    assert "it is worse, as it fits only the training scenes. Keep the default." in worse
    assert "they are the same within 1%" in tuning_verdict(ERRORS[None], 1.001 * ERRORS[None])
    assert "the difference is not significant" in tuning_verdict(ERRORS[None], np.roll(ERRORS, 7)[None])
    assert tuning_verdict(ERRORS[None, :5], ERRORS[None, :5]).startswith("5 held-out scenes are too few to compare")


def test_a_lower_error_with_more_failures_is_a_trade_off():
    failing = np.where(np.arange(30) < 4, np.nan, 0.5 * ERRORS * JITTER)
    text = tuning_verdict(ERRORS[None], failing[None])
    assert "(failures: 4 of the tuned setting, 0 of the default)" in text
    assert text.endswith(": a trade-off, as the lower error comes with more failures.")


def test_the_interval_of_the_factor_covers_the_true_one():
    """95 % intervals of 40 normal logs, within 4 standard errors of 300 of them."""
    rng = np.random.default_rng(2)
    found = [paired_change(np.ones((1, 40)), np.exp(rng.normal(math.log(0.8), 0.3, (1, 40)))) for _ in range(300)]
    covered = sum(each.low <= 0.8 <= each.high for each in found)
    assert 0.95 * 300 - 4 * math.sqrt(300 * 0.95 * 0.05) <= covered < 300
