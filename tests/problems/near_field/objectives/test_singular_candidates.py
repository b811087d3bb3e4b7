"""Candidates whose Gram matrix is nearly singular: J against a pivoted QR, permutations, twins, and gradients."""

import numpy as np
import oracles
import pytest
import scipy.linalg
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.problems.near_field.arrays import UCA, ULA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.kernels.singular import RANK
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
BOX = np.array([-1.1, 0.4]), np.array([1.1, 20.0])


def ula(elements: int) -> Manifold:
    place = ULA(elements=elements, spacing_wavelengths=0.25, origin="center").place(WAVELENGTH)
    return Manifold(place, WAVELENGTH, "exact", has_elevation=False)


def problem(manifold: Manifold, sources: int, columns: int | None = None) -> SubspaceFit:
    """A fit to an orthonormal factor, or to one with as many columns as given."""
    F = complex_normal(np.random.default_rng(0), (manifold.elements, columns or sources))
    return SubspaceFit(F if columns else np.linalg.qr(F).Q, manifold, *BOX, sources=sources)


def points(fit: SubspaceFit, count: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(fit.lower, fit.upper, (count, fit.dimension))


def by_pivoted_qr(fit: SubspaceFit, x: np.ndarray) -> list[float]:
    """‖F‖² − ‖QᴴF‖² at the rank by RANK; two values where the rank depends on rounding.

    Which columns span the same space as others, up to RANK, depends on which comes first. All have the same length, so
    the order is made definite by tiny factors, which do not change any span.
    """
    theta = x.reshape(fit.sources, -1)
    A = fit.manifold.response(theta[np.lexsort(theta.T[::-1])]).T
    Q, R, _ = scipy.linalg.qr(A * (1 - 1e-9 * np.arange(fit.sources)), mode="economic", pivoting=True)
    pivots = np.abs(np.diag(R)) ** 2 / len(A)
    energies = np.linalg.norm(Q.conj().T @ fit.factor, axis=1) ** 2
    ranks = {int(np.sum(pivots > RANK * edge)) for edge in (0.999, 1.001)}
    return [float(np.linalg.norm(fit.factor) ** 2 - energies[:rank].sum()) for rank in ranks]


CASES = [
    (ula(8), 6, None),
    (ula(8), 7, None),
    (ula(8), 8, None),
    (ula(8), 7, 40),
    (ula(8), 3, 2),
    (ula(24), 23, None),
    (ula(24), 24, None),
    (ula(24), 30, 24),
    (
        Manifold(
            UCA(elements=9, radius_wavelengths=2.0, origin="center").place(WAVELENGTH), WAVELENGTH, "paper", False
        ),
        8,
        None,
    ),
]
EVERY = pytest.mark.parametrize(("manifold", "sources", "columns"), CASES)


@EVERY
def test_no_candidate_is_off_against_a_pivoted_qr(manifold, sources, columns):
    fit = problem(manifold, sources, columns)
    energy, X = float(np.linalg.norm(fit.factor) ** 2), points(fit, 1000)
    for x, J in zip(X, fit.evaluate(X), strict=True):
        assert min(abs(J - expected) for expected in by_pivoted_qr(fit, x)) <= 1e-6 * J + 1e-10 * energy
        assert fit.value(x) == J


@EVERY
def test_a_permutation_of_the_sources_changes_nothing(manifold, sources, columns):
    fit, rng = problem(manifold, sources, columns), np.random.default_rng(2)
    energy = float(np.linalg.norm(fit.factor) ** 2)
    for x in points(fit, 300):
        order = rng.permutation(sources)
        permuted = x.reshape(sources, -1)[order].ravel()
        assert abs(fit.value(permuted) - fit.value(x)) <= 1e-9 * fit.value(x) + 1e-11 * energy
        gradient, other = fit.value_and_gradient(x)[1], fit.value_and_gradient(permuted)[1]
        assert np.isfinite(gradient).all()
        assert_allclose(other, gradient.reshape(sources, -1)[order].ravel(), rtol=1e-5, atol=1e-8 * np.abs(other).max())


@pytest.mark.parametrize("columns", [None, 24, 60])
def test_equal_sources_add_nothing(columns):
    manifold = ula(24)
    three, five = problem(manifold, 3, columns), problem(manifold, 5, columns)
    five = SubspaceFit(three.factor, manifold, *BOX, sources=5)
    for x in points(three, 200):
        a, b, c = x.reshape(3, 2)
        J, (dJ_a, dJ_b, dJ_c) = three.value(x), three.value_and_gradient(x)[1].reshape(3, 2)
        twins = np.concatenate([a, b, a, c, a])
        assert five.value(twins) == pytest.approx(J, rel=1e-9)
        value, gradient = five.value_and_gradient(twins)
        assert value == five.value(twins)
        expected = np.concatenate([dJ_a / 3, dJ_b, dJ_a / 3, dJ_c, dJ_a / 3])  # of the pseudo-inverse
        assert_allclose(gradient, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("gap", [1e-3, 1e-4, 1e-5])
def test_the_gradient_of_sources_that_nearly_coincide(gap):
    """Against differences along the direction in which both move together, and apart by a part of the gap."""
    fit = problem(ula(24), 3)
    for x in points(fit, 50):
        x[2:4] = [x[0] + gap, x[1]]
        value, gradient = fit.value_and_gradient(x)
        assert value == fit.value(x)
        for direction, h in ((np.tile([1.0, 0.0], 3), 1e-6), (np.array([-0.5, 0, 0.5, 0, 0, 0]), 1e-2 * gap)):
            expected = (fit.value(x + h * direction) - fit.value(x - h * direction)) / (2 * h)
            assert gradient @ direction == pytest.approx(expected, rel=1e-3, abs=1e-4 + 1e-9 / h)


def test_the_gradient_where_sources_are_nearly_as_many_as_elements():
    fit = problem(ula(8), 6)
    compared = 0
    for x in points(fit, 200):
        A = fit.manifold.response(x.reshape(6, 2)).T
        determinant = np.linalg.det(A.conj().T @ A / 8).real
        if 1e-9 < determinant < 1e-5:  # the rank-revealing route, and differences have digits
            compared += 1
            expected = oracles.central_difference(fit.value, x, np.full(12, 1e-6))
            assert_allclose(fit.value_and_gradient(x)[1], expected, rtol=1e-2, atol=1e-3 * np.abs(expected).max())
    assert compared > 30


def test_both_routes_agree_where_they_meet():
    """A pair that closes in passes from Cholesky's factorization to the rank-revealing one."""
    fit = problem(ula(24), 2)
    gaps = np.geomspace(1e-2, 1e-6, 400)
    X = np.array([[0.2, 3.0, 0.2 + gap, 3.0] for gap in gaps])
    expected = [by_pivoted_qr(fit, x)[0] for x in X]
    assert_allclose(fit.evaluate(X), expected, rtol=1e-9)


def test_the_batch_takes_both_routes():
    fit = problem(ula(24), 3)
    X = points(fit, 20)
    X[::3, 2:4] = X[::3, :2]
    assert_array_equal(fit.evaluate(X), [fit.value(x) for x in X])
