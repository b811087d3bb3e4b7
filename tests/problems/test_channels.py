import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.problems.arrays import ULA
from nfbench.problems.channels import IID, complex_normal, rician
from nfbench.problems.wavefronts import Manifold

MANIFOLD = Manifold(ULA(elements=16, spacing_wavelengths=0.5, origin="first").place(0.02), 0.02, "exact", False)
THETA = np.array([[0.1, 2.0], [-0.4, 3.0]])
BOX = np.array([-1.0, 1.0]), np.array([1.0, 4.0])
A = MANIFOLD.response(THETA).T


def scattered(seed: int, count: int) -> np.ndarray:
    return IID().draw(np.random.default_rng(seed), count, MANIFOLD, THETA, *BOX)


def test_complex_normal_is_circular_and_of_unit_variance():
    z = complex_normal(np.random.default_rng(0), (200_000,))
    assert np.mean(np.abs(z) ** 2) == pytest.approx(1.0, abs=0.01)
    assert abs(np.mean(z * z)) < 0.01  # real and imaginary part alike and uncorrelated
    assert abs(np.mean(z)) < 0.01


def test_iid_scattering_has_power_m_and_no_correlation():
    G = scattered(0, 20_000)
    assert G.shape == (20_000, 16, 2)
    assert_allclose(np.mean(np.sum(np.abs(G) ** 2, axis=1), axis=0), 16.0, rtol=0.01)
    stacked = G.reshape(len(G), -1)
    covariance = stacked.T @ stacked.conj() / len(G)
    assert_allclose(covariance, np.eye(32), rtol=0, atol=0.05)


def test_drawing_more_leaves_the_first_draws_as_they_are():
    assert_array_equal(scattered(7, 5)[:1], scattered(7, 1))
    assert np.abs(scattered(7, 1) - scattered(8, 1)).max() > 0.1


@pytest.mark.parametrize("rician_k", [0.5, 10.0, 1e6])
def test_the_rician_factor_splits_the_power(rician_k):
    G = scattered(1, 20_000)
    H = rician(A, G, rician_k)
    line_of_sight = H.mean(axis=0)
    assert_allclose(line_of_sight, math.sqrt(rician_k / (rician_k + 1)) * A, rtol=0, atol=0.05)
    power = np.mean(np.sum(np.abs(H) ** 2, axis=1), axis=0)
    assert_allclose(power, 16.0, rtol=0.02)  # E‖h_k‖² = M at any κ
    around = np.mean(np.sum(np.abs(H - math.sqrt(rician_k / (rician_k + 1)) * A) ** 2, axis=1), axis=0)
    assert_allclose(rician_k / (rician_k + 1) * 16 / around, rician_k, rtol=0.02)


def test_an_infinite_rician_factor_is_the_line_of_sight_exactly():
    H = rician(A, scattered(1, 3), math.inf)
    assert H.shape == (3, 16, 2)
    for draw in H:
        assert_array_equal(draw, A)
