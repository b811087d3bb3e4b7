"""Learned: how accurate the network is, what it does not depend on, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible
from nfbench.core.options import build
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.learned import Learned
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.learned import cosines
from nfbench.problems.near_field.scenario import NearField

PAPER = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
    "min_separation_deg": 2.0,
}

SPACE = {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "exact",
    "sources": 3,
    "snapshots": 100,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "elevation_deg": [-30, 30],
    "range_m": [0.452, 2.56],
    "min_separation_deg": 5.0,
}
BOTH = pytest.mark.parametrize("base", [PAPER, SPACE], ids=["ULA", "UPA"])


def scene(seed: int = 0, array: dict | None = None, base: dict = PAPER, **changes) -> NearFieldInstance:
    manifest = base | {"array": base["array"] | (array or {})} | changes
    manifest = {key: value for key, value in manifest.items() if value is not None}
    return build(NearField, manifest).draw(np.random.default_rng(seed))


def solve(instance: NearFieldInstance, **options) -> np.ndarray:
    def never(problem):
        raise AssertionError("a formulation with needs_solver = False called minimize")

    return Learned(**options).solve(instance, never)


def in_bounds(scenes: list[NearFieldInstance], **options) -> np.ndarray:
    scores = [instance.score(solve(instance, **options)) for instance in scenes]
    return np.array([score["rmse_m"] / score["crb_m"] for score in scores])


def in_box(estimate: np.ndarray, instance: NearFieldInstance) -> bool:
    return bool((estimate >= instance.lower).all() and (estimate <= instance.upper).all())


def test_the_errors_are_those_that_the_documentation_states():
    """About 3 bounds at 20 dB in the median, and at most 10 in more than 80 % of scenes; no source is missed."""
    errors = in_bounds([scene(seed) for seed in range(50)])
    assert 2.5 <= np.median(errors) <= 4.0
    assert np.mean(errors <= 10) >= 0.8
    assert errors.max() < 40


def test_the_errors_with_elevation_are_those_that_the_documentation_states():
    """About 4 bounds at 20 dB in the median, and at most 10 in more than 80 % of scenes; no source is missed."""
    errors = in_bounds([scene(seed, base=SPACE) for seed in range(50)])
    assert 2.5 <= np.median(errors) <= 4.5
    assert np.mean(errors <= 10) >= 0.8
    assert errors.max() < 40


@BOTH
def test_refined_estimates_meet_the_bound_as_those_of_grid_refine(base):
    scenes = [scene(seed, base=base) for seed in range(50)]
    errors = in_bounds(scenes, refine=True)
    assert np.median(errors) < 1.0
    assert np.mean(errors <= 3) == 1.0
    reference = [GridRefine().solve(instance, None).estimate for instance in scenes]
    reference = [instance.score(found)["rmse_m"] for instance, found in zip(scenes, reference, strict=True)]
    assert np.median(errors * [each.bounds()["crb_m"] for each in scenes]) < 1.1 * np.median(reference)


def test_angles_are_within_a_thirtieth_of_a_beamwidth_of_the_sources():
    for seed in range(20):
        instance = scene(seed)
        found, true = np.sort(solve(instance)[:, 0]), np.sort(instance.theta[:, 0])
        assert_allclose(np.sin(found), np.sin(true), atol=1 / 30 / 32)


def test_directions_are_within_a_thirtieth_of_a_beamwidth_of_the_sources():
    for seed in range(20):
        instance = scene(seed, base=SPACE)
        found, true = cosines(solve(instance)), cosines(instance.theta)
        distance = np.abs(found[:, None] - true).max(axis=-1)
        assert distance.min(axis=0).max() < 1 / 30 / 8


@BOTH
@pytest.mark.parametrize("refine", [False, True])
def test_the_same_data_give_the_same_estimate(refine, base):
    instance = scene(base=base)
    assert_array_equal(solve(instance, refine=refine), solve(instance, refine=refine))


@BOTH
def test_phases_and_powers_and_the_order_of_snapshots_make_no_difference(base):
    """Only the signal subspace counts, not the phases and the order of its eigenvectors."""
    instance, rng = scene(base=base), np.random.default_rng(1)
    expected = solve(instance)
    shuffled = instance.Y[:, rng.permutation(base["snapshots"])]
    for Y in (1j * instance.Y, 7.0 * instance.Y, shuffled, instance.Y * np.exp(2j)):
        assert_allclose(solve(replace(instance, Y=Y)), expected, rtol=1e-4)
    order = rng.permutation(len(instance.Y))
    manifold = replace(instance.manifold, positions=instance.manifold.positions[order])
    assert_allclose(solve(replace(instance, Y=instance.Y[order], manifold=manifold)), expected, rtol=1e-4)


def test_only_the_ratio_of_ranges_and_wavelength_counts():
    here, there = scene(), scene(wavelength_m=0.1, range_m=[6.35, 100.8])
    assert_allclose(there.Y, here.Y, atol=1e-6)
    assert_allclose(solve(there), solve(here) * [1, 5], rtol=1e-4)


def test_only_the_ratio_of_ranges_and_wavelength_counts_with_elevation():
    here, there = scene(base=SPACE), scene(base=SPACE, wavelength_m=0.1, range_m=[2.26, 12.8])
    assert_allclose(there.Y, here.Y, atol=1e-6)
    assert_allclose(solve(there), solve(here) * [1, 1, 5], rtol=1e-4)


def test_a_part_of_the_box_is_enough():
    instance = scene(azimuth_deg=[0, 60], range_m=[2.0, 10.0])
    estimate = solve(instance)
    assert in_box(estimate, instance) and instance.score(estimate)["rmse_m"] < 0.3


def test_a_part_of_the_box_with_elevation_is_enough():
    instance = scene(base=SPACE, azimuth_deg=[0, 60], elevation_deg=[-10, 30], range_m=[0.5, 1.5])
    estimate = solve(instance)
    assert in_box(estimate, instance) and instance.score(estimate)["rmse_m"] < 0.1


@pytest.mark.parametrize("sources", [1, 5])
def test_other_numbers_of_sources_with_elevation_are_found(sources):
    found = [scene(seed, base=SPACE, sources=sources, min_separation_deg=8.0) for seed in range(10)]
    assert np.median(in_bounds(found)) < 8
    assert np.median(in_bounds(found, refine=True)) < 1.5


@pytest.mark.parametrize("sources", [1, 2, 5])
def test_other_numbers_of_sources_than_in_training_are_found(sources):
    """The network sees no number of sources: the best proposals are taken."""
    found = [scene(seed, sources=sources, min_separation_deg=4.0) for seed in range(10)]
    assert np.median(in_bounds(found)) < 15
    assert np.median(in_bounds(found, refine=True)) < 1.5


def test_the_number_of_sources_may_be_assumed_or_estimated():
    instance = scene()
    assert len(solve(instance, sources="estimate")) == 3
    assert len(solve(instance, sources=2)) == 2
    assert solve(scene(snr_db=-60.0), sources="estimate", criterion="mdl").shape == (0, 2)


@pytest.mark.parametrize("wavefront", ["exact", "fresnel"])
def test_a_known_wavefront_is_used_and_a_wrong_one_biases_the_range(wavefront):
    """The paper's wavefront has no cos²φ: at 50° it sees a spherical wave from 1/cos²φ = 2.4 times as far."""
    instance = scene(wavefront=wavefront, positions=[[50, 3.0], [0, 4.0], [-50, 5.0]], snr_db=30.0)
    by_azimuth = np.argsort(instance.theta[:, 0])
    known, assumed = (solve(instance, wavefront=name) for name in (None, "paper"))
    known, assumed = known[np.argsort(known[:, 0])], assumed[np.argsort(assumed[:, 0])]
    true = instance.theta[by_azimuth]
    assert_allclose(known[:, 1], true[:, 1], rtol=0.1)
    assert_allclose(assumed[:, 1], true[:, 1] / np.cos(true[:, 0]) ** 2, rtol=0.2)


def test_with_elevation_another_wavefront_than_in_training_costs_accuracy_that_a_local_search_restores():
    """The network was trained with spherical waves; Fresnel's are similar, the paper's differ in their curvature."""
    errors = {}
    for wavefront in ("exact", "fresnel", "paper"):
        scenes = [scene(seed, base=SPACE, wavefront=wavefront) for seed in range(10)]
        errors[wavefront] = np.median([each.score(solve(each))["rmse_m"] for each in scenes])
        assert np.median(in_bounds(scenes, refine=True)) < 1.5
    assert errors["exact"] < 0.03
    assert errors["exact"] < errors["fresnel"] < 0.1 < errors["paper"]


def test_two_sources_at_one_angle_are_one_proposal():
    instance = scene(positions=[[10, 2.0], [10, 8.0], [-30, 4.0]])
    estimate = solve(instance)
    assert len(estimate) == 3 and in_box(estimate, instance)
    assert np.sum(np.abs(estimate[:, 0] - np.radians(10)) < 0.005) == 1


def test_two_sources_in_one_direction_are_one_proposal():
    instance = scene(base=SPACE, positions=[[10, 5, 0.5], [10, 5, 2.0], [-30, -10, 1.0]])
    estimate = solve(instance)
    assert len(estimate) == 3 and in_box(estimate, instance)
    assert np.sum(np.abs(estimate[:, :2] - np.radians([10, 5])).max(axis=1) < 0.02) == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"positions": [[10, 5, 1.0], [10, 5, 1.0], [-30, 0, 2.0]], "min_separation_deg": 0.0},  # coincident
        {"impairments": {"source_correlation": 1.0}},  # coherent: one dimension of signal
        {"positions": [[60, 30, 0.452], [-60, -30, 2.56], [60, -30, 0.452]]},  # corners of the box
        {"snr_db": -60.0},
        {"sources": 100, "min_separation_deg": 0.0},  # as many as snapshots
    ],
    ids=["coincident", "coherent", "corners", "noise", "many"],
)
@pytest.mark.parametrize("refine", [False, True])
def test_hard_scenes_with_elevation_give_estimates_in_the_box(changes, refine):
    instance = scene(base=SPACE, **changes)
    estimate = solve(instance, refine=refine)
    assert 1 <= len(estimate) <= instance.sources and estimate.shape[1] == 3 and in_box(estimate, instance)
    assert np.isfinite(list(instance.score(estimate).values())).any()


@pytest.mark.parametrize(
    "changes",
    [
        {"positions": [[10, 2.0], [10, 2.0], [-30, 4.0]], "min_separation_deg": 0.0},  # coincident
        {"impairments": {"source_correlation": 1.0}},  # coherent: one dimension of signal
        {"positions": [[60, 1.27], [-60, 20.16], [0, 1.27]]},  # corners of the box
        {"rician_k": 1e-6, "fading": "block"},  # no line of sight
        {"snr_db": -60.0},
        {"sources": 127, "min_separation_deg": 0.0, "snapshots": 127},  # M − 1
    ],
    ids=["coincident", "coherent", "corners", "scattered", "noise", "many"],
)
@pytest.mark.parametrize("refine", [False, True])
def test_hard_scenes_give_estimates_in_the_box(changes, refine):
    instance = scene(**changes)
    estimate = solve(instance, refine=refine)
    assert 1 <= len(estimate) <= instance.sources and in_box(estimate, instance)
    assert np.isfinite(list(instance.score(estimate).values())).any()


def test_known_phases_positions_and_failures_are_used():
    impairments = {"phase_error_deg": 60.0, "position_error_wavelengths": 0.05, "failed_elements": 3}
    instance = scene(impairments=impairments, wavefront="paper")
    informed = solve(instance, known_gains=True, known_positions=True, known_failed=True)
    assert instance.score(informed)["rmse_m"] < 1.0
    refined = solve(instance, known_gains=True, known_positions=True, known_failed=True, refine=True)
    assert instance.score(refined)["rmse_m"] < 3 * instance.bounds()["crb_m"]


@pytest.mark.parametrize(
    ("array", "changes", "reason"),
    [
        (
            {"elements": 64},
            {},
            r"array: expected the ULA of 128 elements at λ/4 .* or the UPA of 16 × 16 elements at λ/2 .*, "
            r"for which networks were trained, got 64 elements; grid-refine works",
        ),
        ({"origin": "first"}, {}, r'origin "center".*, got 128 elements up to 15.9 wavelengths from those of the ULA'),
        ({"spacing_wavelengths": 0.5}, {}, r"at λ/4 .*, got 128 elements up to 15.9 wavelengths from those of the ULA"),
        ({}, {"azimuth_deg": [-70, 60]}, r"azimuth_deg: expected an interval within \[-60, 60\], .*, got \[-70, 60\]"),
        ({}, {"range_m": [1.0, 20.16]}, r"range_m: .* within \[1.27, 20.16\], 63.5 to 1008 wave.*, got \[1, 20.16\]"),
        ({}, {"wavelength_m": 0.04}, r"range_m: expected an interval within \[2.54, 40.32\], 63.5 to 1008 wavelengths"),
        (
            {},
            {"elevation_deg": [-30, 30]},
            r"elevation_deg: expected none with the ULA .* trained in the plane, got an interval",
        ),
        ({}, {"wavefront": "planar"}, r'wavefront: expected "exact", "fresnel" or "paper" for learned, got "planar"'),
        ({}, {"bins": 3, "bandwidth_relative": 0.1}, r"bins: expected 1 for learned, .*, got 3; use neef"),
        ({}, {"snapshots": 2}, r"snapshots: expected at least 3 .* got 2"),
    ],
)
def test_what_differs_too_much_from_training_is_refused(array, changes, reason):
    with pytest.raises(Incompatible, match=reason):
        solve(scene(array=array, **changes))


@pytest.mark.parametrize(
    ("array", "changes", "reason"),
    [
        (
            {"rows": 8},
            {},
            r"expected the ULA .* or the UPA .*, got 128 elements up to .* wavelengths from those of the ULA",
        ),
        (
            {"origin": "first"},
            {},
            r"array: .*, got 256 elements up to 3.75 wavelengths from those of the UPA; grid-refine",
        ),
        ({"spacing_wavelengths": 0.25}, {}, r"array: .*, got 256 elements up to .* wavelengths from those of the UPA"),
        ({}, {"elevation_deg": None}, r"elevation_deg: expected an interval with the UPA .* with elevation, got none"),
        ({}, {"azimuth_deg": [-60, 70]}, r"azimuth_deg: .* within \[-60, 60\], .* for the UPA .*, got \[-60, 70\]"),
        ({}, {"elevation_deg": [-30, 40]}, r"elevation_deg: .* within \[-30, 30\], .* the UPA .*, got \[-30, 40\]"),
        ({}, {"range_m": [0.452, 3.0]}, r"range_m: .* within \[0.452, 2.56\], 22.6 to 128 wave.*, got \[0.452, 3\]"),
        ({}, {"wavefront": "planar"}, r'wavefront: expected "exact", "fresnel" or "paper" for learned, got "planar"'),
        ({}, {"bins": 3, "bandwidth_relative": 0.1}, r"bins: expected 1 for learned, .*, got 3; use neef"),
    ],
)
def test_what_differs_too_much_from_training_with_elevation_is_refused(array, changes, reason):
    with pytest.raises(Incompatible, match=reason):
        solve(scene(array=array, base=SPACE, **changes))


def test_knowledge_that_needs_more_than_phases_is_refused():
    instance = scene(impairments={"gain_error_db": 3.0})
    with pytest.raises(Incompatible, match="expected phases only for learned"):
        solve(instance, known_gains=True)
    with pytest.raises(Incompatible, match="expected phases only for learned"):
        solve(instance, amplitude="spherical")


def test_it_is_registered():
    assert Registry().make("formulation", "learned", {"refine": True}) == Learned(refine=True)
