"""Rician fading: power, covariance and geometry of the scattered waves."""

import math

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import OptionError
from nfbench.problems.near_field.arrays import ULA, UPA, Custom
from nfbench.problems.near_field.channels import IID, ClusterAroundSource, Clusters, Isotropic, complex_normal, rician
from nfbench.problems.near_field.wavefronts import Manifold

MANIFOLD = Manifold(ULA(elements=16, spacing_wavelengths=0.5, origin="first").place(0.02), 0.02, "exact", False)
THETA = np.array([[0.1, 2.0], [-0.4, 3.0]])
BOX = np.array([-1.0, 1.0]), np.array([1.0, 4.0])
A = MANIFOLD.response(THETA).T


def scattered(seed: int, count: int) -> np.ndarray:
    return IID().draw(np.random.default_rng(seed), count, MANIFOLD, THETA, *BOX)


def test_complex_normal_is_circular_and_of_unit_variance():
    z = complex_normal(np.random.default_rng(0), (200_000,))
    assert np.mean(np.abs(z) ** 2) == pytest.approx(1.0, abs=0.01)
    assert abs(np.mean(z * z)) < 0.01  # real and imaginary part have equal power and are uncorrelated
    assert abs(np.mean(z)) < 0.01


def test_iid_scattering_has_power_m_and_no_correlation():
    G = scattered(0, 20_000)
    assert G.shape == (20_000, 16, 2)
    assert_allclose(np.mean(np.sum(np.abs(G) ** 2, axis=1), axis=0), 16.0, rtol=0.01)
    stacked = G.reshape(len(G), -1)
    covariance = stacked.T @ stacked.conj() / len(G)
    assert_allclose(covariance, np.eye(32), rtol=0, atol=0.05)


def test_the_first_draws_do_not_depend_on_the_count():
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
    scattered_power = np.mean(np.sum(np.abs(H - math.sqrt(rician_k / (rician_k + 1)) * A) ** 2, axis=1), axis=0)
    assert_allclose(rician_k / (rician_k + 1) * 16 / scattered_power, rician_k, rtol=0.02)


def test_an_infinite_rician_factor_is_the_line_of_sight_exactly():
    H = rician(A, scattered(1, 3), math.inf)
    assert H.shape == (3, 16, 2)
    for draw in H:
        assert_array_equal(draw, A)


ARRAYS = {
    "ula": ULA(elements=16, spacing_wavelengths=0.25, origin="first"),
    "upa": UPA(columns=4, rows=3, spacing_wavelengths=0.5, origin="center"),
    "custom": Custom(origin="first", positions=tuple(map(tuple, np.random.default_rng(5).uniform(0, 0.1, (10, 3))))),
}
KINDS = [
    IID(),
    Isotropic(),
    Clusters(),
    Clusters(clusters=2, scatterers=30, angular_spread_deg=20.0, range_spread_m=0.5, weights=(3.0, 1.0)),
    ClusterAroundSource(),
]
SPACE = np.array([[0.1, 0.2, 2.0], [-0.4, -0.3, 3.0]])


def scene(array: str, wavefront: str = "exact"):
    """Return the arguments of ``draw`` after ``count``: in the plane for the ULA, with elevation for the others."""
    flat = array == "ula"
    manifold = Manifold(ARRAYS[array].place(0.02), 0.02, wavefront, not flat)
    lower, upper = np.array([-1.0, -0.5, 1.0]), np.array([1.0, 0.5, 4.0])
    keep = [0, 2] if flat else [0, 1, 2]
    return manifold, SPACE[:, keep], lower[keep], upper[keep]


@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize("nlos", KINDS, ids=lambda nlos: nlos.kind)
def test_draws_have_the_stated_covariance_and_power_m(nlos, array):
    manifold, *rest = scene(array)
    M, count = manifold.elements, 4_000
    R = nlos.covariance(np.random.default_rng(3), manifold, *rest)
    assert_allclose(np.trace(R, axis1=1, axis2=2), M, rtol=1e-9)  # E‖g‖² = M
    G = nlos.draw(np.random.default_rng(3), count, manifold, *rest)
    assert G.shape == (count, M, 2)
    stacked = np.moveaxis(G, 2, 1).reshape(count, -1)
    sample = (stacked.T @ stacked.conj() / count).reshape(2, M, 2, M)
    six_sigma = 6 / math.sqrt(count)  # an entry's standard deviation is √(R_mm·R_nn/count), at most 1.6/√count
    for k in range(2):
        assert_allclose(sample[k, :, k], R[k], rtol=0, atol=1.6 * six_sigma)
        assert_allclose(sample[k, :, 1 - k], 0, rtol=0, atol=1.6 * six_sigma)  # sources fade independently
    assert abs(np.mean(stacked * stacked)) < six_sigma  # circular


@pytest.mark.parametrize("nlos", KINDS, ids=lambda nlos: nlos.kind)
def test_the_first_draws_do_not_depend_on_the_count_for_any_kind(nlos):
    one, five = (nlos.draw(np.random.default_rng(7), count, *scene("upa")) for count in (1, 5))
    assert_allclose(five[:1], one, rtol=0, atol=1e-12)
    assert np.abs(five[1] - five[0]).max() > 0.1
    other = nlos.draw(np.random.default_rng(8), 1, *scene("upa"))
    assert np.abs(other - one).max() > 0.1


@pytest.mark.parametrize("array", ARRAYS)
def test_isotropic_scattering_consists_of_plane_waves_from_all_directions(array):
    """sin(kd)/(kd) is the mean of exp(jk·uᵀ(q_m − q_n)) over the sphere, here over a Fibonacci lattice."""
    manifold, *rest = scene(array)
    n, Q = 4000, manifold.positions
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.arange(n) * math.pi * (3 - math.sqrt(5))
    u = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    waves = np.exp(2j * math.pi / 0.02 * Q @ u.T)
    for R in Isotropic().covariance(np.random.default_rng(0), manifold, *rest):
        assert_allclose(R, waves @ waves.conj().T / n, rtol=0, atol=5e-3)


def test_isotropic_equals_iid_if_all_distances_are_multiples_of_half_a_wavelength():
    R = Isotropic().covariance(np.random.default_rng(0), MANIFOLD, THETA, *BOX)
    assert_allclose(R, np.tile(np.eye(16), (2, 1, 1)), rtol=0, atol=1e-7)


def located(nlos, seed: int = 0) -> np.ndarray:
    """Return the scatterers (K, S, d) of a scene, captured by a manifold that records its arguments."""
    arguments = []

    class Recording(Manifold):
        def response(self, theta):
            arguments.append(theta)
            return super().response(theta)

    manifold, *rest = scene("upa")
    nlos.factors(
        [own.spawn(2)[0] for own in np.random.default_rng(seed).spawn(2)],
        Recording(manifold.positions, 0.02, "exact", True),
        *rest,
    )
    (theta,) = arguments
    return theta


def test_clusters_have_the_stated_centres_and_spreads():
    theta = located(Clusters(clusters=200, scatterers=500, angular_spread_deg=4.0))
    assert theta.shape == (2, 200, 500, 3)
    centre = theta.mean(axis=2)
    unit = (centre - [-1.0, -0.5, 1.0]) / [2.0, 1.0, 3.0]  # uniform in the box
    assert_allclose(unit.mean(axis=(0, 1)), 0.5, atol=0.05)
    assert_allclose(unit.var(axis=(0, 1)), 1 / 12, atol=0.01)
    spread = theta.std(axis=2)
    assert_allclose(spread[..., :2].mean(axis=(0, 1)), math.radians(4), rtol=0.01)
    assert_allclose((spread[..., 2] / centre[..., 2]).mean(), math.radians(4), rtol=0.01)  # as deep as wide
    inner = np.abs(theta - centre[:, :, None]) < spread[:, :, None]
    assert_allclose(inner.mean(axis=(0, 1, 2)), 0.6827, atol=0.01)  # Gaussian
    deep = located(Clusters(clusters=200, scatterers=500, range_spread_m=0.1))
    assert_allclose(deep.std(axis=2)[..., 2].mean(), 0.1, rtol=0.01)


def test_a_cluster_around_the_source_is_centred_at_the_source():
    theta = located(ClusterAroundSource(scatterers=20_000))
    assert_allclose(theta.mean(axis=1), SPACE, atol=0.01)
    assert_allclose(theta.std(axis=1)[:, :2], math.radians(5), rtol=0.03)


def test_scatterers_have_positive_ranges():
    theta = located(Clusters(range_spread_m=5.0))
    assert theta[..., 2].min() > 0
    for wavefront in ("exact", "fresnel", "paper", "planar"):
        R = Clusters(range_spread_m=5.0).covariance(np.random.default_rng(0), *scene("upa", wavefront))
        assert np.isfinite(R).all()


def test_weights_are_the_relative_powers_of_the_clusters():
    """For two clusters of one scatterer each without spread, Σ = Σ_c w_c·a_c·a_cᴴ."""
    nlos = Clusters(clusters=2, scatterers=1, angular_spread_deg=0.0, weights=(3.0, 1.0))
    manifold, *rest = scene("upa")
    R = nlos.covariance(np.random.default_rng(2), manifold, *rest)
    for k, centres in enumerate(located(nlos, seed=2)[:, :, 0]):
        a, b = (oracles.response(manifold, centre) for centre in centres)
        expected = 0.75 * np.outer(a, a.conj()) + 0.25 * np.outer(b, b.conj())
        assert_allclose(R[k], expected, rtol=0, atol=1e-9)


def test_a_narrow_cluster_occupies_few_dimensions_and_iid_all():
    """Unlike iid scattering, the energy of a narrow cluster is not spread over all M dimensions."""
    narrow, wide = (
        nlos.covariance(np.random.default_rng(0), *scene("ula"))[0] for nlos in (ClusterAroundSource(), IID())
    )
    assert np.linalg.eigvalsh(narrow)[-4:].sum() > 0.99 * 16
    assert np.linalg.eigvalsh(wide)[-4:].sum() == pytest.approx(4)


@pytest.mark.parametrize(
    ("cls", "options"),
    [
        (Clusters, {"clusters": 10**9}),
        (Clusters, {"scatterers": 10**9}),
        (Clusters, {"range_spread_m": 1e300}),
        (Clusters, {"weights": (1e300, 1.0, 1.0)}),
        (ClusterAroundSource, {"scatterers": 10**9}),
        (ClusterAroundSource, {"range_spread_m": math.inf}),
    ],
)
def test_numbers_that_no_memory_or_float_holds_are_refused(cls, options):
    (name,) = options
    with pytest.raises(OptionError, match=rf"{cls.__name__}: {name}.*: expected less than or equal to"):
        cls(**options)
