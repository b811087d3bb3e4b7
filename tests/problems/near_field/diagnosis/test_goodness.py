"""The goodness of fit: its level and power, by simulation, and its numbers against their definitions."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_scenes import SCENES
from scipy.stats import kstest

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.diagnosis.eigenvalues import spectrum
from nfbench.problems.near_field.diagnosis.goodness import explained_share, fit, source_covariance


def next_to_truth(instance, **changes):
    """The fit next to the true sources."""
    manifold = replace(instance.manifold, **changes)
    box = instance.lower, instance.upper
    return fit(instance.theta, manifold, *box, spectrum(instance.Y), instance.Y.shape[1])


@pytest.mark.parametrize("scene", [pytest.param(s, marks=[pytest.mark.slow] * (i % 2)) for i, s in enumerate(SCENES)])
def test_p_values_are_uniform_if_the_model_is_right(scene):
    p = np.array([next_to_truth(SCENES[scene].draw(np.random.default_rng(seed))).p_value for seed in range(120)])
    assert np.isfinite(p).all()
    assert kstest(p, "uniform").pvalue > 0.005
    assert np.mean(p < 0.05) < 0.1 and np.mean(p < 0.001) <= 0.01


def test_a_wrong_model_is_rejected():
    scenario = SCENES["ULA of 128 elements, 20 dB"]
    for seed in range(5):
        instance = scenario.draw(np.random.default_rng(seed))
        assert next_to_truth(instance, wavefront="planar").p_value < 1e-6
        errors = 0.05 * instance.manifold.wavelength_m * np.random.default_rng(seed).standard_normal((128, 3))
        assert next_to_truth(instance, positions=instance.manifold.positions + errors).p_value < 1e-6


def test_the_test_is_not_made_where_it_has_no_meaning():
    instance = SCENES["ULA of 16 elements"].draw(np.random.default_rng(0))
    box = instance.lower, instance.upper
    noise = complex_normal(np.random.default_rng(1), instance.Y.shape)
    assert np.isnan(fit(instance.theta, instance.manifold, *box, spectrum(noise), 60).p_value)
    clean = instance.manifold.response(instance.theta).T @ instance.symbols
    found = fit(instance.theta, instance.manifold, *box, spectrum(clean), 60)
    assert np.isnan(found.p_value) and found.explained == pytest.approx(1.0)


def test_shares_agree_with_projections():
    rng = np.random.default_rng(2)
    A = complex_normal(rng, (3, 12))
    P = A.T @ np.linalg.inv(A.conj() @ A.T) @ A.conj()
    U = np.linalg.qr(complex_normal(rng, (12, 2))).Q
    assert explained_share(A, U) == pytest.approx(np.trace(U.conj().T @ P @ U).real / 2)


def test_the_covariance_of_the_signals_is_recovered():
    rng = np.random.default_rng(3)
    instance = SCENES["ULA of 16 elements"].draw(rng)
    A = instance.manifold.response(instance.theta)
    root = np.array([[3.0, 0.0], [1.0 + 1.0j, 0.5]])
    Y = A.T @ root @ complex_normal(rng, (2, 20_000)) + complex_normal(rng, (16, 20_000))
    found = source_covariance(A, spectrum(Y), spectrum(Y).noise)
    assert np.abs(found - root @ root.conj().T).max() < 0.2
