"""MUSIC: the spectrum, the grid search for maxima, distinct peaks, and the options."""

import itertools
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import nfbench
from nfbench import Incompatible, OptionError, Solution
from nfbench.core.options import build
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators import music
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid, Music, grid_maxima, pick_peaks
from nfbench.problems.near_field.estimators.refinement import refine
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import signal_subspace

PAPER = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
FADING = {"rician_k": 10.0, "fading": "block"}
SPACE = {
    "array": {"kind": "upa", "columns": 5, "rows": 4, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavefront": "exact",
    "sources": 2,
    "elevation_deg": [-30, 30],
    "range_m": [0.1, 0.4],
}
COARSE = Grid(azimuth=200, range=1000)


def scene(seed: int = 0, **changes) -> NearFieldInstance:
    return build(NearField, PAPER | changes).draw(np.random.default_rng(seed))


def noise_free(**changes) -> NearFieldInstance:
    """Return a scene without noise whose symbols are orthogonal."""
    instance = scene(**changes)
    K, T = instance.sources, instance.Y.shape[1]
    S = np.exp(2j * np.pi * np.outer(np.arange(K), np.arange(T)) / T)
    A = np.array([oracles.response(instance.manifold, theta) for theta in instance.theta]).T
    return replace(instance, Y=A @ S)


def solve(formulation, instance: NearFieldInstance) -> np.ndarray:
    def never(problem):
        raise AssertionError("a formulation with needs_solver = False called minimize")

    found = formulation.solve(instance, never)
    return found.estimate if isinstance(found, Solution) else found


def spectrum_of(instance: NearFieldInstance) -> RLS:
    U_s = signal_subspace(instance.Y, instance.sources)
    return RLS(U_s, instance.manifold, instance.lower, instance.upper)


def sources_reached(instance: NearFieldInstance, points: np.ndarray) -> list[int]:
    """Return the index of the true source whose peak a local search reaches from each point; −1 for none."""
    spectrum, M = spectrum_of(instance), instance.manifold.elements
    reached, true = (np.array([refine(spectrum, x, instance.manifold) for x in X]) for X in (points, instance.theta))
    correlation = np.abs(instance.manifold.response(reached) @ instance.manifold.response(true).conj().T) ** 2 / M**2
    return [int(np.argmax(row)) if row.max() > 0.99 else -1 for row in correlation]


def brute_force_maxima(heights: np.ndarray) -> list[tuple[int, ...]]:
    """Return every cell that is higher than all its neighbours, in descending order."""
    steps = [step for step in itertools.product((-1, 0, 1), repeat=heights.ndim) if any(step)]
    padded = np.pad(heights, 1, constant_values=-np.inf)

    def is_highest(cell: tuple[int, ...]) -> bool:
        return all(padded[tuple(c + 1 + s for c, s in zip(cell, step, strict=True))] < heights[cell] for step in steps)

    return sorted(filter(is_highest, np.ndindex(heights.shape)), key=lambda cell: -heights[cell])


def test_the_signal_form_equals_the_noise_form():
    """1/(M − ‖U_sᴴa‖²) equals 1/‖U_nᴴa‖², where U_n contains the other eigenvectors of the covariance."""
    instance = scene(**FADING)
    R = instance.Y @ instance.Y.conj().T / 200
    U_n = np.linalg.eigh(R).eigenvectors[:, :-3]
    X = np.random.default_rng(1).uniform(instance.lower, instance.upper, (20, 2))
    expected = [np.linalg.norm(U_n.conj().T @ oracles.response(instance.manifold, x)) ** 2 for x in X]
    assert_allclose(128 * (spectrum_of(instance).evaluate(X) - 2), expected, rtol=1e-9)


@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
def test_without_noise_refined_peaks_are_the_sources(wavefront):
    instance = noise_free(wavefront=wavefront, positions=[[-35, 3.0], [10, 2.0], [30, 4.0]])
    estimate = solve(Music(grid=COARSE, refine=True), instance)
    assert_allclose(estimate[np.argsort(estimate[:, 0])], instance.theta, atol=1e-6)


def test_without_noise_grid_peaks_are_within_half_a_step_of_the_sources():
    """At the broadside of a centred array, angle and range are decoupled, so that both are found to half a step."""
    centred = PAPER["array"] | {"origin": "center"}
    instance = noise_free(array=centred, sources=1, positions=[[0.1, 2.005]], azimuth_deg=[-5, 5], range_m=[1.5, 2.5])
    (estimate,) = solve(Music(grid=Grid(azimuth=64, range=51)), instance)
    step = np.array([math.radians(10) / 63, 1.0 / 50])
    assert (np.abs(estimate - instance.theta[0]) <= step / 2).all()
    on_grid = (estimate - instance.lower) / step
    assert_allclose(on_grid, np.round(on_grid), atol=1e-9)


def test_no_source_is_reported_twice():
    """Under fading, several maxima of one oblique ridge exceed the next source, so naive picking reports it twice."""
    naive_wrong = 0
    for seed in range(12):
        instance = scene(seed, **FADING)
        reached = [k for k in sources_reached(instance, solve(Music(grid=COARSE), instance)) if k >= 0]
        assert len(set(reached)) == len(reached) >= 2  # a weak source may have no peak
        axes = COARSE.axes(instance.lower, instance.upper)
        naive = grid_maxima([(signal_subspace(instance.Y, 3), instance.manifold)], axes, 3)
        naive_wrong += sorted(sources_reached(instance, naive)) != [0, 1, 2]
    assert naive_wrong >= 6


@pytest.mark.parametrize("other", [[11.2, 4.0], [10.0, 5.0]], ids=["angle", "range"])
def test_close_sources_are_distinguished(other):
    instance = scene(sources=2, positions=[[10.0, 4.0], other])
    assert sorted(sources_reached(instance, solve(Music(grid=COARSE), instance))) == [0, 1]


def test_each_source_is_reported_by_its_highest_grid_point():
    instance = scene(4)  # naive picking reports its first source twice
    maxima = grid_maxima(
        [(signal_subspace(instance.Y, 3), instance.manifold)], COARSE.axes(instance.lower, instance.upper), 50
    )
    reached = sources_reached(instance, maxima)
    expected = sorted(reached.index(k) for k in range(3))
    assert expected != [0, 1, 2]
    assert_array_equal(solve(Music(grid=COARSE), instance), maxima[expected])


def test_refinement_follows_a_narrow_ridge_to_its_end():
    """A single L-BFGS-B run ends halfway along this ridge, 9 to 18 m away, which would look like a separate peak."""
    positions = [[50.00929890658901, 18.478538151612366], [45.191100553181485, 7.113024757611191], [54.5587, 4.5775]]
    instance = scene(positions=positions)
    spectrum = spectrum_of(instance)
    halfway, true = (
        refine(spectrum, x, instance.manifold) for x in (np.array([0.89985317, 8.96592593]), instance.theta[0])
    )
    assert_allclose(halfway, true, rtol=1e-5)


def test_missing_peaks_are_replaced_by_the_highest_remaining_maxima():
    instance = scene(sources=1)
    maxima = grid_maxima(
        [(signal_subspace(instance.Y, 1), instance.manifold)], COARSE.axes(instance.lower, instance.upper), 50
    )
    ridge = maxima[[k == 0 for k in sources_reached(instance, maxima)]]
    assert len(ridge) >= 3
    points, peaks = pick_peaks(spectrum_of(instance), ridge, 3)
    assert_array_equal(points, ridge[:3])
    assert_array_equal(peaks[1:], ridge[1:3])
    assert len(pick_peaks(spectrum_of(instance), ridge[:2], 3)[0]) == 2


@pytest.mark.parametrize("block", [1, 300, 10**6])
@pytest.mark.parametrize(
    ("changes", "grid"),
    [({}, Grid(azimuth=31, range=60)), (SPACE, Grid(azimuth=15, elevation=12, range=9))],
    ids=["2d", "3d"],
)
def test_streaming_finds_the_same_maxima_as_the_whole_grid(monkeypatch, changes, grid, block):
    monkeypatch.setattr(music, "BLOCK", block)
    instance = scene(**changes)
    U_s = signal_subspace(instance.Y, instance.sources)
    axes = grid.axes(instance.lower, instance.upper)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    heights = np.sum(np.abs(instance.manifold.response(points) @ U_s.conj()) ** 2, axis=-1)
    expected = np.array([points[cell] for cell in brute_force_maxima(heights)])
    assert len(expected) > 5
    assert (expected[:, 0] == axes[0][0]).any() or (expected[:, -1] == axes[-1][0]).any()  # some are at the edges
    assert_array_equal(grid_maxima([(U_s, instance.manifold)], axes, 10**6), expected)
    assert_array_equal(grid_maxima([(U_s, instance.manifold)], axes, 4), expected[:4])


def test_the_grid_is_never_stored_as_a_whole(monkeypatch):
    monkeypatch.setattr(music, "BLOCK", 1)
    instance = scene(**SPACE)
    U_s = signal_subspace(instance.Y, 2)
    axes = Grid(azimuth=100, elevation=50, range=60).axes(instance.lower, instance.upper)
    grid_maxima([(U_s, instance.manifold)], axes, 10)
    tracemalloc.start()
    grid_maxima([(U_s, instance.manifold)], axes, 10)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 25 * 50 * 60 * 8  # 100 azimuths with four numbers per point would be 400


def test_a_plateau_counts_once():
    """With planar waves the range is undetermined, so that a whole line of the grid is one maximum."""
    instance = scene(wavefront="planar", sources=2, positions=[[-20, 5], [31, 5]])
    estimate = solve(Music(grid=COARSE), instance)
    assert_allclose(np.sort(estimate[:, 0]), np.radians([-20, 31]), atol=np.radians(120 / 199 / 2))
    axes = COARSE.axes(instance.lower, instance.upper)
    maxima = grid_maxima([(signal_subspace(instance.Y, 2), instance.manifold)], axes, 1000)
    assert len(np.unique(maxima[:, 0])) == len(maxima)


def test_sources_in_three_dimensions_are_found():
    instance = scene(**SPACE, positions=[[-35, 10, 0.2], [30, -20, 0.25]])
    estimate = solve(Music(grid=Grid(azimuth=40, elevation=30, range=20), refine=True), instance)
    assert instance.score(estimate)["rmse_m"] < 0.01


def test_an_estimator_may_assume_another_wavefront():
    instance = noise_free(wavefront="exact", positions=[[-35, 3.0], [10, 2.0], [30, 4.0]])
    same = solve(Music(grid=COARSE, refine=True, wavefront="exact"), instance)
    other = solve(Music(grid=COARSE, refine=True, wavefront="paper"), instance)
    assert instance.score(same)["rmse_m"] < 1e-6 < 1e-2 < instance.score(other)["rmse_m"]


def test_the_default_grids_are_those_of_the_paper():
    plane, space = scene(), scene(**SPACE)
    assert [len(axis) for axis in Grid().axes(plane.lower, plane.upper)] == [400, 2000]
    assert [len(axis) for axis in Grid().axes(space.lower, space.upper)] == [200, 200, 400]
    azimuth, ranges = Grid(azimuth=201, range=5).axes(plane.lower, plane.upper)
    assert_allclose(np.degrees(np.diff(azimuth)), 0.6)
    assert_allclose(ranges, [1.27, 5.9925, 10.715, 15.4375, 20.16])


def test_a_grid_in_elevation_requires_a_scenario_with_elevation():
    with pytest.raises(Incompatible, match=r"grid.elevation: expected none without elevation_deg, got 50"):
        solve(Music(grid=Grid(elevation=50)), scene())


def test_music_requires_at_least_as_many_snapshots_as_sources():
    with pytest.raises(Incompatible, match=r"snapshots: expected at least 3 .* got 2"):
        solve(Music(), scene(snapshots=2))


def test_music_is_built_from_a_manifest_table():
    formulation = Registry().make("formulation", "music", {"grid": {"azimuth": 200, "range": 1000}, "refine": True})
    assert formulation == Music(grid=COARSE, refine=True)
    assert not formulation.needs_solver


def test_labels_show_only_the_given_entries_of_a_grid(tmp_path):
    scenario = "\n".join(f"{key} = {value!r}" for key, value in PAPER.items() if key != "array")
    array = 'array = { kind = "ula", elements = 128, spacing_wavelengths = 0.25, origin = "first" }'
    formulations = '[[formulation]]\nkind = "music"\n' * 2 + "grid = { azimuth = 200, range = 1000 }\n"
    head = 'name = "labels"\nrepetitions = 1\nseed = 1\n[scenario]\nkind = "near-field"\n'
    path = tmp_path / "labels.toml"
    path.write_text(f"{head}{array}\n{scenario}\n{formulations}")
    labels = [method.formulation.label for method in nfbench.load_study(path).methods]
    assert labels == ["music(grid={})", "music(grid={azimuth=200, range=1000})"]


@pytest.mark.parametrize(
    ("grid", "path"), [({"azimuth": 1}, "grid.azimuth"), ({"azimut": 200}, "grid.azimut"), (200, "grid")]
)
def test_invalid_grids_are_refused(grid, path):
    with pytest.raises(OptionError) as refused:
        build(Music, {"grid": grid})
    assert [where for where, _ in refused.value.problems] == [path]


@pytest.mark.parametrize("formulation", [Music, ModifiedMusic, GridRefine])
def test_another_number_of_sources_may_be_assumed_or_estimated(formulation):
    instance = scene(array=PAPER["array"] | {"origin": "center"})
    assert len(solve(formulation(sources="estimate"), instance)) == 3
    assert len(solve(formulation(sources=2), instance)) == 2
    silence = scene(array=PAPER["array"] | {"origin": "center"}, snr_db=-60.0)
    assert solve(formulation(sources="estimate", criterion="mdl"), silence).shape == (0, 2)
