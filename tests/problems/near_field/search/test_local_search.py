"""The local search: the minima of L-BFGS-B, stationary within the box, in few steps, and not worse than the start."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from search_scenes import BOX, PLANE, SPACE, manifold, scene

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.estimators.refinement import _refine_by_quasi_newton
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.search import kernels, search_locally, unit_of
from nfbench.problems.near_field.subspace import compress, decompose


def factor(instance, objective):
    if objective == "dml":
        return compress(instance.Y) / np.sqrt(instance.Y.shape[1])
    U_s, eigenvalues, noise = decompose(instance.Y, instance.sources)
    return U_s * ((eigenvalues - noise) / np.sqrt(eigenvalues) if objective == "wsf" else 1.0)


def stationarity(F, model, lower, upper, x):
    """Return the greatest cosine between a column of the Jacobian and R, where x may move along it."""
    J, g, H, _ = kernels.misfit_and_derivatives(*model.packed, F, unit_of(model), x)
    low, high = (np.tile(side, len(x) // len(lower)) for side in (lower, upper))
    upwards = np.where(np.arange(len(x)) % len(lower) == len(lower) - 1, -g, g)  # 1/r falls as r rises
    outwards = ((x == low) & (upwards > 0)) | ((x == high) & (upwards < 0))
    return np.max(np.where(outwards, 0.0, np.abs(g)) / np.sqrt(np.maximum(np.diag(H), 1e-300) * J))


@pytest.mark.parametrize(
    ("manifest", "changes"),
    [(PLANE, {}), (PLANE, {"rician_k": 10.0, "fading": "block"}), (SPACE, {}), (PLANE, {"wavefront": "exact"})],
    ids=["plane", "fading", "space", "exact"],
)
def test_the_minimum_is_that_of_l_bfgs_b(manifest, changes):
    for seed in range(8):
        instance = scene(seed, manifest, min_separation_deg=2.0, **changes)
        U_s = factor(instance, "esf")
        esf, start = SubspaceFit(U_s, instance.manifold, instance.lower, instance.upper), instance.theta.ravel()
        found = search_locally(U_s, instance.manifold, instance.lower, instance.upper, start)
        reference = _refine_by_quasi_newton(esf, start, instance.manifold)
        assert_allclose(found.value, esf.value(reference), rtol=1e-8)
        assert_allclose(found.x, reference, atol=2e-4 if changes else 1e-5)
        assert found.steps <= 12 and found.pivot > 1e-3


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
@pytest.mark.parametrize("manifest", [PLANE, SPACE], ids=["plane", "space"])
def test_the_result_is_stationary(manifest, objective):
    for seed in range(4):
        instance = scene(seed, manifest, min_separation_deg=2.0)
        F, box = factor(instance, objective), (instance.lower, instance.upper)
        found = search_locally(F, instance.manifold, *box, instance.theta.ravel())
        assert stationarity(F, instance.manifold, *box, found.x) < 1e-6
        assert found.value <= search_locally(F, instance.manifold, *box, found.x).value * (1 + 1e-12)
        expected = kernels.misfit_and_derivatives(*instance.manifold.packed, F, unit_of(instance.manifold), found.x)
        assert_allclose(found.value, expected[0], rtol=1e-13)
        assert_allclose(found.H, expected[2], rtol=0, atol=1e-12 * found.H.max())


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), wavefront=st.sampled_from(["exact", "fresnel", "paper", "planar"]))
@pytest.mark.parametrize("dimension", [2, 3])
def test_from_anywhere_the_result_is_in_the_box_and_not_worse(dimension, wavefront, seed):
    rng = np.random.default_rng(seed)
    model, (lower, upper) = manifold(dimension, wavefront), BOX[dimension]
    K, columns = int(rng.integers(1, 5)), int(rng.integers(1, 12))
    F = complex_normal(rng, (model.elements, columns))
    x = rng.uniform(lower, upper, (K, dimension))
    x = np.where(rng.random(x.shape) < 0.2, np.where(rng.random(x.shape) < 0.5, lower, upper), x).ravel()
    before = kernels.misfit_and_derivatives(*model.packed, F, unit_of(model), x)[0]
    found = search_locally(F, model, lower, upper, x)
    assert found.value <= before
    assert (found.x.reshape(K, -1) >= lower).all() and (found.x.reshape(K, -1) <= upper).all()
    assert_array_equal(search_locally(F, model, lower, upper, x).x, found.x)


def test_a_minimum_outside_the_box_ends_on_its_edge():
    instance = scene(1, positions=[[-35, 3.0], [10, 8.0], [30, 2.0]])
    U_s, (lower, upper) = factor(instance, "esf"), (instance.lower.copy(), instance.upper.copy())
    upper[-1] = 6.0
    start = np.minimum(instance.theta, upper).ravel()
    found = search_locally(U_s, instance.manifold, lower, upper, start)
    assert found.x[3] == 6.0 and (found.x[[1, 5]] < 6.0).all()
    assert stationarity(U_s, instance.manifold, lower, upper, found.x) < 1e-6


def test_the_range_of_a_planar_wavefront_stays_where_it_was():
    model, (lower, upper) = manifold(2, "planar"), BOX[2]
    a = model.response(np.array([[0.3, 2.0]])).T
    found = search_locally(a, model, lower, upper, np.array([0.31, 4.0]))
    assert_allclose(found.x, [0.3, 4.0], atol=1e-9)
    assert found.value < 1e-20 * model.elements


def test_without_noise_the_sources_are_found_to_all_digits():
    instance = scene(2, SPACE, positions=[[-35, 5, 1.0], [10, -20, 0.8], [30, 20, 2.0]])
    F = instance.manifold.response(instance.theta).T
    start = (instance.theta * [1.001, 0.999, 1.02]).ravel()
    found = search_locally(F, instance.manifold, instance.lower, instance.upper, start)
    assert_allclose(found.x, instance.theta.ravel(), rtol=1e-9)


def test_sources_that_run_together_are_reported_by_the_pivot():
    instance = scene(0, sources=1, positions=[[5, 4.0]])
    a = instance.manifold.response(instance.theta).T
    start = np.array([instance.theta[0] + [0.001, 0.0], instance.theta[0] - [0.001, 0.0]]).ravel()
    close = search_locally(a, instance.manifold, instance.lower, instance.upper, start)
    assert close.pivot < 1e-2 and np.isfinite(close.H).all() and close.value < 1e-8
