"""How many eigenvalues rise above white noise, and how strong the noise is: published quantiles and simulations."""

import numpy as np
import pytest

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.diagnosis.eigenvalues import spectrum, tracy_widom_tail


@pytest.mark.parametrize(
    ("s", "tail"),  # tables of the quantiles of F₂
    [
        (-3.72444594, 0.99),
        (-3.19416673, 0.95),
        (-1.8049124, 0.5),
        (-0.59685129, 0.10),
        (-0.23247446, 0.05),
        (0.47763605, 0.01),
        (1.31441948, 0.001),
    ],
)
def test_the_tail_has_the_published_quantiles(s, tail):
    assert tracy_widom_tail(s) == pytest.approx(tail, rel=0.01)


def test_the_tail_has_the_published_moments():
    s = np.linspace(-8, 6, 1401)
    density = -np.gradient([tracy_widom_tail(x) for x in s], s)
    mean = np.trapezoid(s * density, s)
    assert mean == pytest.approx(-1.7710868, abs=1e-3)
    assert np.trapezoid((s - mean) ** 2 * density, s) == pytest.approx(0.8131948, abs=2e-3)


@pytest.mark.parametrize(("M", "T"), [(64, 100), (40, 20), (8, 200)])
def test_pure_noise_is_significant_as_often_as_the_level_says(M, T):
    rng = np.random.default_rng(M)
    found = sum(spectrum(complex_normal(rng, (M, T)), level=0.05).significant > 0 for _ in range(600))
    # conservative for few elements, as the noise power is estimated from all eigenvalues that are not signals
    assert 6 <= found <= 50


@pytest.mark.parametrize(("M", "T"), [(64, 100), (64, 30), (10, 50)])
def test_signals_are_counted_and_the_power_of_the_noise_is_unbiased(M, T):
    rng, K, power = np.random.default_rng(0), 3, 2.5
    A = np.exp(2j * np.pi * rng.random((M, K)))
    seen = [
        spectrum(2.0 * A @ complex_normal(rng, (K, T)) + np.sqrt(power) * complex_normal(rng, (M, T)))
        for _ in range(100)
    ]
    assert np.mean([each.significant == K for each in seen]) > 0.98
    plain = [each.eigenvalues[K:].sum() / (M - K) for each in seen]
    assert np.mean([each.noise for each in seen]) == pytest.approx(power, rel=0.01)
    assert np.mean(plain) < 0.99 * power  # without the correction


def test_data_without_noise_have_the_rank_of_their_signals():
    rng = np.random.default_rng(1)
    seen = spectrum(complex_normal(rng, (20, 2)) @ complex_normal(rng, (2, 50)))
    assert (seen.significant, seen.noise) == (2, 0.0)
