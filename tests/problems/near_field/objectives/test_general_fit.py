"""The general path of objectives and search: the kernels' values for weights of one, plain NumPy for any weights."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench import Incompatible
from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.objectives.conditional_fit import ConditionalFit
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.search import covariance, response_grid, search_greedily, search_locally
from nfbench.problems.near_field.wavefronts import Manifold

LINE = Manifold(ULA(elements=24, spacing_wavelengths=0.5, origin="first").place(0.02), 0.02, "exact", False)
PLANE = Manifold(UPA(columns=5, rows=4, spacing_wavelengths=0.5, origin="center").place(0.02), 0.02, "exact", True)
BOXES = {2: (np.array([-1.0, 0.2]), np.array([1.0, 3.0])), 3: (np.array([-1.0, -0.5, 0.1]), np.array([1.0, 0.5, 1.0]))}
RNG = np.random.default_rng(0)


def noise(*shape):
    return RNG.normal(size=shape) + 1j * RNG.normal(size=shape)


def weighted(manifold, rows=-2):
    M = manifold.elements
    return [
        replace(manifold, weights=noise(M)),
        replace(manifold, weights=noise(M + rows, M)),
        replace(manifold, amplitude="spherical"),
        replace(manifold, weights=noise(M + rows, M), amplitude="spherical"),
    ]


def points(manifold, count, sources=1):
    lower, upper = BOXES[manifold.dimension]
    return RNG.uniform(np.tile(lower, sources), np.tile(upper, sources), (count, sources * manifold.dimension))


def problems(manifold, F, others):
    box = BOXES[manifold.dimension]
    return [
        (RLS(F, manifold, *box), 1),
        (RLS(F, manifold, *box, detected=others, alpha=5.0), 1),
        (SubspaceFit(F, manifold, *box, sources=3), 3),
        (ConditionalFit(F, manifold, *box, others), 1),
    ]


@pytest.mark.parametrize("manifold", [LINE, PLANE], ids=["line", "plane"])
@pytest.mark.parametrize("diagonal", [True, False])
def test_with_unit_weights_values_and_gradients_are_those_of_the_kernels(manifold, diagonal):
    M = manifold.elements
    same = replace(manifold, weights=np.ones(M, dtype=complex) if diagonal else np.eye(M, dtype=complex))
    F, others = noise(M, 4), points(manifold, 2)
    for (kernel, K), (general, _) in zip(problems(manifold, F, others), problems(same, F, others), strict=True):
        X = points(manifold, 20, K)
        assert_allclose(general.evaluate(X), kernel.evaluate(X), rtol=1e-12)
        assert_allclose(general.value(X[0]), kernel.value(X[0]), rtol=1e-12)
        for x in X[:3]:
            assert_allclose(general.value_and_gradient(x)[1], kernel.value_and_gradient(x)[1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("manifold", [LINE, PLANE], ids=["line", "plane"])
@pytest.mark.parametrize("c", [2, 40])
def test_with_any_weights_values_are_those_of_projections(manifold, c):
    for each in weighted(manifold):
        F, others, d = noise(each.elements, c), points(manifold, 2), manifold.dimension
        for problem, K in problems(each, F, others):
            X = points(manifold, 5, K)
            given = others if isinstance(problem, ConditionalFit) else np.empty((0, d))
            for x, value in zip(X, problem.evaluate(X), strict=True):
                A = each.response(np.vstack([given, x.reshape(K, d)])).T
                expected = np.linalg.norm(F - A @ np.linalg.lstsq(A, F, rcond=None)[0]) ** 2
                if isinstance(problem, RLS) and len(problem._detected):
                    distances = np.linalg.norm(x - others, axis=1)
                    expected += 5.0 * np.maximum(0, 0.08 - distances).sum()
                assert_allclose(value, expected, rtol=1e-11)
                assert_allclose(problem.value(x), value, rtol=1e-12)


@pytest.mark.parametrize("manifold", [LINE, PLANE], ids=["line", "plane"])
def test_gradients_are_differences_of_values(manifold):
    for each in weighted(manifold):
        for problem, K in problems(each, noise(each.elements, 3), points(manifold, 2)):
            for x in points(manifold, 2, K):
                gradient = problem.value_and_gradient(x)[1]
                h = 1e-6
                differences = [(problem.value(x + h * e) - problem.value(x - h * e)) / (2 * h) for e in np.eye(len(x))]
                assert_allclose(differences, gradient, rtol=1e-5, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("manifold", [LINE, PLANE], ids=["line", "plane"])
def test_derivatives_of_weighted_responses_are_their_differences(manifold):
    for each in weighted(manifold):
        theta = points(manifold, 1)[0]
        a, derivatives = each.response_and_derivatives(theta[None])
        assert_allclose(a[0], each.response(theta), rtol=1e-12)
        for i, step in enumerate(np.eye(len(theta)) * 1e-6):
            expected = (each.response(theta + step) - each.response(theta - step)) / 2e-6
            assert_allclose(derivatives[0, i], expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_coinciding_sources_add_nothing():
    for manifold in weighted(LINE):
        F = noise(manifold.elements, 3)
        one, two = (SubspaceFit(F, manifold, *BOXES[2], sources=K) for K in (1, 2))
        x = points(LINE, 1)[0]
        assert_allclose(two.value(np.tile(x, 2)), one.value(x), rtol=1e-9)
        assert np.isfinite(two.value_and_gradient(np.tile(x, 2))[1]).all()
        given = ConditionalFit(F, manifold, *BOXES[2], x[None])
        assert_allclose(given.value(x), one.value(x), rtol=1e-9)


@pytest.mark.parametrize("manifold", [LINE, PLANE], ids=["line", "plane"])
def test_with_unit_weights_the_search_is_that_of_the_kernels(manifold):
    box, d = BOXES[manifold.dimension], manifold.dimension
    truth = np.array([[-0.5, 0.5], [0.4, 0.8]]) if d == 2 else np.array([[-0.5, 0.2, 0.15], [0.4, -0.2, 0.25]])
    F = manifold.response(truth).T @ noise(2, 3) + 0.05 * noise(manifold.elements, 3)
    same = replace(manifold, weights=np.eye(manifold.elements, dtype=complex))
    kernel, general = (search_greedily(F, response_grid(each, *box, 1.5), 2, 5) for each in (manifold, same))
    by_azimuth = [each.x.reshape(2, d)[np.argsort(each.x[::d])] for each in (kernel, general)]
    assert_allclose(by_azimuth[1], by_azimuth[0], rtol=1e-7)
    assert_allclose(general.value, kernel.value, rtol=1e-10)
    start = kernel.x + 0.01
    kernel, general = (search_locally(F, each, *box, start) for each in (manifold, same))
    assert_allclose(general.x, kernel.x, rtol=1e-7)
    assert general.steps == kernel.steps
    assert_allclose(general.H, kernel.H, rtol=1e-5, atol=1e-6 * np.abs(kernel.H).max())
    assert_allclose(general.pivot, kernel.pivot, rtol=1e-6)
    theta = kernel.x.reshape(2, d)
    for spread in (None, F * [1.0, 2.0, 0.5]):
        expected = covariance(theta, manifold, *box, F, 0.3, 50, spread)
        assert_allclose(covariance(theta, same, *box, F, 0.3, 50, spread), expected, rtol=1e-6)


def test_the_search_finds_sources_of_a_weighted_array_without_noise():
    truth = np.array([[-0.5, 0.5], [0.4, 0.8]])
    for manifold in weighted(LINE):
        F = manifold.response(truth).T @ noise(2, 3)
        found = search_greedily(F, response_grid(manifold, *BOXES[2], 2.0), 2, 5)
        order = np.argsort(found.x.reshape(2, 2)[:, 0])
        assert_allclose(found.x.reshape(2, 2)[order], truth, rtol=1e-6)
        assert found.value < 1e-15 * np.linalg.norm(F) ** 2


def test_the_local_search_stays_in_the_box_holds_fixed_sources_and_never_gets_worse():
    manifold = weighted(LINE)[3]
    F, (lower, upper) = noise(manifold.elements, 3), BOXES[2]
    problem = SubspaceFit(F, manifold, lower, upper, sources=2)
    for x in points(LINE, 10, 2):
        found = search_locally(F, manifold, lower, upper, x, fixed=1)
        assert_allclose(found.x[:2], x[:2], rtol=0, atol=0)
        assert found.value <= problem.value(x) * (1 + 1e-12)
        assert (found.x.reshape(2, 2) >= lower).all() and (found.x.reshape(2, 2) <= upper).all()
        free = search_locally(F, manifold, lower, upper, x)
        gradient = problem.value_and_gradient(free.x)[1].reshape(2, 2)
        inside = (free.x.reshape(2, 2) > lower) & (free.x.reshape(2, 2) < upper)
        inside &= free.pivot > 1e-3  # below, sources have run together, and the minimizer hangs on rounding
        assert np.abs(gradient[inside]).max(initial=0.0) < 1e-4 * np.linalg.norm(F) ** 2


def test_the_kernels_refuse_what_they_would_ignore():
    for manifold in weighted(LINE):
        with pytest.raises(Incompatible, match="expected a modulus of 1 at every element"):
            _ = manifold.packed
