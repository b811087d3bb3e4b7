"""Local refinement: never worse, within the box, and at a stationary point."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import OptimizeResult

from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.estimators import refinement as module
from nfbench.problems.near_field.estimators.refinement import refine, resolution
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.subspace import signal_subspace
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
PLANE = Manifold(
    ULA(elements=24, spacing_wavelengths=0.5, origin="first").place(WAVELENGTH), WAVELENGTH, "exact", False
)
SPACE = Manifold(
    UPA(columns=6, rows=5, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH), WAVELENGTH, "paper", True
)
BOX = {2: (np.array([-1.0, 0.3]), np.array([1.0, 5.0])), 3: (np.array([-1.0, -0.5, 0.1]), np.array([1.0, 0.5, 2.0]))}


def problems(manifold: Manifold, seed: int) -> list[RLS | SubspaceFit]:
    """Return RLS for noisy data of two sources, and ESF for their signal subspace."""
    rng = np.random.default_rng(seed)
    lower, upper = BOX[manifold.dimension]
    Y = manifold.response(rng.uniform(lower, upper, (2, len(lower)))).T @ complex_normal(rng, (2, 30))
    Y += 0.1 * complex_normal(rng, Y.shape)
    return [RLS(Y, manifold, lower, upper), SubspaceFit(signal_subspace(Y, 2), manifold, lower, upper)]


def projected_gradient(problem: RLS | SubspaceFit, x: np.ndarray) -> np.ndarray:
    """Return the gradient times the width of the box, without the components that point out of it."""
    width = problem.upper - problem.lower
    slope = problem.value_and_gradient(x)[1] * width
    near = 1e-9 * width
    outwards = ((x - problem.lower < near) & (slope > 0)) | ((problem.upper - x < near) & (slope < 0))
    return np.where(outwards, 0.0, slope)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), corner=st.booleans())
@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
def test_the_result_is_never_worse_and_within_the_box(manifold, seed, corner):
    rng = np.random.default_rng(seed)
    for problem in problems(manifold, seed):
        x = rng.uniform(problem.lower, problem.upper)
        if corner:
            x = np.where(rng.random(len(x)) < 0.5, problem.lower, problem.upper)
        found = refine(problem, x, manifold)
        assert problem.value(found) <= problem.value(x)
        assert (found >= problem.lower).all() and (found <= problem.upper).all()
        assert_array_equal(refine(problem, x, manifold), found)


@pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])
def test_the_projected_gradient_vanishes_at_the_result(manifold):
    for seed in range(10):
        for problem in problems(manifold, seed):
            x = np.random.default_rng(seed).uniform(problem.lower, problem.upper)
            found = refine(problem, x, manifold)
            before = np.abs(projected_gradient(problem, x)).max()
            assert np.abs(projected_gradient(problem, found)).max() < 1e-4 * before


def test_a_minimum_is_unchanged():
    """Starting at a minimizer, the result is the same point up to rounding, and not worse."""
    for problem in problems(PLANE, 3):
        once = refine(problem, (problem.lower + problem.upper) / 2, PLANE)
        twice = refine(problem, once, PLANE)
        assert_allclose(twice, once, rtol=1e-5)
        assert problem.value(twice) <= problem.value(once)


def test_a_source_on_a_coordinate_axis_is_not_a_special_case():
    problem = problems(SPACE, 0)[0]
    assert problem.value(refine(problem, np.array([0.0, 0.0, 1.0]), SPACE)) < problem.value(np.array([0.0, 0.0, 1.0]))


def test_resolution_is_the_beamwidth_and_the_depth_of_focus():
    """One beamwidth from broadside, the phases at both ends of a ULA differ by a full turn, which is a null."""
    beamwidth, depth = resolution(PLANE)
    aperture = 23 * 0.01
    assert beamwidth == pytest.approx(WAVELENGTH / aperture)
    assert depth == pytest.approx(4 * WAVELENGTH / aperture**2)
    x = PLANE.positions[:, 1]
    centred = x - x.mean()
    assert np.ptp(x * beamwidth / WAVELENGTH) == pytest.approx(1.0)
    assert np.max(centred**2 * depth / 2 / WAVELENGTH) == pytest.approx(0.5)


def test_a_search_that_ends_at_a_worse_point_is_discarded(monkeypatch):
    """L-BFGS-B may end at a worse point because of rounding or at a kink of the repulsion."""
    problem = problems(PLANE, 0)[0]
    x = refine(problem, np.array([0.1, 1.0]), PLANE)
    worse = OptimizeResult(x=np.array([0.0, 1 / 5.0 / resolution(PLANE)[1]]), fun=0.0)  # the point (0, 5 m), scaled
    monkeypatch.setattr(module, "minimize", lambda *args, **options: worse)
    assert problem.value(np.array([0.0, 5.0])) > problem.value(x)
    assert_array_equal(refine(problem, x, PLANE), x)
