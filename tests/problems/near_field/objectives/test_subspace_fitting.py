import math

import numpy as np
import oracles
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from nfbench import Incompatible
from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.subspace import signal_subspace
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
PLANE = Manifold(
    ULA(elements=24, spacing_wavelengths=0.25, origin="first").place(WAVELENGTH), WAVELENGTH, "exact", False
)
SPACE = Manifold(
    UPA(columns=4, rows=3, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH), WAVELENGTH, "fresnel", True
)
BOX = {2: (np.array([-1.0, 0.5]), np.array([1.0, 10.0])), 3: (np.array([-1.0, -0.5, 0.5]), np.array([1.0, 0.5, 10.0]))}


def subspace(manifold: Manifold, sources: int, seed: int = 0) -> np.ndarray:
    """A signal subspace of noisy data of ``sources`` sources."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(*BOX[manifold.dimension], (sources, manifold.dimension))
    Y = 3 * manifold.response(theta).T @ complex_normal(rng, (sources, 50))
    return signal_subspace(Y + complex_normal(rng, Y.shape), sources)


def problem(manifold: Manifold, U_s: np.ndarray) -> SubspaceFit:
    return SubspaceFit(U_s, manifold, *BOX[manifold.dimension])


def points(esf: SubspaceFit, count: int = 30, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(esf.lower, esf.upper, (count, esf.dimension))


def condition(manifold: Manifold, x: np.ndarray, sources: int) -> float:
    """The condition of A; G squares it."""
    return float(np.linalg.cond(manifold.response(x.reshape(sources, -1))))


def explicit(manifold: Manifold, U_s: np.ndarray, x: np.ndarray) -> float:
    theta = x.reshape(U_s.shape[1], -1)
    return oracles.esf(U_s, np.array([oracles.response(manifold, row) for row in theta]).T)


@pytest.mark.parametrize("sources", [1, 2, 3, 5])
@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
def test_values_agree_with_the_explicit_projector(manifold, sources):
    U_s = subspace(manifold, sources)
    esf = problem(manifold, U_s)
    X = points(esf)
    expected = [explicit(manifold, U_s, x) for x in X]
    assert esf.dimension == sources * manifold.dimension
    squared = np.array([condition(manifold, x, sources) for x in X]) ** 2
    well = squared < 1e4
    assert well.any()
    assert_allclose(esf.evaluate(X[well]), np.array(expected)[well], rtol=1e-10)
    assert (np.abs(esf.evaluate(X) - expected) <= 1e-10 + 1e-14 * squared).all()
    assert esf.evaluate(X[:0]).shape == (0,)
    assert_allclose([esf.value(x) for x in X], esf.evaluate(X), rtol=1e-12, atol=1e-14)


def test_values_at_the_corners_of_the_box():
    U_s = subspace(PLANE, 2)
    esf = problem(PLANE, U_s)
    corners = np.stack(np.meshgrid(*zip(esf.lower, esf.upper, strict=True)), axis=-1).reshape(-1, 4)
    apart = np.abs(corners[:, 0] - corners[:, 2]) > 0
    expected = [explicit(PLANE, U_s, x) for x in corners[apart]]
    assert_allclose(esf.evaluate(corners[apart]), expected, rtol=1e-10)


@pytest.mark.parametrize(("gap", "tolerance"), [(1e-2, 1e-10), (1e-3, 1e-9), (1e-4, 1e-7), (1e-5, 1e-5)])
def test_close_candidates_lose_no_more_than_the_condition_of_g(gap, tolerance):
    """Two candidates ``gap`` rad apart: the pivot is some (10·gap)² of M, and its relative rounding that of J."""
    U_s = subspace(PLANE, 3)
    esf = problem(PLANE, U_s)
    X = points(esf)
    X[:, 2:4] = X[:, 0:2] + [gap, 0.0]
    X = np.clip(X, esf.lower, esf.upper)
    expected = [explicit(PLANE, U_s, x) for x in X]
    assert_allclose(esf.evaluate(X), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("sources", [2, 3, 6])
def test_coincident_candidates_count_once_and_give_no_nan(sources):
    U_s = subspace(PLANE, sources)
    esf = problem(PLANE, U_s)
    theta = np.array([0.3, 4.0])
    x = np.tile(theta, sources)
    single = oracles.esf(U_s, oracles.response(PLANE, theta)[:, None])
    assert esf.evaluate(x[None])[0] == pytest.approx(single, abs=1e-6)
    value, gradient = esf.value_and_gradient(x)
    assert value == pytest.approx(single, abs=1e-6)
    assert np.isfinite(gradient).all()
    for gap in (1e-16, 1e-12, 1e-9, 1e-7):
        near = x.copy()
        near[::2] += gap * np.arange(sources)
        assert 0 <= esf.value(near) <= sources
        assert np.isfinite(esf.value_and_gradient(near)[1]).all()


@pytest.mark.parametrize("sources", [1, 2, 3])
@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper", "planar"])
def test_gradient_agrees_with_finite_differences(manifold, wavefront, sources):
    esf = problem(manifold.under(wavefront), subspace(manifold, sources))
    well = [x for x in points(esf, 20) if condition(manifold.under(wavefront), x, sources) < 30]  # else no digits
    assert len(well) >= 10
    for x in well:
        value, gradient = esf.value_and_gradient(x)
        assert value == pytest.approx(esf.value(x), rel=1e-10, abs=1e-13)
        expected = oracles.central_difference(esf.value, x, np.full(len(x), 1e-6))
        assert_allclose(gradient, expected, rtol=1e-5, atol=1e-7)


def test_clean_data_have_their_minimum_zero_at_the_truth():
    rng = np.random.default_rng(0)
    theta = np.array([[-0.5, 2.0], [0.1, 3.0], [0.6, 1.5]])
    Y = PLANE.response(theta).T @ complex_normal(rng, (3, 20))
    esf = problem(PLANE, signal_subspace(Y, 3))
    value, gradient = esf.value_and_gradient(theta.ravel())
    assert 0 <= value < 1e-12
    assert_allclose(gradient, 0.0, atol=1e-6)
    assert esf.value(theta.ravel() + 0.05) > 0.05


def test_rounding_does_not_make_the_minimum_negative():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        theta = rng.uniform(*BOX[2], (3, 2))
        Y = PLANE.response(theta).T @ complex_normal(rng, (3, 20))
        esf = problem(PLANE, signal_subspace(Y, 3))
        assert esf.evaluate(theta.reshape(1, 6))[0] >= 0
        assert esf.value_and_gradient(theta.ravel())[0] >= 0


@settings(deadline=None, database=None, derandomize=True, max_examples=40)
@given(seed=st.integers(0, 10_000), sources=st.integers(1, 4), phase=st.floats(-math.pi, math.pi))
def test_what_must_hold_for_any_data(seed, sources, phase):
    rng = np.random.default_rng(seed)
    U_s = subspace(PLANE, sources, seed)
    esf = problem(PLANE, U_s)
    X = points(esf, 8, seed)
    values = esf.evaluate(X)
    assert (values >= 0).all()
    assert (values <= sources).all()
    atol = 1e-10 + 1e-14 * max(condition(PLANE, x, sources) for x in X) ** 2
    order = rng.permutation(sources)
    permuted = X.reshape(len(X), sources, 2)[:, order].reshape(X.shape)
    assert_allclose(esf.evaluate(permuted), values, rtol=0, atol=atol)
    # another basis of the same subspace, of which a common phase is one
    unitary = np.linalg.qr(complex_normal(rng, (sources, sources)))[0] * np.exp(1j * phase)
    assert_allclose(problem(PLANE, U_s @ unitary).evaluate(X), values, rtol=0, atol=atol)


def test_turning_array_and_candidates_together_changes_nothing():
    Q = np.random.default_rng(3).normal(scale=0.1, size=(12, 3))
    turn = 0.8
    c, s = math.cos(turn), math.sin(turn)
    still = Manifold(Q, WAVELENGTH, "exact", True)
    turned = Manifold(Q @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), WAVELENGTH, "exact", True)
    U_s = subspace(still, 2)
    X = points(problem(still, U_s))
    assert_allclose(
        problem(turned, U_s).evaluate(X + np.tile([turn, 0.0, 0.0], 2)), problem(still, U_s).evaluate(X), rtol=1e-9
    )


def test_signal_subspace_is_that_of_the_covariance():
    Y = complex_normal(np.random.default_rng(0), (24, 60)) * np.linspace(1, 3, 24)[:, None]
    U_s = signal_subspace(Y, 4)
    R = Y @ Y.conj().T / 60
    eigenvalues, vectors = np.linalg.eigh(R)
    assert_allclose(U_s.conj().T @ U_s, np.eye(4), atol=1e-13)
    assert_allclose(R @ U_s, U_s * eigenvalues[::-1][:4], rtol=0, atol=1e-11)
    top = vectors[:, -4:]
    assert_allclose(U_s @ U_s.conj().T, top @ top.conj().T, rtol=0, atol=1e-11)


def test_signal_subspace_has_a_phase_of_its_own():
    Y = complex_normal(np.random.default_rng(0), (24, 60))
    U_s = signal_subspace(Y, 3)
    assert_allclose(signal_subspace(Y * np.exp(0.7j), 3), U_s, rtol=0, atol=1e-11)
    largest = U_s[np.argmax(np.abs(U_s), axis=0), range(3)]
    assert_allclose(largest.imag, 0.0, atol=1e-15)
    assert (largest.real > 0).all()


def test_a_subspace_beyond_the_data_is_refused():
    Y = complex_normal(np.random.default_rng(0), (5, 7))
    for sources in (0, 6):
        with pytest.raises(ValueError, match=f"sources: expected a number from 1 to M = 5, got {sources}"):
            signal_subspace(Y, sources)
    with pytest.raises(Incompatible, match=r"snapshots: expected at least 6 for the signal subspace of 6 .*, got 5"):
        signal_subspace(Y.T, 6)


def test_arguments_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"F: expected shape \(24, c\), got \(12, 2\)"):
        problem(PLANE, np.ones((12, 2), complex))
    with pytest.raises(ValueError, match=r"lower, upper: expected shape \(2,\)"):
        SubspaceFit(subspace(PLANE, 2), PLANE, *BOX[3])
