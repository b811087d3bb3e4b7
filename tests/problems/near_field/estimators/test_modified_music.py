"""Modified MUSIC: estimates without noise, the bias of the exact wavefront, and declined scenes."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose

from nfbench import Incompatible
from nfbench.core.options import build
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField

PAPER = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "fresnel",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
    "positions": [[-35, 3.0], [10, 2.0], [30, 4.0]],
}


def scene(array: dict | None = None, **changes) -> NearFieldInstance:
    manifest = PAPER | {"array": PAPER["array"] | (array or {})} | changes
    return build(NearField, manifest).draw(np.random.default_rng(0))


def noise_free(array: dict | None = None, **changes) -> NearFieldInstance:
    """Return a scene without noise whose symbols are orthogonal, so that the covariance is A·Aᴴ."""
    instance = scene(array, **changes)
    K, T = instance.sources, instance.Y.shape[1]
    S = np.exp(2j * np.pi * np.outer(np.arange(K), np.arange(T)) / T)
    A = np.array([oracles.response(instance.manifold, theta) for theta in instance.theta]).T
    return replace(instance, Y=A @ S)


def solve(instance: NearFieldInstance, **options) -> np.ndarray:
    def never(problem):
        raise AssertionError("a formulation with needs_solver = False called minimize")

    estimate = ModifiedMusic(**options).solve(instance, never)
    return estimate[np.argsort(estimate[:, 0])]


@pytest.mark.parametrize("elements", [127, 128])
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
def test_without_noise_the_sources_are_found(elements, wavefront):
    instance = noise_free({"elements": elements}, wavefront=wavefront)
    assert_allclose(solve(instance, refine=True), instance.theta, atol=2e-6)


@pytest.mark.parametrize("elements", [9, 10, 33, 34])
def test_small_arrays_odd_and_even(elements):
    positions = [[-30, 0.5], [20, 0.7]]
    instance = noise_free({"elements": elements}, sources=2, positions=positions, range_m=[0.1, 2.0])
    assert_allclose(solve(instance, refine=True), instance.theta, atol=1e-5)


def test_angles_on_the_grid_are_within_half_a_step_of_the_sources():
    instance = noise_free()
    azimuth, ranges = np.linspace(*np.radians([-60, 60]), 200), np.linspace(1.27, 20.16, 1000)
    estimate = solve(instance, grid=Grid(azimuth=200, range=1000))
    assert (np.abs(estimate[:, 0] - instance.theta[:, 0]) <= (azimuth[1] - azimuth[0]) / 2).all()
    assert np.isin(estimate[:, 0], azimuth).all() and np.isin(estimate[:, 1], ranges).all()


def test_ranges_maximize_the_music_spectrum_along_each_angle():
    instance = noise_free()
    estimate = solve(instance, grid=Grid(azimuth=200, range=300))
    U_s = np.linalg.svd(instance.Y)[0][:, :3]
    for theta in estimate:
        line = np.array([[theta[0], r] for r in np.linspace(1.27, 20.16, 300)])
        rest = [128 - np.linalg.norm(U_s.conj().T @ oracles.response(instance.manifold, x)) ** 2 for x in line]
        assert theta[1] == line[np.argmin(rest), 1]


def test_angles_do_not_depend_on_ranges():
    near, far = (noise_free(positions=[[-35, r], [10, r], [30, r]], azimuth_deg=[-60, 60]) for r in (1.5, 15.0))
    assert_allclose(solve(near, refine=True)[:, 0], solve(far, refine=True)[:, 0], atol=1e-7)


def test_an_exact_wavefront_biases_the_angles():
    """The cubic phase is odd and biases the angles, by a few mrad and far more than the error of the search."""
    instance = noise_free(wavefront="exact", positions=[[-35, 1.5], [10, 2.0], [30, 1.5]])
    error = np.abs(solve(instance, refine=True)[:, 0] - instance.theta[:, 0])
    assert 1e-4 < error.max() < 1e-2


def test_noisy_sources_are_found():
    instance = scene(snr_db=20.0)
    assert instance.score(solve(instance, refine=True))["rmse_m"] < 0.05


def test_a_mirrored_array_gives_the_same_estimate():
    """The elements may be numbered from either end."""
    instance = scene()
    manifold = replace(instance.manifold, positions=instance.manifold.positions[::-1])
    mirrored = replace(instance, Y=instance.Y[::-1], manifold=manifold)
    assert_allclose(solve(mirrored, refine=True), solve(instance, refine=True), atol=1e-6)


@pytest.mark.parametrize(
    ("array", "changes", "reason"),
    [
        ({"origin": "first"}, {}, r'array.origin: expected "center" for modified MUSIC'),
        ({"spacing_wavelengths": 0.5}, {}, r"spacing below .* = 0.2887 λ for modified MUSIC, got 0.5 λ"),
        ({}, {"azimuth_deg": [-60, 90]}, r"= 0.25 λ for modified MUSIC, got 0.25 λ"),
        ({}, {"azimuth_deg": [-60, 120]}, r"= 0.25 λ for modified MUSIC, got 0.25 λ"),
        ({"elements": 6}, {"range_m": [0.1, 20.0]}, r"more than 6 elements for 3 sources, got 6"),
        ({}, {"snapshots": 2}, r"snapshots: expected at least 3 .* got 2"),
        ({}, {"elevation_deg": [-30, 30], "positions": None}, r"elevation_deg: expected none, .* in the plane only"),
    ],
)
def test_unsuitable_scenes_are_declined(array, changes, reason):
    with pytest.raises(Incompatible, match=reason):
        solve(scene(array, **changes))


def test_a_narrower_sector_allows_a_wider_spacing():
    """The limit is λ/(4·sin 25°) = 0.59 λ."""
    instance = noise_free(
        {"spacing_wavelengths": 0.5}, azimuth_deg=[-25, 20], positions=[[-20, 3.0], [5, 2.0], [15, 4.0]]
    )
    assert_allclose(solve(instance, refine=True), instance.theta, atol=2e-6)


@pytest.mark.parametrize(
    "array",
    [
        {"kind": "upa", "columns": 16, "rows": 2, "spacing_wavelengths": 0.25, "origin": "center"},
        {"kind": "uca", "elements": 32, "radius_wavelengths": 4.0, "origin": "center"},
        {"kind": "custom", "origin": "center", "positions": [[0, y, 0] for y in (0, 1, 2, 3, 4, 5, 7)]},
        {"kind": "custom", "origin": "center", "positions": [[y, 0, 0] for y in range(9)]},
    ],
    ids=["upa", "uca", "gaps", "along-x"],
)
def test_only_a_uniform_linear_array_along_y_is_accepted(array):
    instance = build(NearField, PAPER | {"array": array}).draw(np.random.default_rng(0))
    with pytest.raises(Incompatible, match="uniform linear array along y"):
        solve(instance)


def test_it_is_built_from_a_manifest_table():
    formulation = Registry().make("formulation", "modified-music", {"grid": {"azimuth": 400}})
    assert formulation == ModifiedMusic(grid=Grid(azimuth=400))
    assert not formulation.needs_solver
