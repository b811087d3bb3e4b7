"""Gradients where a source comes near to an element, or meets it, against derivatives in extended precision."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.wavefronts import Manifold

R = 5.0  # [λ] of the element that the source comes near to
RNG = np.random.default_rng(0)
OTHERS = RNG.normal(scale=3.0, size=(8, 3))
LONG = np.longdouble  # 64 bits and exponents down to 1e-4932


def manifold(element: list[float], d: int) -> Manifold:
    """An array in wavelengths of 1 m, with the element in place 4."""
    positions = np.insert(OTHERS, 4, element, axis=0)
    return Manifold(positions if d == 3 else positions * [1.0, 1.0, 0.0], 1.0, "exact", d == 3)


def phase_slopes(manifold: Manifold, theta: np.ndarray) -> np.ndarray:
    """∂f/∂θ of every element (d, M) in extended precision: f = r − ‖p − q‖, where p ≠ q."""
    azimuth, elevation, r = (LONG(v) for v in (theta[0], theta[1] if len(theta) == 3 else 0.0, theta[-1]))
    (ca, sa), (ce, se) = ((np.cos(v), np.sin(v)) for v in (azimuth, elevation))
    u = np.array([ce * ca, ce * sa, se])
    turns = [np.array([-ce * sa, ce * ca, LONG(0)]), np.array([-se * ca, -se * sa, ce])][: len(theta) - 1]
    # 1 − cos without cancellation, which is what separates p from an element on the x axis
    away = -2 * r * np.array([np.sin(azimuth / 2) ** 2 * ce + np.sin(elevation / 2) ** 2, LONG(0), LONG(0)])
    on_axis = np.array([r, LONG(0), LONG(0)]) - manifold.positions.astype(LONG)
    p_q = on_axis + away + np.array([LONG(0), r * ce * sa, r * se])
    v = p_q / np.sqrt(np.sum(p_q**2, axis=1))[:, None]
    return np.array([*(-r * (v @ turn) for turn in turns), 1 - v @ u]).astype(float)


def expected_gradient(manifold: Manifold, F: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """−2Re tr(Vᴴ∂A·C) with V = (I − P_A)F and C = A⁺F, for the derivatives of ``phase_slopes``."""
    A = manifold.response(theta).T
    C = np.linalg.pinv(A) @ F
    V = F - A @ C
    D = [2j * np.pi * phase_slopes(manifold, row) * a for row, a in zip(theta, A.T, strict=True)]
    return np.array([-2 * np.vdot(V, np.outer(column, C[k])).real for k, d in enumerate(D) for column in d])


def box(d: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([-2.0, -1.0, 1e-170])[[0, 2] if d == 2 else [0, 1, 2]], np.array([2.0, 1.0, 50.0])[-d:]


def gradients(manifold: Manifold, theta: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The gradients and what is expected: of RLS for one source, and of SubspaceFit with a second source far away."""
    d = manifold.dimension
    Y = complex_normal(RNG, (manifold.elements, 4))
    other = np.array([0.7, 0.2, 30.0])[[0, 2] if d == 2 else [0, 1, 2]]
    both = np.stack([other, theta])
    fit = SubspaceFit(Y, manifold, *box(d), sources=2)
    return [
        (RLS(Y, manifold, *box(d)).value_and_gradient(theta)[1], expected_gradient(manifold, Y, theta[None])),
        (fit.value_and_gradient(both.ravel())[1], expected_gradient(manifold, Y, both)),
    ]


DISTANCES = pytest.mark.parametrize("distance", [1e-3, -1e-3, 1e-5, 1e-8, 1e-12, -1e-15, 1e-40, 1e-100, 1e-160])


@DISTANCES
@pytest.mark.parametrize("d", [2, 3])
def test_beside_an_element_in_azimuth(distance, d):
    theta = np.array([distance / R, 0.0, R])[[0, 2] if d == 2 else [0, 1, 2]]
    for gradient, expected in gradients(manifold([R, 0.0, 0.0], d), theta):
        assert_allclose(gradient, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@DISTANCES
def test_above_an_element_in_elevation(distance):
    for gradient, expected in gradients(manifold([R, 0.0, 0.0], 3), np.array([distance / R / 2, distance / R, R])):
        assert_allclose(gradient, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("distance", [1e-3, -1e-3, 1e-8, -1e-8, 4e-15, -4e-15])
@pytest.mark.parametrize("d", [2, 3])
def test_on_the_ray_of_an_element(distance, d):
    theta = np.array([0.0, 0.0, R + distance])[-d:]
    for gradient, expected in gradients(manifold([R, 0.0, 0.0], d), theta):
        assert_allclose(gradient, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("r", [1e-3, 1e-8, 1e-100, 1e-160])
@pytest.mark.parametrize("d", [2, 3])
def test_at_an_element_at_the_origin_whose_phase_is_zero(r, d):
    theta = np.array([0.3, 0.2, r])[[0, 2] if d == 2 else [0, 1, 2]]
    for gradient, expected in gradients(manifold([0.0, 0.0, 0.0], d), theta):
        assert_allclose(gradient, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("d", [2, 3])
def test_at_an_element_the_gradient_is_that_a_little_farther_out(d):
    on, beyond = np.array([0.0, 0.0, R])[-d:], np.array([0.0, 0.0, np.nextafter(R, 9.0)])[-d:]
    array = manifold([R, 0.0, 0.0], d)
    Y = complex_normal(RNG, (9, 4))
    for problem in (RLS(Y, array, *box(d)), SubspaceFit(Y, array, *box(d), sources=1)):
        gradient, expected = problem.value_and_gradient(on)[1], problem.value_and_gradient(beyond)[1]
        assert_allclose(gradient, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())  # phases have 6 digits there


@DISTANCES
@pytest.mark.parametrize("d", [2, 3])
def test_the_derivatives_for_bounds(distance, d):
    theta = np.array([[distance / R, 0.0, R]])[:, [0, 2] if d == 2 else [0, 1, 2]]
    array = manifold([R, 0.0, 0.0], d)
    a, derivatives = array.response_and_derivatives(theta)
    slopes = (derivatives[0] / (2j * np.pi * a[0])).real
    assert_allclose(slopes, phase_slopes(array, theta[0]), rtol=1e-9, atol=1e-9)
