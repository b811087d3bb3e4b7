"""Bounds compared with the Fisher information of the full model, including nuisance parameters, and closed forms."""

import math
from itertools import product

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.bounds import deterministic_bound, position_bounds, stochastic_bound
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
LINE = Manifold(ULA(elements=10, spacing_wavelengths=0.5, origin="first").place(WAVELENGTH), WAVELENGTH, "exact", False)
PLANE = Manifold(
    UPA(columns=4, rows=3, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH), WAVELENGTH, "exact", True
)
SCENES = [  # manifold, sources, their SNRs
    (LINE, [[-0.5, 0.2]], [3.0]),
    (LINE, [[-0.4, 0.15], [0.1, 0.25], [0.7, 0.2]], [1.0, 10.0, 0.3]),
    (LINE.under("paper"), [[-0.4, 0.15], [0.1, 0.25]], [1.0, 10.0]),
    (PLANE, [[-0.4, 0.3, 0.08], [0.5, -0.2, 0.1]], [2.0, 0.5]),
    (PLANE.under("fresnel"), [[-0.4, 0.3, 0.08], [0.5, -0.2, 0.1]], [2.0, 0.5]),
]
PAPER = Manifold(  # the size of the paper's array
    ULA(elements=128, spacing_wavelengths=0.25, origin="center").place(WAVELENGTH), WAVELENGTH, "exact", False
)
THREE = np.array([[math.radians(-35), 4.0], [math.radians(5), 8.0], [math.radians(40), 12.0]])


def responses(manifold: Manifold, x: np.ndarray, sources: int) -> np.ndarray:
    return np.array([oracles.response(manifold, theta) for theta in x.reshape(sources, -1)]).T


def by_theta(f, theta: np.ndarray) -> np.ndarray:
    return oracles.central_difference(f, theta.ravel(), 1e-6 * np.abs(theta.ravel()))


def assert_same_covariance(C: np.ndarray, expected: np.ndarray) -> None:
    """Compare every element in units of the standard deviations."""
    deviations = np.sqrt(np.diag(expected))
    assert_allclose(C / np.outer(deviations, deviations), expected / np.outer(deviations, deviations), atol=1e-5)


@pytest.mark.parametrize(("manifold", "theta", "snr"), SCENES)
def test_the_stochastic_bound_follows_from_the_full_gaussian_model(manifold, theta, snr):
    """Slepian–Bangs: F_ij = T·tr(R⁻¹∂_iR·R⁻¹∂_jR) for θ, the K² real parameters of the symbols, and the noise power."""
    theta, snr, T = np.array(theta), np.array(snr), 50
    K, M = len(theta), manifold.elements
    A = responses(manifold, theta, K)

    def covariance(x):
        A = responses(manifold, x, K)
        return A * snr @ A.conj().T + np.eye(M)

    slopes = list(by_theta(covariance, theta))
    for k, i in product(range(K), repeat=2):  # Re P_ki if k ≤ i, otherwise Im
        E = np.zeros((K, K), complex)
        E[k, i], E[i, k] = (1, 1) if k <= i else (1j, -1j)
        slopes.append(A @ E @ A.conj().T)
    slopes.append(np.eye(M))
    inverse = np.linalg.inv(covariance(theta.ravel()))
    whitened = [inverse @ slope for slope in slopes]
    F = T * np.array([[np.sum(a * b.T).real for a in whitened] for b in whitened])
    expected = np.linalg.inv(F)[: theta.size, : theta.size]
    assert_same_covariance(stochastic_bound(manifold, theta, snr, T), expected)


@pytest.mark.parametrize(("manifold", "theta", "snr"), SCENES)
def test_the_deterministic_bound_follows_from_the_model_with_unknown_symbols(manifold, theta, snr):
    """F = 2·Re[JᴴJ], where J contains the derivatives of the mean of Y with respect to θ, Re S and Im S."""
    theta, T = np.array(theta), 6
    K = len(theta)
    S = np.sqrt(snr)[:, None] * complex_normal(np.random.default_rng(0), (K, T))
    by_symbols = np.kron(np.eye(T), responses(manifold, theta, K))  # the snapshots are stacked
    J = np.hstack([
        by_theta(lambda x: (responses(manifold, x, K) @ S).T.ravel(), theta).T, by_symbols, 1j * by_symbols
    ])  # fmt: skip
    scale = np.linalg.norm(J, axis=0)
    F = 2 * ((J / scale).conj().T @ (J / scale)).real
    expected = (np.linalg.inv(F) / np.outer(scale, scale))[: theta.size, : theta.size]
    assert_same_covariance(deterministic_bound(manifold, theta, S), expected)


@pytest.mark.parametrize("origin", ["first", "center"])
def test_one_source_and_a_ula_give_the_bounds_of_a_chirp(origin):
    """The phase ωm + ςm² of the Fresnel model has the bounds of a chirp's frequency and rate (Djurić & Kay 1990).

    Relative to the centre, both decouple, and ω has the bound of a tone (Rife & Boorstyn 1974; far-field azimuth).
    """
    M, T, snr = 16, 7, 0.4
    step = 0.5 * WAVELENGTH
    manifold = Manifold(
        ULA(elements=M, spacing_wavelengths=0.5, origin=origin).place(WAVELENGTH), WAVELENGTH, "fresnel", False
    )
    theta = np.array([[0.4, 0.3]])
    azimuth, r = theta[0]
    k = 2 * math.pi / WAVELENGTH
    slopes = np.array([  # of ω = kδ·sinφ and ς = −kδ²cos²φ/2r
        [k * step * math.cos(azimuth), 0.0],
        [k * step**2 * math.cos(azimuth) * math.sin(azimuth) / r, k * step**2 * math.cos(azimuth) ** 2 / (2 * r**2)],
    ])  # fmt: skip
    S = np.full((1, T), math.sqrt(snr), complex)
    chirp = M * (M**2 - 1) * (M**2 - 4)
    rate = 6 * (2 * M - 1) * (8 * M - 11) / chirp if origin == "first" else 6 / (M * (M**2 - 1))
    expected = np.array([rate, 90 / chirp]) / (T * snr)
    C = deterministic_bound(manifold, theta, S)
    assert_allclose(np.diag(slopes @ C @ slopes.T), expected, rtol=1e-9)
    # for one source with random symbols, the bounds differ by one factor
    C = stochastic_bound(manifold, theta, np.array([snr]), T)
    assert_allclose(np.diag(slopes @ C @ slopes.T), expected * (1 + 1 / (M * snr)), rtol=1e-9)


@pytest.mark.parametrize(("snr_db", "bounds"), [(0, [0.0220, 0.0598, 0.2271]), (10, [0.0069, 0.0188, 0.0716])])
def test_reference_values_for_three_sources(snr_db, bounds):
    C = stochastic_bound(PAPER, THREE, np.full(3, 10 ** (snr_db / 10)), 200)
    assert_allclose(position_bounds(C, THREE), bounds, rtol=0, atol=6e-5)
    assert_allclose(position_bounds(C, THREE), oracles.position_bounds(PAPER, THREE, snr_db, 200), rtol=1e-9)


def test_position_bounds_do_not_depend_on_the_frame():
    rng = np.random.default_rng(3)
    positions = rng.uniform(-0.05, 0.05, (12, 3))
    theta = np.array([[-0.4, 0.3, 0.2], [0.5, -0.2, 0.3]])
    snr, S = np.array([1.0, 4.0]), complex_normal(rng, (2, 30))
    rotation = Rotation.random(rng=rng).as_matrix()
    x, y, z = (cartesian(theta) @ rotation.T).T
    r = np.sqrt(x * x + y * y + z * z)
    rotated = np.stack([np.arctan2(y, x), np.arcsin(z / r), r], axis=1)
    one, other = (Manifold(q, WAVELENGTH, "exact", True) for q in (positions, positions @ rotation.T))
    for bound in (lambda m, t: stochastic_bound(m, t, snr, 30), lambda m, t: deterministic_bound(m, t, S)):
        assert_allclose(
            position_bounds(bound(other, rotated), rotated), position_bounds(bound(one, theta), theta), rtol=1e-9
        )


@pytest.mark.parametrize(("manifold", "theta", "snr"), SCENES)
def test_bounds_scale_with_the_snapshots_and_follow_the_order_of_the_sources(manifold, theta, snr):
    theta, snr = np.array(theta), np.array(snr)
    C = stochastic_bound(manifold, theta, snr, 10)
    assert_allclose(stochastic_bound(manifold, theta, snr, 40), C / 4, rtol=1e-12)
    backwards = np.arange(theta.size).reshape(theta.shape)[::-1].ravel()
    assert_allclose(stochastic_bound(manifold, theta[::-1], snr[::-1], 10), C[np.ix_(backwards, backwards)], rtol=1e-6)


@pytest.mark.parametrize(("manifold", "theta", "snr"), SCENES)
def test_the_stochastic_bound_is_not_below_the_deterministic_one(manifold, theta, snr):
    """Stochastic ≥ deterministic if SSᴴ/T equals the covariance of the random symbols (Stoica & Nehorai 1990)."""
    theta, snr, T = np.array(theta), np.array(snr), 8
    orthogonal = np.fft.fft(np.eye(T))[: len(snr)]
    by_power = []
    for power in (1.0, 1e4):
        stochastic = stochastic_bound(manifold, theta, power * snr, T)
        deterministic = deterministic_bound(manifold, theta, np.sqrt(power * snr)[:, None] * orthogonal)
        d = 1 / np.sqrt(np.diag(stochastic))
        assert np.linalg.eigvalsh(d[:, None] * (stochastic - deterministic) * d).min() > -1e-9
        by_power.append(position_bounds(stochastic, theta) / position_bounds(deterministic, theta))
    assert by_power[0].min() > 1.002
    assert_allclose(by_power[1], 1, rtol=1e-2)


def test_bounds_grow_with_the_inverse_square_of_a_small_separation_and_become_infinite():
    separations = 10.0 ** -np.arange(4, 9)
    bounds = []
    for separation in separations:
        theta = THREE.copy()
        theta[1] = theta[0] + [separation, 0]
        bounds.append(position_bounds(stochastic_bound(PAPER, theta, np.full(3, 10.0), 200), theta))
    near, apart = np.array(bounds)[:, 0], np.array(bounds)[:, 2]
    finite = np.isfinite(near)
    assert finite.tolist() == sorted(finite, reverse=True) and 3 <= finite.sum() < len(finite)
    assert_allclose(near[finite] * separations[finite] ** 2, near[0] * separations[0] ** 2, rtol=0.03)
    assert_allclose(apart[finite], apart[0], rtol=1e-3)


@pytest.mark.parametrize(
    ("manifold", "theta"),
    [
        (PAPER, THREE[[0, 0, 2]]),  # two coincident sources
        (PAPER.under("planar"), THREE),  # the range is undetermined
        (Manifold(np.array([[0.0, 0, 0], [0, 0.01, 0]]), WAVELENGTH, "exact", False), np.array([[0.3, 1.0]])),
        (Manifold(np.eye(3) * 0.01, WAVELENGTH, "exact", True), np.array([[0.3, 0.2, 1.0], [0.5, 0.1, 2.0]])),
    ],
    ids=["coincident", "planar", "two elements", "one equation"],
)
def test_undetermined_sources_have_an_infinite_bound(manifold, theta):
    K = len(theta)
    S = complex_normal(np.random.default_rng(0), (K, 20))
    for C in (stochastic_bound(manifold, theta, np.ones(K), 20), deterministic_bound(manifold, theta, S)):
        assert np.isinf(C).all()
        assert np.isinf(position_bounds(C, theta)).all()
