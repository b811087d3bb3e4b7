"""Guards the search over several frequency bins: the minimum that it reaches, and the covariance there."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from wideband_scenes import SPACE, SPARSE, WIDEBAND, assert_same_covariance, scene

from nfbench.problems.near_field.bands import bounds_of_bands
from nfbench.problems.near_field.objectives.factors import factors
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.objectives.sum_of_fits import SumOfFits
from nfbench.problems.near_field.search import (
    BandFit,
    covariance,
    covariance_of_bands,
    response_grid,
    search_bands_greedily,
    search_bands_locally,
    search_greedily,
    search_locally,
)


def fits_of(wide, objective="wsf"):
    K = wide.sources
    found = factors([band.Y for band in wide.bands], K, objective)
    return [BandFit(F, band.manifold) for F, band in zip(found, wide.bands, strict=True)]


def problem_of(wide, fits):
    box = wide.lower, wide.upper
    return SumOfFits(SubspaceFit(F, manifold, *box, sources=wide.sources) for F, manifold in fits)


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
@pytest.mark.parametrize("seed", range(5))
def test_one_bin_ends_where_the_compiled_search_does(objective, seed):
    narrow = scene(seed, bins=1)
    fits, box = fits_of(narrow, objective), (narrow.lower, narrow.upper)
    start = np.clip(narrow.theta * 1.01, *box).ravel()
    expected = search_locally(*fits[0], *box, start)
    found = search_bands_locally(fits, *box, start)
    assert_allclose(found.x, expected.x, rtol=1e-7)
    assert_allclose(found.value, expected.value, rtol=1e-12)
    assert_allclose(found.H, expected.H, rtol=1e-6, atol=1e-9 * np.abs(expected.H).max())


@pytest.mark.parametrize("manifest", [WIDEBAND, SPACE], ids=["plane", "space"])
@pytest.mark.parametrize("seed", range(4))
def test_the_local_search_ends_at_a_minimum_of_the_sum(manifest, seed):
    wide = scene(seed, manifest)
    fits, box = fits_of(wide), (wide.lower, wide.upper)
    problem = problem_of(wide, fits)
    found = search_bands_locally(fits, *box, np.clip(wide.theta * 1.01, *box).ravel())
    assert_allclose(found.value, problem.value(found.x), rtol=1e-6)
    sizes = 1e-3 * (problem.upper - problem.lower)
    naive = minimize(
        lambda z: problem.value(np.clip(z * sizes, problem.lower, problem.upper)),
        found.x / sizes,
        method="Nelder-Mead",
        options={"maxiter": 3000, "initial_simplex": None},
    )
    assert naive.fun >= found.value * (1 - 1e-9)
    assert found.value <= problem.value(wide.theta.ravel())


def test_held_sources_and_edges_of_the_box_are_respected():
    wide = scene(2)
    fits = fits_of(wide)
    upper = wide.upper.copy()
    upper[-1] = 0.98 * wide.theta[:, -1].min()  # both sources lie beyond the box
    start = np.stack([wide.theta[:, 0], np.full(2, upper[-1] - 0.05)], axis=1).ravel()
    edge = search_bands_locally(fits, wide.lower, upper, start)
    assert (edge.x[1::2] == upper[-1]).any() and (edge.x[1::2] <= upper[-1]).all()
    held = search_bands_locally(fits, wide.lower, wide.upper, start, fixed=1)
    assert (held.x[:2] == start[:2]).all() and (held.x[2:] != start[2:]).all()
    assert held.value < problem_of(wide, fits).value(start)


def test_the_search_distinguishes_sources_from_aliases():
    """At a spacing of 2λ, aliases at one frequency are nearly as good, and the search for one bin ends at them."""
    wrong = np.zeros(2)
    for seed in range(10):
        wide = scene(seed, SPARSE, bandwidth_relative=0.05)
        fits, box = fits_of(wide), (wide.lower, wide.upper)
        grid = response_grid(wide.manifold, *box, 1.5)
        for i, found in enumerate(
            [search_bands_greedily(fits, *box, 2, 1.5, 5), search_greedily(fits[0].F, grid, 2, 5)]
        ):
            wrong[i] += wide.score(found.x.reshape(2, 2))["rmse_m"] > 5 * wide.bounds()["crb_m"]
    assert wrong[0] == 0 and wrong[1] >= 7


@pytest.mark.parametrize("on_edge", [False, True])
def test_the_covariance_of_one_bin_is_that_of_the_compiled_kernel(on_edge):
    narrow = scene(1, bins=1)
    theta, box = narrow.theta.copy(), (narrow.lower, narrow.upper)
    if on_edge:
        theta[1, 1] = narrow.upper[1]
    F = factors([narrow.Y], 2, "esf")[0]
    G = F * np.array([1.5, 0.7])
    expected = covariance(theta, narrow.manifold, *box, F, 2.0, 60, G)
    found = covariance_of_bands(theta, [BandFit(F, narrow.manifold)], *box, [2.0 / 120], [G])
    assert_allclose(found, expected, rtol=1e-8, atol=1e-12 * np.abs(expected).max())
    assert on_edge == (found == 0).any()


def test_the_covariance_of_all_bins_tends_to_the_bound():
    wide = scene(1, snapshots=20_000, snr_db=10.0)
    fits = fits_of(wide)
    theta = search_bands_locally(fits, wide.lower, wide.upper, wide.theta.ravel()).x.reshape(2, 2)
    box = wide.lower, wide.upper
    C = covariance_of_bands(theta, fits, *box, [1 / 40_000] * 3, [fit.F for fit in fits])  # noise of unit variance
    assert_same_covariance(C, bounds_of_bands(wide.bands, wide.theta, wide.snr)[0], 0.03)


def test_coincident_sources_have_no_covariance():
    wide = scene(1)
    fits = fits_of(wide)
    C = covariance_of_bands(wide.theta[[0, 0]], fits, wide.lower, wide.upper, [1.0] * 3, [fit.F for fit in fits])
    assert np.isnan(C).all()
