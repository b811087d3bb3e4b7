"""The conditional fit: one source given others, against the explicit projector on all of them."""

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.conditional_fit import LEAST, ConditionalFit
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
PLANE = Manifold(
    ULA(elements=37, spacing_wavelengths=0.25, origin="first").place(WAVELENGTH), WAVELENGTH, "exact", False
)
SPACE = Manifold(
    UPA(columns=6, rows=5, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH), WAVELENGTH, "fresnel", True
)
BOX = {2: (np.array([-1.0, 0.5]), np.array([1.0, 10.0])), 3: (np.array([-1.0, -0.5, 0.5]), np.array([1.0, 0.5, 10.0]))}
OTHERS = {2: np.array([[-0.7, 2.0], [0.2, 4.0]]), 3: np.array([[-0.7, 0.2, 2.0], [0.2, -0.3, 0.7]])}


def factor(manifold: Manifold, columns: int, seed: int = 0) -> np.ndarray:
    """Noisy snapshots of three sources, two of which are the others."""
    rng = np.random.default_rng(seed)
    theta = np.vstack([OTHERS[manifold.dimension], rng.uniform(*BOX[manifold.dimension])])
    noise = complex_normal(rng, (manifold.elements, columns))
    return 5 * manifold.response(theta).T @ complex_normal(rng, (3, columns)) + noise


def problem(manifold: Manifold, F: np.ndarray, others: np.ndarray) -> ConditionalFit:
    return ConditionalFit(F, manifold, *BOX[manifold.dimension], others)


def points(dimension: int, count: int = 40) -> np.ndarray:
    lower, upper = BOX[dimension]
    corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), axis=-1).reshape(-1, dimension)
    return np.vstack([np.random.default_rng(1).uniform(lower, upper, (count, dimension)), corners])


def explicit(manifold: Manifold, F: np.ndarray, others: np.ndarray, theta: np.ndarray) -> float:
    """Return ‖(I − P)F‖² with an explicit projector on the responses of all sources."""
    return oracles.esf(F, np.array([oracles.response(manifold, row) for row in [*others, theta]]).T)


@pytest.mark.parametrize(
    "columns", [3, 37, *(pytest.param(columns, marks=pytest.mark.slow) for columns in (1, 20, 60))]
)
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper", "planar"])
@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
def test_values_agree_with_the_explicit_projector(manifold, wavefront, columns):
    """For no to seven other sources: four rows are processed at once, so each remainder occurs."""
    manifold, d = manifold.under(wavefront), manifold.dimension
    F, X = factor(manifold, columns), points(d, 20)
    for count in range(8):
        others = np.random.default_rng(count).uniform(*BOX[d], (count, d))
        fit = problem(manifold, F, others)
        values = fit.evaluate(X)
        condition = [np.linalg.cond(manifold.response(np.vstack([others, x])).T) for x in X]
        known = np.array(condition) < 100
        assert known.sum() > 10 or count > 4
        expected = np.array([explicit(manifold, F, others, x) for x in X])
        energy = np.linalg.norm(F) ** 2
        assert_allclose(values[known], expected[known], rtol=0, atol=1e-11 * energy)
        assert ((values >= 0) & (values <= energy)).all()
        assert_array_equal([fit.value(x) for x in X], values)
        assert_array_equal([fit.evaluate(x[None])[0] for x in X[:3]], values[:3])
        assert fit.evaluate(X[:0]).shape == (0,)


def test_without_others_it_is_rls():
    F, X = factor(PLANE, 60), points(2)
    fit = problem(PLANE, F, np.empty((0, 2)))
    assert_allclose(fit.evaluate(X), RLS(F, PLANE, *BOX[2]).evaluate(X), rtol=1e-12)


@pytest.mark.parametrize("columns", [3, 60])
@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper", "planar"])
@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
def test_gradient_agrees_with_finite_differences(manifold, wavefront, count, columns):
    manifold, d = manifold.under(wavefront), manifold.dimension
    F = factor(manifold, columns)
    fit, energy = problem(manifold, F, OTHERS[d][:count]), np.linalg.norm(F) ** 2
    for x in points(d, 15)[:15]:
        value, gradient = fit.value_and_gradient(x)
        assert value == pytest.approx(fit.value(x), rel=1e-12)
        expected = oracles.central_difference(fit.value, x, np.full(d, 1e-6))
        assert_allclose(gradient, expected, rtol=1e-5, atol=1e-8 * energy)


def test_gradient_next_to_another_source():
    """The gain N/D is a ratio of small numbers there; differences over 0.1 of the distance have an error of 1 %."""
    F = factor(PLANE, 20)
    fit = problem(PLANE, F, OTHERS[2])
    for gap in (1e-1, 1e-2, 1e-3):
        x = OTHERS[2][0] + [gap, 0.3 * gap]
        expected = oracles.central_difference(fit.value, x, np.full(2, 0.1 * gap))
        _, gradient = fit.value_and_gradient(x)
        assert np.linalg.norm(gradient - expected) < 0.02 * np.linalg.norm(expected)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-12, 1e-16, 0.0])
def test_a_candidate_next_to_another_source_is_exact_or_adds_nothing(gap):
    F = factor(PLANE, 20)
    others = OTHERS[2]
    x = others[0] + [gap, 0.0]
    fit = problem(PLANE, F, others)
    a, A = PLANE.response(x), PLANE.response(others).T
    distance = np.linalg.norm(a - A @ (np.linalg.pinv(A) @ a)) ** 2 / len(a)
    within = distance < LEAST
    assert within == (gap < 1e-5)
    expected = oracles.esf(F, A) if within else explicit(PLANE, F, others, x)
    assert fit.value(x) == pytest.approx(expected, rel=1e-10 if within else 1e-6)
    value, gradient = fit.value_and_gradient(x)
    assert value == pytest.approx(fit.value(x), rel=1e-10)
    assert np.isfinite(gradient).all()
    assert (gradient == 0).all() == within


def test_other_sources_that_coincide_count_once():
    F, X = factor(PLANE, 20), points(2)
    for gap in (0.0, 1e-12, 1e-7):
        twins = np.vstack([OTHERS[2], OTHERS[2][0] + [gap, 0.0], OTHERS[2][1]])
        expected = problem(PLANE, F, OTHERS[2]).evaluate(X)
        assert_allclose(problem(PLANE, F, twins).evaluate(X), expected, rtol=0, atol=1e-4 * gap + 1e-8)


def test_as_many_others_as_elements_leave_nothing():
    """Eight elements: the span of the others is all there is, or all that 1e-8 of it leaves; never NaN or negative."""
    small = Manifold(PLANE.positions[:8] * 4, WAVELENGTH, "exact", False)
    F, X = factor(small, 5), points(2)
    for count in (7, 8, 12):
        others = np.random.default_rng(0).uniform(*BOX[2], (count, 2))
        fit = problem(small, F, others)
        assert (fit.evaluate(X) >= 0).all()
        assert (fit.evaluate(X) <= 1e-6 * np.linalg.norm(F) ** 2).all() or count == 7
        assert all(np.isfinite(fit.value_and_gradient(x)[1]).all() for x in X)


def test_the_order_of_the_others_and_the_basis_of_the_factor_do_not_matter():
    rng = np.random.default_rng(3)
    F, X = factor(PLANE, 20), points(2)
    unitary = np.linalg.qr(complex_normal(rng, (20, 20)))[0]
    values = problem(PLANE, F, OTHERS[2]).evaluate(X)
    assert_allclose(problem(PLANE, F @ unitary, OTHERS[2][::-1]).evaluate(X), values, rtol=1e-10)
    assert_allclose(problem(PLANE, 1e6 * F, OTHERS[2]).evaluate(X), 1e12 * values, rtol=1e-10)


def test_clean_data_are_explained_at_the_last_source():
    rng = np.random.default_rng(0)
    last = np.array([0.5, 1.5])
    F = PLANE.response(np.vstack([OTHERS[2], last])).T @ complex_normal(rng, (3, 20))
    fit = problem(PLANE, F, OTHERS[2])
    assert 0 <= fit.value(last) < 1e-12 * np.linalg.norm(F) ** 2
    assert fit.value(last + np.array([0.01, 0.1])) > 1e-4 * np.linalg.norm(F) ** 2


@pytest.mark.parametrize(
    ("F", "others", "complaint"),
    [
        (np.ones((23, 5), complex), OTHERS[2], r"factor: expected shape \(37, c\), got \(23, 5\)"),
        (np.full((37, 5), np.nan + 0j), OTHERS[2], "factor: expected finite data"),
        (np.ones((37, 5), complex), OTHERS[3], r"others: expected finite sources of shape \(k, 2\)"),
        (np.ones((37, 5), complex), np.full((1, 2), np.nan), r"others: .* got \[\[nan, nan\]\]"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(F, others, complaint):
    with pytest.raises(ValueError, match=complaint):
        problem(PLANE, F, others)


def test_a_box_of_another_dimension_is_refused():
    with pytest.raises(ValueError, match=r"lower, upper: expected shape \(2,\)"):
        ConditionalFit(factor(PLANE, 5), PLANE, *BOX[3], OTHERS[2])
