"""The misfit's value, gradient and curvature: compared with the objectives, and with the explicit stacked Jacobian."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from search_scenes import BOX, manifold

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.search import kernels, unit_of

WAVEFRONTS = ["exact", "fresnel", "paper", "planar"]


def case(dimension, wavefront, sources, columns, seed=0):
    """Return array, factor with orthonormal columns, sources of a candidate, and ∂θ/∂z of each coordinate."""
    rng = np.random.default_rng(seed)
    model = manifold(dimension, wavefront)
    F = np.linalg.qr(complex_normal(rng, (model.elements, columns))).Q
    theta = rng.uniform(*BOX[dimension], (sources, dimension))
    theta[:, 0] = 0.3 * (np.arange(sources) - sources / 2) + rng.uniform(0.0, 0.1, sources)  # apart
    step = np.tile(unit_of(model), (sources, 1))
    step[:, -1] *= -(theta[:, -1] ** 2)
    return model, F, theta, step.ravel()


def found(model, F, theta):
    kernels.warm_up()
    return kernels.misfit_and_derivatives(*model.packed, F, unit_of(model), theta.ravel())


@pytest.mark.parametrize("wavefront", WAVEFRONTS)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("sources", [1, 2, 3, 5])
def test_value_and_gradient_are_those_of_esf(dimension, wavefront, sources):
    model, U_s, theta, step = case(dimension, wavefront, sources, sources)
    J, g, _, _ = found(model, U_s, theta)
    value, gradient = SubspaceFit(U_s, model, *BOX[dimension]).value_and_gradient(theta.ravel())
    assert_allclose(J, value, rtol=1e-12)
    assert_allclose(2 * g, gradient * step, rtol=0, atol=1e-12 * np.abs(gradient * step).max())


@pytest.mark.parametrize("dimension", [2, 3])
def test_value_and_gradient_of_one_source_are_those_of_rls(dimension):
    model, F, theta, step = case(dimension, "exact", 1, 17)
    J, g, _, _ = found(model, 1e3 * F, theta)
    value, gradient = RLS(1e3 * F, model, *BOX[dimension]).value_and_gradient(theta[0])
    assert_allclose(J, value, rtol=1e-12)
    assert_allclose(2 * g, gradient * step, rtol=0, atol=1e-12 * np.abs(gradient * step).max())


@pytest.mark.parametrize("wavefront", WAVEFRONTS)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("sources", "columns"), [(1, 1), (1, 30), (2, 2), (3, 3), (3, 30), (4, 7), (6, 3)])
def test_the_curvature_is_that_of_the_stacked_jacobian(dimension, wavefront, sources, columns):
    """Kaufman's Jacobian of R by z_ki is −P⊥·D_ki·c_k; for real z and complex R, 𝒥ᵀ𝒥 is the real part of JᴴJ."""
    model, F, theta, step = case(dimension, wavefront, sources, columns)
    a, derivatives = model.response_and_derivatives(theta)
    A = a.T
    D = derivatives * step.reshape(sources, dimension, 1)
    C = np.linalg.pinv(A) @ F
    off = np.eye(len(A)) - A @ np.linalg.pinv(A)
    jacobian = np.stack(
        [-(off @ np.outer(D[k, i], C[k])).ravel() for k in range(sources) for i in range(dimension)], axis=1
    )
    H = (jacobian.conj().T @ jacobian).real
    assert_allclose(found(model, F, theta)[2], H, rtol=0, atol=1e-12 * np.abs(H).max())


def test_the_pivot_is_the_least_squared_distance_of_a_response_from_those_before():
    model, F, theta, _ = case(2, "exact", 3, 3)
    theta[2] = theta[1] + [1e-3, 0.0]
    R = np.linalg.qr(model.response(theta).T).R
    assert_allclose(found(model, F, theta)[3], np.min(np.abs(np.diag(R)) ** 2) / model.elements, rtol=1e-9)


def test_two_sources_at_one_position_count_once():
    model, F, theta, _ = case(2, "exact", 3, 3)
    theta[2] = theta[1]
    J, g, H, pivot = found(model, F, theta)
    assert_allclose(J, found(model, F, theta[:2])[0], rtol=1e-9)
    assert np.isfinite(g).all() and np.isfinite(H).all() and pivot < 1e-12


def test_the_value_keeps_its_digits_where_the_fit_is_nearly_exact():
    """K − ‖W‖² would have none left at J = 1e-16."""
    model, _, theta, _ = case(2, "exact", 3, 3)
    A = model.response(theta).T
    U = np.linalg.svd(A, full_matrices=True)[0]
    F = U[:, :3] + 1e-8 * U[:, 3:6]
    assert_allclose(found(model, F, theta)[0], 3e-16, rtol=1e-6)
