"""Do estimators reach the bounds? Each is refined from the true sources, so that no global search is needed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import Bounds, minimize

from nfbench.problems.near_field.bounds import position_bounds, stochastic_bound
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.floor import local_fit
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import signal_subspace

PAPER = NearField(
    array={"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    wavelength_m=0.02,
    wavefront="paper",
    sources=3,
    snapshots=200,
    snr_db=20.0,
    azimuth_deg=(-60, 60),
    range_m=(1.27, 20.16),
    min_separation_deg=2.0,
)


def esf_from_truth(instance):
    """Return the local minimizer of ESF, by L-BFGS-B in units of the standard deviations given by the bound."""
    problem = SubspaceFit(signal_subspace(instance.Y, 3), instance.manifold, instance.lower, instance.upper)
    start = instance.theta.ravel()
    unit = np.sqrt(np.diag(stochastic_bound(instance.manifold, instance.theta, instance.snr, instance.Y.shape[1])))

    def scaled(u):
        value, gradient = problem.value_and_gradient(start + unit * u)
        return 1e6 * value, 1e6 * gradient * unit

    box = Bounds((problem.lower - start) / unit, (problem.upper - start) / unit)
    found = minimize(scaled, np.zeros(6), jac=True, method="L-BFGS-B", bounds=box, options={"ftol": 1e-14})
    return (start + unit * found.x).reshape(3, 2)


def dml_from_truth(instance):
    """Return the deterministic maximum likelihood estimate: least squares on the data."""
    return local_fit(instance.Y, instance.manifold, instance.theta, instance.lower, instance.upper)


def errors(instance, estimate):
    return np.linalg.norm(cartesian(estimate) - cartesian(instance.theta), axis=1)


def rms(values, axis=None):
    return np.sqrt(np.mean(np.square(values), axis=axis))


def redrawn(instance, rng):
    """Return the same sources with new symbols and new noise, in line of sight."""
    shape = instance.Y.shape
    symbols = np.sqrt(instance.snr)[:, None] * complex_normal(rng, (3, shape[1]))
    Y = instance.manifold.response(instance.theta).T @ symbols + complex_normal(rng, shape)
    return replace(instance, Y=Y, symbols=symbols)


def test_esf_reaches_the_stochastic_bound_of_three_sources():
    """The scene of the reference values at 10 dB (0.0069, 0.0188, 0.0716 m); 400 trials give each to within 4 %."""
    scenario = replace(
        PAPER,
        array={"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
        wavefront="exact",
        snr_db=10.0,
        positions=((-35.0, 4.0), (5.0, 8.0), (40.0, 12.0)),
    )
    rng = np.random.default_rng(5)
    instance = scenario.draw(rng)
    trials = [redrawn(instance, rng) for _ in range(400)]
    measured = rms([errors(trial, esf_from_truth(trial)) for trial in trials], axis=0)
    bounds = position_bounds(stochastic_bound(instance.manifold, instance.theta, instance.snr, 200), instance.theta)
    np.testing.assert_allclose(measured, bounds, rtol=0.1)


@pytest.fixture(scope="module")
def scenes():
    return [PAPER.draw(np.random.default_rng(seed)) for seed in range(100)]


@pytest.mark.parametrize("estimate", [esf_from_truth, pytest.param(dml_from_truth, marks=pytest.mark.slow)])
def test_the_error_over_random_scenes_is_that_of_the_bounds(scenes, estimate):
    """100 scenes are equivalent to 56 scenes of equal bounds; the bootstrap interval of the ratio is ±15 %."""
    ratio = rms([rms(errors(scene, estimate(scene))) for scene in scenes]) / rms([s.bounds()["crb_m"] for s in scenes])
    assert 0.85 < ratio < 1.15


def test_esf_is_worse_than_maximum_likelihood_for_close_sources():
    """ESF gives the weak eigenvector of two close sources the same weight as the strong ones: inefficient at 2.3°."""
    positions = ((48.42303, 16.380397), (-44.164281, 6.063114), (50.770840, 7.031650))
    instance = replace(PAPER, positions=positions).draw(np.random.default_rng(429))
    rng = np.random.default_rng(1)
    trials = [redrawn(instance, rng) for _ in range(60)]
    bounds = position_bounds(stochastic_bound(instance.manifold, instance.theta, instance.snr, 200), instance.theta)
    esf, dml = (
        rms([errors(trial, estimate(trial)) for trial in trials], axis=0) / bounds
        for estimate in (esf_from_truth, dml_from_truth)
    )
    close = [0, 2]
    assert esf[close].min() > 1.4
    np.testing.assert_allclose(dml, 1, rtol=0.25)
