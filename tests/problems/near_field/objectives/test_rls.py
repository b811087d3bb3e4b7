import math

import numpy as np
import oracles
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.rls import RLS, deflate
from nfbench.problems.near_field.subspace import compress
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
PLANE = Manifold(
    ULA(elements=24, spacing_wavelengths=0.25, origin="first").place(WAVELENGTH), WAVELENGTH, "exact", False
)
SPACE = Manifold(
    UPA(columns=4, rows=3, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH), WAVELENGTH, "fresnel", True
)
BOX = {2: (np.array([-1.0, 0.5]), np.array([1.0, 10.0])), 3: (np.array([-1.0, -0.5, 0.5]), np.array([1.0, 0.5, 10.0]))}


def data(manifold: Manifold, snapshots: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    theta = rng.uniform(*BOX[manifold.dimension], (2, manifold.dimension))
    S = complex_normal(rng, (2, snapshots))
    return 5 * manifold.response(theta).T @ S + complex_normal(rng, (manifold.elements, snapshots))


def points(dimension: int, seed: int = 1) -> np.ndarray:
    lower, upper = BOX[dimension]
    corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), axis=-1).reshape(-1, dimension)
    return np.vstack([np.random.default_rng(seed).uniform(lower, upper, (30, dimension)), corners])


def problem(manifold: Manifold, Y: np.ndarray, **options) -> RLS:
    return RLS(Y, manifold, *BOX[manifold.dimension], **options)


@pytest.mark.parametrize("snapshots", [1, 5, 24, 60])
@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
def test_values_agree_with_the_explicit_projector(manifold, snapshots):
    Y = data(manifold, snapshots)
    rls, X = problem(manifold, Y), points(manifold.dimension)
    expected = [oracles.rls(Y, oracles.response(manifold, x)) for x in X]
    assert_allclose(rls.evaluate(X), expected, rtol=1e-10)
    assert_allclose([rls.value(x) for x in X], expected, rtol=1e-10)
    assert rls.dimension == manifold.dimension


def test_compression_keeps_the_energy_and_loses_the_columns():
    Y = data(PLANE, 60)
    L = compress(Y)
    assert L.shape == (24, 24)
    assert_allclose(L @ L.conj().T, Y @ Y.conj().T, rtol=0, atol=1e-11 * np.linalg.norm(Y) ** 2)
    assert compress(Y[:, :24]).shape == (24, 24)
    assert compress(Y[:, :7]).shape == (24, 7)


@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper", "planar"])
def test_gradient_agrees_with_finite_differences(manifold, wavefront):
    rls = problem(manifold.under(wavefront), data(manifold, 40))
    scale = rls.evaluate(points(manifold.dimension)).max()
    for x in points(manifold.dimension):
        value, gradient = rls.value_and_gradient(x)
        assert value == pytest.approx(rls.value(x), rel=1e-12)
        expected = oracles.central_difference(rls.value, x, np.full(len(x), 1e-6))
        assert_allclose(gradient, expected, rtol=1e-6, atol=1e-8 * scale)


def test_repulsion_is_the_printed_penalty():
    Y, x = data(PLANE, 10), np.array([0.3, 4.0])
    detected = x + np.array([[0.0, 0.0], [0.03, 0.04], [0.0, 0.079], [0.09, 0.0]])
    plain = problem(PLANE, Y)
    pushed = problem(PLANE, Y, detected=detected, alpha=700.0, delta_min=0.08)
    penalty = 700 * (0.08 + 0.03 + 0.001)  # the last is out of reach
    assert pushed.value(x) - plain.value(x) == pytest.approx(penalty, rel=1e-9)
    X = np.vstack([x + np.random.default_rng(0).normal(scale=0.05, size=(40, 2)), points(2)])
    expected = [plain.value(p) + oracles.repulsion(p, detected, 700.0, 0.08) for p in X]
    assert_allclose(pushed.evaluate(X), expected, rtol=1e-10)
    assert_allclose([pushed.value(p) for p in X], expected, rtol=1e-10)
    assert pushed.evaluate(X).max() > 0


def test_repulsion_has_a_gradient_off_its_kinks():
    detected = np.array([[0.3, 4.0], [0.33, 4.02]])
    rls = problem(PLANE, data(PLANE, 10), detected=detected, alpha=5000.0, delta_min=0.08)
    for x in detected[0] + np.array([[0.02, 0.01], [-0.03, 0.02], [0.5, 1.0]]):
        expected = oracles.central_difference(rls.value, x, np.full(2, 1e-7))
        assert_allclose(rls.value_and_gradient(x)[1], expected, rtol=1e-5, atol=1e-2)
    assert np.isfinite(rls.value_and_gradient(detected[0])[1]).all()  # on the tip of the cone


def test_alpha_relative_is_in_units_of_energy_per_antenna():
    Y, x = data(PLANE, 60), np.array([[0.3, 4.0]])
    options = {"detected": x, "delta_min": 0.08}
    unit = np.linalg.norm(Y) ** 2 / 24
    relative = problem(PLANE, Y, alpha_relative=2.5, **options).evaluate(x)
    absolute = problem(PLANE, Y, alpha=2.5 * unit, **options).evaluate(x)
    assert_allclose(relative, absolute, rtol=1e-12)
    louder = problem(PLANE, 10 * Y, alpha_relative=2.5, **options).evaluate(x)
    assert_allclose(louder, 100 * relative, rtol=1e-10)


def test_deflation_by_the_true_source_leaves_nothing_of_clean_data():
    theta = np.array([0.37, 3.2])
    a = PLANE.response(theta)
    Y = np.outer(a, complex_normal(np.random.default_rng(0), (30,)))
    energy = np.linalg.norm(Y) ** 2
    assert problem(PLANE, Y).value(theta) <= 1e-12 * energy
    assert np.linalg.norm(deflate(Y, a)) ** 2 <= 1e-24 * energy
    assert problem(PLANE, deflate(Y, a)).evaluate(points(2)).max() <= 1e-20 * energy


def test_rounding_does_not_make_the_minimum_negative():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        theta = rng.uniform(*BOX[2])
        rls = problem(PLANE, np.outer(PLANE.response(theta), complex_normal(rng, (30,))))
        assert rls.evaluate(theta[None])[0] >= 0
        assert rls.value(theta) >= 0
        assert rls.value_and_gradient(theta)[0] >= 0


def test_deflating_the_factor_is_deflating_the_data():
    Y, a = data(PLANE, 60), PLANE.response(np.array([0.2, 2.0]))
    X = points(2)
    P = np.eye(24) - np.outer(a, a.conj()) / 24
    expected = problem(PLANE, P @ Y).evaluate(X)
    assert_allclose(problem(PLANE, deflate(Y, a)).evaluate(X), expected, rtol=1e-10)
    assert_allclose(problem(PLANE, deflate(compress(Y), a)).evaluate(X), expected, rtol=1e-10)
    assert_allclose(a.conj() @ deflate(Y, a), 0.0, atol=1e-10)


@settings(deadline=None, database=None, derandomize=True, max_examples=30)
@given(seed=st.integers(0, 10_000), snapshots=st.integers(1, 40), phase=st.floats(-math.pi, math.pi))
def test_what_must_hold_for_any_data(seed, snapshots, phase):
    rng = np.random.default_rng(seed)
    Y, X = data(PLANE, snapshots, seed), points(2, seed)
    values = problem(PLANE, Y).evaluate(X)
    energy = np.linalg.norm(Y) ** 2
    assert (values >= 0).all()
    assert (values <= energy * (1 + 1e-12)).all()
    # a common phase, and any rotation of the snapshots, change nothing
    assert_allclose(problem(PLANE, np.exp(1j * phase) * Y).evaluate(X), values, rtol=1e-9)
    unitary = np.linalg.qr(complex_normal(rng, (snapshots, snapshots)))[0]
    assert_allclose(problem(PLANE, Y @ unitary).evaluate(X), values, rtol=1e-9)
    # one more snapshot adds what the candidate does not explain of it
    y = complex_normal(rng, (24, 1))
    added = problem(PLANE, np.hstack([Y, y])).evaluate(X) - values
    assert_allclose(added, [oracles.rls(y, PLANE.response(x)) for x in X], rtol=0, atol=1e-10 * energy)


def test_evaluation_does_not_change_its_arguments():
    Y, X = data(PLANE, 60), points(2)
    before = Y.copy(), X.copy()
    rls = problem(PLANE, Y)
    first = rls.evaluate(X)
    assert_allclose(rls.evaluate(X), first, rtol=0, atol=0)
    assert (before[0] == Y).all()
    assert (before[1] == X).all()
    assert rls.evaluate(X[:0]).shape == (0,)


@pytest.mark.parametrize(
    ("Y", "complaint"),
    [
        (np.ones((23, 5), complex), r"Y: expected shape \(24, T\), got \(23, 5\)"),
        (np.ones(24, complex), r"Y: expected shape \(24, T\), got \(24,\)"),
        (np.full((24, 5), np.nan + 0j), "Y: expected finite data"),
    ],
)
def test_data_that_do_not_fit_are_refused(Y, complaint):
    with pytest.raises(ValueError, match=complaint):
        problem(PLANE, Y)


def test_a_box_of_another_dimension_is_refused():
    with pytest.raises(ValueError, match=r"lower, upper: expected shape \(2,\)"):
        RLS(data(PLANE, 5), PLANE, *BOX[3])
