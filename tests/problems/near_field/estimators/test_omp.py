"""Orthogonal matching pursuit on the polar grid: agreement with the printed algorithm, its claims, hostile scenes."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pursuit_scenes import HOSTILE, LINE, SMALL, SPACE, coherent, dictionary, in_order, noise_free, scene, solve

from nfbench import Incompatible, OptionError
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.omp import Omp
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.search import polar_grid


def somp(instance: NearFieldInstance, coherence: float) -> np.ndarray:
    """Return the points that Algorithm 1 of Cui & Dai picks, with explicit projectors."""
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, coherence)
    Psi = dictionary(instance, grid)
    R, support = instance.Y, []
    for _ in range(instance.sources):
        Gamma = Psi.conj().T @ R
        support.append(int(np.argmax(np.sum(np.abs(Gamma) ** 2, axis=1))))
        A = Psi[:, support]
        R = instance.Y - A @ np.linalg.pinv(A) @ instance.Y
    return grid[support]


@pytest.mark.parametrize(("manifest", "scenes"), [(SMALL, 50), (SPACE, 10), (LINE, 2)], ids=["small", "space", "line"])
def test_the_picks_are_those_of_the_printed_algorithm(manifest, scenes):
    for seed in range(scenes):
        instance = scene(seed, manifest, snr_db=float(seed % 4) * 10.0)
        assert_array_equal(solve(Omp(coherence=0.8), instance), somp(instance, 0.8))


def test_sources_on_the_grid_are_found_exactly_without_noise():
    instance = scene()
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, 0.8)
    theta = grid[[len(grid) // 5, len(grid) // 2, len(grid) - 9]]
    assert_array_equal(in_order(solve(Omp(coherence=0.8), noise_free(replace(instance, theta=theta)))), in_order(theta))


@pytest.mark.parametrize("manifest", [SMALL, SPACE], ids=["line", "space"])
def test_without_noise_refinement_gives_the_sources_and_the_grid_does_not(manifest):
    for seed in range(5):
        instance = noise_free(scene(seed, manifest, sources=2, min_separation_deg=20.0))
        found = in_order(solve(Omp(refine=True), instance))
        assert_allclose(found, in_order(instance.theta), rtol=1e-6)
        assert np.abs(in_order(solve(Omp(), instance)) - in_order(instance.theta)).max() > 1e-4


def left(instance: NearFieldInstance, theta: np.ndarray, wavefront: str | None = None) -> float:
    """Return how much of the energy of the data sources leave, under another wavefront."""
    A = instance.manifold.under(wavefront).response(theta).T
    return float(np.linalg.norm(instance.Y - A @ np.linalg.pinv(A) @ instance.Y) / np.linalg.norm(instance.Y)) ** 2


def test_in_the_near_field_a_polar_grid_represents_the_data_and_a_grid_of_angles_does_not():
    """Cui & Dai, Figs. 4 and 7: P-SOMP has a smaller NMSE than SOMP in the angular domain, and P-SIGW a smaller one."""
    angular, polar, refined = np.empty(20), np.empty(20), np.empty(20)
    for seed in range(20):
        instance = noise_free(scene(seed, LINE, snapshots=10, wavefront="exact", range_m=[1.27, 4.0]))
        angular[seed] = left(instance, solve(Omp(wavefront="planar"), instance), "planar")
        polar[seed] = left(instance, solve(Omp(), instance))
        refined[seed] = left(instance, solve(Omp(refine=True), instance))
    assert (polar < angular).all() and np.median(polar) < np.median(angular) / 4
    assert (refined <= polar).all() and np.median(refined) < 1e-10


def test_a_finer_grid_is_more_accurate():
    errors = [
        np.median([scene(seed).score(solve(Omp(coherence=c), scene(seed)))["rmse_m"] for seed in range(20)])
        for c in (0.5, 0.9, 0.99)
    ]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_scenes_end_with_sources_in_the_box(name, refine):
    instance = scene(0, HOSTILE[name])
    found = solve(Omp(coherence=0.7, refine=refine), instance)
    assert found.shape == instance.theta.shape and np.isfinite(found).all()
    assert (found >= instance.lower).all() and (found <= instance.upper).all()
    if not refine:
        assert len(np.unique(found, axis=0)) == len(found)


def test_fewer_snapshots_than_sources_and_coherent_sources_are_allowed():
    positions = [[-35, 1.0], [10, 0.8], [40, 2.0]]
    for instance in (scene(snapshots=1, positions=positions, snr_db=40.0), coherent(scene(positions=positions))):
        found = solve(Omp(refine=True), instance)
        assert instance.score(found)["rmse_m"] < 0.2


def test_a_grid_with_fewer_points_than_sources_gives_all_of_them():
    instance = scene(azimuth_deg=[0, 0.1], range_m=[1.0, 1.01], sources=5)
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, 0.5)
    assert_array_equal(np.unique(solve(Omp(coherence=0.5), instance), axis=0), np.unique(grid, axis=0))


def test_bins_are_added():
    manifest = SMALL | {"bins": 3, "bandwidth_relative": 0.2, "snr_db": 0.0}
    instance = scene(3, manifest)
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, 0.8)
    weights = [1 / np.linalg.eigvalsh(b.Y @ b.Y.conj().T)[:-3].sum() for b in instance.bands]
    energy = sum(
        weight * np.sum(np.abs(band.manifold.response(grid).conj() @ band.Y) ** 2, axis=1)
        for weight, band in zip(weights, instance.bands, strict=True)
    )
    assert_array_equal(solve(Omp(coherence=0.8), instance)[0], grid[np.argmax(energy)])
    refined = solve(Omp(refine=True), replace(instance, Y=30 * instance.Y))
    assert refined.shape == (3, 2)


def test_known_gains_are_taken_into_account():
    rng = np.random.default_rng(0)
    gains = np.exp(0.5 * rng.normal(size=32) + 1j * rng.uniform(0, 2 * np.pi, 32))
    instance = scene(positions=[[-35, 1.0], [10, 0.8], [40, 2.0]], snr_db=40.0)
    impaired = replace(instance, Y=gains[:, None] * instance.Y, gains=gains)
    ignorant, informed = (
        impaired.score(solve(Omp(known_gains=known, refine=True), impaired))["rmse_m"] for known in (False, True)
    )
    assert informed < 0.02 < ignorant


def test_no_sources_and_equal_runs():
    instance = scene()
    assert_array_equal(solve(Omp(), instance), solve(Omp(), instance))
    noise = np.random.default_rng(0).normal(size=(32, 400)).view(complex)
    assert solve(Omp(sources="estimate"), replace(instance, Y=noise)).shape == (0, 2)


def test_too_large_a_grid_is_refused_and_a_slow_one_warned_about():
    wide = {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 20.0, "origin": "center"}
    instance = scene(0, SPACE, array=wide, range_m=[10.0, 100.0])
    with pytest.raises(Incompatible, match=r"the polar grid would have .* reduce coherence"):
        solve(Omp(coherence=0.99), instance)
    scenario = Registry().make("scenario", "near-field", LINE)
    assert Omp().warnings(scenario) == []
    (text,) = Omp(coherence=0.9999).warnings(scenario)
    assert (
        text.startswith("coherence: 0.9999 gives a polar grid of about ") and "with 128 elements and 3 sources" in text
    )


def test_it_is_built_from_a_manifest_table():
    formulation = Registry().make("formulation", "omp", {"coherence": 0.7})
    assert formulation == Omp(coherence=0.7)
    assert not formulation.needs_solver


@pytest.mark.parametrize("coherence", [0.0, 1.0, float("nan")])
def test_invalid_coherence_is_refused(coherence):
    with pytest.raises(OptionError, match="coherence"):
        Omp(coherence=coherence)


def test_the_oracle_and_the_manifold_agree():
    instance = scene()
    assert_allclose(
        instance.manifold.response(instance.theta[0]), oracles.response(instance.manifold, instance.theta[0])
    )
