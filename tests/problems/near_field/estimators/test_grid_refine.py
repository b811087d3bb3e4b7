"""Grid and refinement: the optimum compared with long global searches, the objectives, and grids."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import nfbench
from nfbench import Incompatible, OptionError
from nfbench.core.options import build
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators import grid_refine
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.refinement import refine
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import resolution, resolution_grid, search_locally
from nfbench.problems.near_field.subspace import signal_subspace

PLANE = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
SPACE = PLANE | {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavefront": "exact",
    "snapshots": 100,
    "elevation_deg": [-30, 30],
    "range_m": [0.452, 2.56],
}


def scene(seed: int = 0, manifest: dict = PLANE, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def solve(instance: NearFieldInstance, **options) -> np.ndarray:
    def never(problem):
        raise AssertionError("a formulation with needs_solver = False called minimize")

    return GridRefine(**options).solve(instance, never).estimate


def esf_of(instance: NearFieldInstance) -> SubspaceFit:
    return SubspaceFit(signal_subspace(instance.Y, instance.sources), instance.manifold, instance.lower, instance.upper)


def excess(instance: NearFieldInstance, budget: int = 0, **options) -> float:
    """Return ESF of the estimate minus the best known value, from the truth or from a long search with DE."""
    esf = esf_of(instance)
    known = [esf.value(refine(esf, instance.theta.ravel(), instance.manifold))]
    if budget:
        found = nfbench.minimize(esf, nfbench.solver("scipy-de"), budget, seed=1)
        known.append(esf.value(refine(esf, found.x, instance.manifold)))
    return esf.value(solve(instance, **options).ravel()) - min(known)


@pytest.mark.parametrize("snr_db", [0.0, 10.0, 20.0])
def test_the_optimum_is_reached_in_the_plane(snr_db):
    assert max(excess(scene(seed, snr_db=snr_db)) for seed in range(10)) < 1e-8


def test_the_optimum_is_reached_in_space():
    assert max(excess(scene(seed, SPACE)) for seed in range(5)) < 1e-8


@pytest.mark.parametrize("changes", [{}, {"rician_k": 10.0, "fading": "block"}], ids=["line of sight", "fading"])
def test_a_long_global_search_finds_nothing_better(changes):
    assert max(excess(scene(seed, **changes), budget=60_000) for seed in range(2, 5)) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("manifest", "snr_db", "scenes"), [(PLANE, 10.0, 40), (PLANE, 20.0, 40), (SPACE, 20.0, 20)], ids=str
)
def test_a_long_global_search_finds_nothing_better_in_many_scenes(manifest, snr_db, scenes):
    above = [excess(scene(seed, manifest, snr_db=snr_db), budget=60_000) > 1e-8 for seed in range(scenes)]
    assert np.mean(above) <= 0.05


def test_sweeps_correct_a_wrong_greedy_choice():
    """On a coarse grid the first choices can be wrong; choosing each source again corrects them."""
    instance = scene(26, SPACE)
    assert excess(instance, density=1.0, sweeps=0) > 0.9
    assert excess(instance, density=1.0) < 1e-8


def test_without_noise_the_sources_are_found():
    instance = scene(positions=[[-35, 3.0], [10, 8.0], [30, 2.0]])
    Y = instance.manifold.response(instance.theta).T @ np.diag([1.0, 2.0, 3.0])
    estimate = solve(replace(instance, Y=Y))
    assert_allclose(estimate[np.argsort(estimate[:, 0])], instance.theta, atol=1e-5)


def test_the_grid_of_a_ula_is_uniform_in_sine_and_inverse_range():
    instance = scene()
    grid = resolution_grid(instance.manifold, instance.lower, instance.upper, 2.0)
    azimuth, ranges = np.unique(grid[:, 0]), np.unique(grid[:, 1])
    assert len(grid) == len(azimuth) * len(ranges)
    assert_allclose([azimuth[[0, -1]], ranges[[0, -1]]], np.array([instance.lower, instance.upper]).T)
    beamwidth, depth = resolution(instance.manifold)
    sines, inverses = np.diff(np.sin(azimuth)), -np.diff(1 / ranges)
    assert_allclose(sines, sines.mean(), rtol=1e-2)
    assert_allclose(inverses, inverses.mean(), rtol=1e-6)
    assert 0.45 * beamwidth < sines.mean() <= beamwidth / 2
    assert 0.4 * depth < inverses.mean() <= depth / 2
    assert len(resolution_grid(instance.manifold, instance.lower, instance.upper, 4.0)) > 3 * len(grid)


def test_the_grid_of_a_circle_is_uniform_in_azimuth():
    circle = {"kind": "uca", "elements": 64, "radius_wavelengths": 8.0, "origin": "center"}
    instance = scene(array=circle, azimuth_deg=[-180, 180], range_m=[1.0, 10.0])
    azimuth = np.unique(resolution_grid(instance.manifold, instance.lower, instance.upper, 2.0)[:, 0])
    assert_allclose(np.diff(azimuth), 1 / 32, rtol=5e-2)


def test_another_wavefront_may_be_assumed():
    instance = scene(wavefront="exact", snr_db=40.0)
    right, wrong = (instance.score(solve(instance, wavefront=w))["rmse_m"] for w in ("exact", "paper"))
    assert right < 0.02 < wrong


def test_at_least_as_many_snapshots_as_sources_are_required():
    with pytest.raises(Incompatible, match=r"snapshots: expected at least 3 .* got 2"):
        solve(scene(snapshots=2))


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
def test_each_objective_is_at_the_minimum_that_a_search_from_the_truth_reaches(objective):
    for seed in range(5):
        instance = scene(seed, min_separation_deg=2.0)
        F, _, _ = grid_refine._factors(instance.Y, 3, objective)
        box = instance.manifold, instance.lower, instance.upper
        known = search_locally(F, *box, instance.theta.ravel())
        found = search_locally(F, *box, solve(instance, objective=objective).ravel())
        assert found.value == pytest.approx(known.value, rel=1e-9) and found.steps <= 3


def test_the_factors_have_the_weights_of_their_objectives():
    instance = scene(snr_db=(0.0, 10.0, 20.0))
    R = instance.Y @ instance.Y.conj().T / 200
    values, vectors = np.linalg.eigh(R)
    noise, top, U_s = values[:-3].mean(), values[-3:], vectors[:, -3:]
    expected = {
        "esf": U_s @ U_s.conj().T,
        "wsf": (U_s * ((top - noise) ** 2 / top)) @ U_s.conj().T,
        "dml": R,
    }
    for objective, product in expected.items():
        F, _, _ = grid_refine._factors(instance.Y, 3, objective)
        assert_allclose(F @ F.conj().T, product, rtol=0, atol=1e-10 * np.abs(product).max())


def test_maximum_likelihood_works_with_fewer_snapshots_than_sources_and_for_coherent_sources():
    instance = scene(1, min_separation_deg=10.0, snr_db=30.0)
    short = replace(instance, Y=instance.Y[:, :2])
    found = GridRefine(objective="dml").solve(short, None)
    assert instance.score(found.estimate)["rmse_m"] < 0.5 and np.isfinite(found.columns["std_m"])
    rng = np.random.default_rng(0)
    symbols = np.outer([30.0, 30.0j, 20.0], rng.normal(size=200))
    Y = instance.manifold.response(instance.theta).T @ symbols + rng.normal(size=(128, 200))
    coherent = replace(instance, Y=Y.astype(complex))
    assert instance.score(solve(coherent, objective="dml"))["rmse_m"] < 0.2


def test_a_source_that_is_not_above_the_noise_has_no_standard_error_but_breaks_nothing():
    instance = scene(0, snr_db=-60.0)
    Y = np.zeros_like(instance.Y)
    Y[:, :2] = instance.Y[:, :2]
    for objective in ("esf", "wsf"):
        found = GridRefine(objective=objective).solve(replace(instance, Y=Y), None)
        assert found.estimate.shape == (3, 2) and np.isfinite(found.estimate).all()
        assert np.isnan(found.columns["std_m"])


def test_one_source_is_found():
    instance = scene(3, sources=1)
    found = GridRefine().solve(instance, None)
    assert instance.score(found.estimate)["rmse_m"] < 5 * found.columns["std_1_m"] == 5 * found.columns["std_m"]


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
def test_data_that_are_not_finite_are_refused(objective):
    instance = scene()
    Y = instance.Y.copy()
    Y[5, 7] = np.nan
    with pytest.raises(ValueError, match="Y: expected finite data"):
        solve(replace(instance, Y=Y), objective=objective)


def test_it_is_built_from_a_manifest_table():
    formulation = Registry().make("formulation", "grid-refine", {"density": 3})
    assert formulation == GridRefine(density=3.0)
    assert not formulation.needs_solver


@pytest.mark.parametrize("options", [{"density": 0.0}, {"sweeps": -1}, {"wavefront": "round"}])
def test_invalid_options_are_refused(options):
    (name,) = options
    with pytest.raises(OptionError, match=name):
        GridRefine(**options)
