"""Bounds of the true model compared with the Fisher information of gains, coupling, coloured noise and correlation."""

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.bounds import deterministic_bound, stochastic_bound
from nfbench.problems.near_field.calibration import true_bands
from nfbench.problems.near_field.scenario import NearField

SCENE = {
    "array": {"kind": "ula", "elements": 10, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 50,
    "snr_db": (6.0, 2.0),
    "azimuth_deg": (-60, 60),
    "range_m": (0.05, 1.0),
    "positions": ((-20.0, 0.1), (30.0, 0.2)),
}
IMPAIRED = {
    "gain_error_db": 3.0,
    "phase_error_deg": 50.0,
    "position_error_wavelengths": 0.1,
    "failed_elements": (3,),
    "amplitude": "spherical",
    "coupling_db": -6.0,
    "coupling_phase_deg": 40.0,
    "noise_level_db": 3.0,
    "noise_correlation_wavelengths": 0.8,
}


def draw(**impairments):
    return NearField(**SCENE, impairments=impairments).draw(np.random.default_rng(5))


def responses(instance, x: np.ndarray) -> np.ndarray:
    """Γ·C·A of sources, one by one from the definitions."""
    manifold = instance.manifold
    columns = []
    for theta in x.reshape(-1, 2):
        p = oracles.position(theta)
        d = np.linalg.norm(p - instance.element_positions, axis=1)
        columns.append(theta[-1] / d * np.exp(2j * np.pi / manifold.wavelength_m * (theta[-1] - d)))
    gains = instance.gains.copy()
    gains[list(instance.failed)] = 0
    return np.diag(gains) @ instance.coupling @ np.array(columns).T


def by_theta(f, theta: np.ndarray) -> np.ndarray:
    return oracles.central_difference(f, theta.ravel(), 1e-6 * np.abs(theta.ravel()))


def assert_same_covariance(C: np.ndarray, expected: np.ndarray) -> None:
    deviations = np.sqrt(np.diag(expected))
    assert_allclose(C / np.outer(deviations, deviations), expected / np.outer(deviations, deviations), atol=1e-5)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_stochastic_bound_follows_from_the_full_gaussian_model(rho):
    """Slepian–Bangs for θ, the K² real parameters of the symbols' covariance, and the power of the coloured noise."""
    instance = draw(**IMPAIRED, source_correlation=rho, source_correlation_phase_deg=30.0)
    powers = np.sqrt(instance.snr)
    phase = np.exp(-1j * np.radians(30.0))
    P = np.array([[1, rho * phase], [rho * np.conj(phase), 1]]) * np.outer(powers, powers)
    A = responses(instance, instance.theta.ravel())

    def covariance(x):
        return responses(instance, x) @ P @ responses(instance, x).conj().T + instance.noise_covariance

    units = [np.array(unit) for unit in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 1], [1, 0]], [[0, 1j], [-1j, 0]])]
    slopes = [*by_theta(covariance, instance.theta)]
    slopes += [A @ unit @ A.conj().T for unit in units] + [instance.noise_covariance]
    inverse = np.linalg.inv(covariance(instance.theta.ravel()))
    F = np.array([[np.trace(inverse @ a @ inverse @ b).real for b in slopes] for a in slopes]) * 50
    expected = np.linalg.inv(F)[:4, :4]

    C = stochastic_bound(
        true_bands(instance, "spherical")[0].manifold, instance.theta, instance.snr, 50, instance.correlation
    )
    assert_same_covariance(C, expected)
    nominal = stochastic_bound(instance.manifold, instance.theta, instance.snr, 50)
    assert np.abs(np.diag(nominal) / np.diag(expected) - 1).max() > 0.1


def test_the_deterministic_bound_follows_from_the_whitened_data():
    instance = draw(**IMPAIRED, source_correlation=0.8)
    whitener = np.linalg.inv(np.linalg.cholesky(instance.noise_covariance))
    S = instance.symbols

    def mean(x):
        return (whitener @ responses(instance, x) @ S).ravel()

    A = whitener @ responses(instance, instance.theta.ravel())
    slopes = [*by_theta(mean, instance.theta)]
    for k in range(2):
        for t in range(S.shape[1]):
            for unit in (1, 1j):
                E = np.zeros(S.shape, dtype=complex)
                E[k, t] = unit
                slopes.append((A @ E).ravel())
    J = np.array(slopes)
    expected = np.linalg.inv(2 * (J.conj() @ J.T).real)[:4, :4]
    assert_same_covariance(
        deterministic_bound(true_bands(instance, "spherical")[0].manifold, instance.theta, S), expected
    )


def test_the_bound_of_coherent_sources_is_the_limit_of_correlated_ones():
    def bound(rho):
        instance = draw(source_correlation=rho)
        return stochastic_bound(instance.manifold, instance.theta, instance.snr, 50, instance.correlation)

    coherent, nearly = bound(1.0), bound(1 - 1e-9)
    assert np.isfinite(coherent).all()
    assert_allclose(coherent, nearly, rtol=1e-4)
    assert np.diag(coherent)[0] != pytest.approx(np.diag(bound(0.0))[0], rel=0.02)


def test_the_columns_are_the_bounds_of_the_true_model():
    plain, impaired = draw().bounds(), draw(**IMPAIRED).bounds()
    assert plain.keys() == impaired.keys()
    assert impaired["crb_m"] > 1.05 * plain["crb_m"] or impaired["crb_m"] < 0.95 * plain["crb_m"]
    failed = draw(failed_elements=(0, 9)).bounds()["crb_m"]
    assert failed > 1.2 * plain["crb_m"]  # the aperture shrinks


def test_equal_gains_of_all_elements_are_an_snr():
    plain = NearField(**SCENE | {"snr_db": (12.0, 8.0)}).draw(np.random.default_rng(5))
    louder = draw(noise_level_db=(-6.0,) * 10)
    assert_allclose(louder.bounds()["crb_m"], plain.bounds()["crb_m"], rtol=1e-9)
