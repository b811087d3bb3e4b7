"""Errors and bounds of azimuth, elevation and range: signs, turns, poles, assignment, and the sizes of both."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.core.options import build
from nfbench.problems.near_field.bounds import position_bounds, stochastic_bound
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.parameters import parameter_bounds, parameter_errors, parameter_scores, wrapped
from nfbench.problems.near_field.scenario import NearField, NearFieldInstance

LINE = {
    "array": {"kind": "ula", "elements": 32, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 3,
    "snapshots": 50,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.2, 2.0],
}
CIRCLE = LINE | {
    "array": {"kind": "uca", "elements": 32, "radius_wavelengths": 4.0, "origin": "center"},
    "azimuth_deg": [-180, 180],
}
PLANE = LINE | {
    "array": {"kind": "upa", "columns": 6, "rows": 6, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-60, 60],
    "range_m": [0.05, 0.5],
}


def draw(manifest, seed=0, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def fixed(manifest, *positions, **changes) -> NearFieldInstance:
    return draw(manifest, sources=len(positions), positions=[list(p) for p in positions], **changes)


def test_errors_have_the_sign_of_the_estimate_minus_the_truth():
    instance = fixed(PLANE, (-20, 10, 0.2), (30, -5, 0.3))
    moved = instance.theta + np.array(
        [[math.radians(1), math.radians(-2), 0.01], [math.radians(-3), math.radians(4), -0.02]]
    )
    scores = instance.score(moved)
    found = {name: scores[name] for name in scores if name.startswith(("azimuth", "elevation", "range"))}
    expected = {
        "azimuth_rmse_deg": math.sqrt(5), "elevation_rmse_deg": math.sqrt(10), "range_rmse_m": math.sqrt(2.5e-4),
        "azimuth_error_1_deg": 1.0, "elevation_error_1_deg": -2.0, "range_error_1_m": 0.01,
        "azimuth_error_2_deg": -3.0, "elevation_error_2_deg": 4.0, "range_error_2_m": -0.02,
    }  # fmt: skip
    assert list(found) == list(expected)
    assert_allclose(list(found.values()), list(expected.values()), rtol=1e-9)


def test_in_the_plane_there_is_no_elevation():
    names = [name for name in draw(LINE).score(draw(LINE).theta) if "azimuth" in name or "elevation" in name]
    assert names == [
        "azimuth_rmse_deg", "azimuth_error_1_deg", "azimuth_error_2_deg", "azimuth_error_3_deg",
        "crb_azimuth_deg", "crb_azimuth_1_deg", "crb_azimuth_2_deg", "crb_azimuth_3_deg",
    ]  # fmt: skip


@pytest.mark.parametrize(("true", "found", "error"), [(179, -179, 2), (-179.5, 179.5, -1), (180, -180, 0), (10, 9, -1)])
def test_errors_of_azimuths_wrap_around(true, found, error):
    instance = fixed(CIRCLE, (true, 1.0))
    scores = instance.score(np.array([[math.radians(found), 1.0]]))
    assert scores["azimuth_error_1_deg"] == pytest.approx(error, abs=1e-9)
    assert scores["azimuth_rmse_deg"] == pytest.approx(abs(error), abs=1e-9)


@settings(deadline=None, database=None, derandomize=True, max_examples=200)
@given(
    azimuth=st.floats(-20, 20),
    elevation=st.floats(-20, 20),
    r=st.floats(0.01, 10).flatmap(lambda r: st.sampled_from([r, -r])),
    d=st.sampled_from([2, 3]),
)
def test_any_angles_and_negative_ranges_are_read_as_the_positions_that_they_are(azimuth, elevation, r, d):
    """Against the angles of the Cartesian position."""
    theta = np.array([[azimuth, elevation, r]])[:, [0, 2] if d == 2 else [0, 1, 2]]
    same = wrapped(theta)
    assert_allclose(cartesian(same), cartesian(theta), atol=1e-12 * abs(r))
    assert same[0, -1] == abs(r) and (d == 2 or abs(same[0, 1]) <= math.pi / 2 + 1e-15)
    x, y, z = cartesian(theta)[0]
    truth = np.array([[0.3, 0.2, 1.0]])[:, [0, 2] if d == 2 else [0, 1, 2]]
    expected = np.array([math.atan2(y, x) - 0.3, math.asin(z / abs(r)) - 0.2, abs(r) - 1.0])[
        [0, 2] if d == 2 else [0, 1, 2]
    ]
    expected[0] -= 2 * math.pi * round(expected[0] / (2 * math.pi))
    found = parameter_errors(truth, theta)[0]
    if math.hypot(x, y) > 1e-6 * abs(r) and abs(abs(expected[0]) - math.pi) > 1e-6:
        assert_allclose(found, expected, atol=1e-7)


def test_a_source_at_a_pole_has_no_azimuth_but_an_estimate_there_has_the_one_that_was_estimated():
    truth = np.array([[0.5, math.pi / 2, 1.0], [0.2, 0.1, 1.0]])
    scores = parameter_scores(truth, truth + np.array([[0.1, -0.01, 0.0], [0.3, 0.0, 0.0]]))
    assert math.isnan(scores["azimuth_error_1_deg"])
    assert scores["azimuth_rmse_deg"] == pytest.approx(math.degrees(0.3)) == scores["azimuth_error_2_deg"]
    assert scores["elevation_error_1_deg"] == pytest.approx(math.degrees(-0.01))
    scores = parameter_scores(truth[1:], np.array([[0.9, math.pi / 2, 1.0]]))
    assert scores["azimuth_error_1_deg"] == pytest.approx(math.degrees(0.7))
    assert math.isnan(parameter_scores(truth[:1], truth[:1])["azimuth_rmse_deg"])


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_the_order_of_the_estimates_does_not_matter(order):
    instance = draw(LINE, min_separation_deg=10.0)
    moved = instance.theta + np.random.default_rng(1).normal(scale=1e-3, size=instance.theta.shape)
    assert instance.score(moved[list(order)]) == pytest.approx(instance.score(moved), rel=1e-12)
    errors = (moved - instance.theta)[:, 1]
    assert_allclose([instance.score(moved[list(order)])[f"range_error_{k}_m"] for k in (1, 2, 3)], errors, rtol=1e-9)


@settings(deadline=None, database=None, derandomize=True, max_examples=40)
@given(found=st.integers(0, 5), seed=st.integers(0, 1000))
def test_parameters_belong_to_the_pairs_of_the_position_errors(found, seed):
    """The law of cosines turns the errors of both parameters into error_k_m."""
    instance = draw(LINE, seed, snapshots=1)
    scores = instance.score(np.random.default_rng(seed).uniform(instance.lower, instance.upper, (found, 2)))
    missed = 0
    for k, (_, r) in enumerate(instance.theta, start=1):
        angle, ahead = math.radians(scores[f"azimuth_error_{k}_deg"]), scores[f"range_error_{k}_m"]
        missed += math.isnan(angle) and math.isnan(ahead) and math.isnan(scores[f"error_{k}_m"])
        square = r**2 + (r + ahead) ** 2 - 2 * r * (r + ahead) * math.cos(angle)
        assert math.isnan(square) or scores[f"error_{k}_m"] == pytest.approx(math.sqrt(square), rel=1e-6)
    assert missed == max(3 - found, 0)
    assert math.isnan(scores["range_rmse_m"]) == (found == 0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
@pytest.mark.parametrize("column", [0, 1])
def test_an_estimate_that_is_not_finite_has_no_errors(bad, column):
    instance = draw(LINE)
    estimate = instance.theta.copy()
    estimate[1, column] = bad
    scores = instance.score(estimate)
    found = [scores[name] for name in scores if name.startswith(("azimuth", "range"))]
    assert len(found) == 8 and (np.isnan(found).all() or (column == 0 and bad == 1e200))


@pytest.mark.parametrize("manifest", [LINE, PLANE], ids=["line", "plane"])
def test_bounds_of_the_parameters_make_up_the_bound_of_the_position(manifest):
    """Per source r²cos²ψ·σ_φ² + r²·σ_ψ² + σ_r², from the columns alone."""
    instance = draw(manifest, min_separation_deg=10.0)
    bounds = instance.bounds()
    for k, row in enumerate(instance.theta, start=1):
        elevation = row[1] if len(row) == 3 else 0.0
        square = (row[-1] * math.cos(elevation) * math.radians(bounds[f"crb_azimuth_{k}_deg"])) ** 2
        square += (row[-1] * math.radians(bounds.get(f"crb_elevation_{k}_deg", 0.0))) ** 2
        assert bounds[f"crb_{k}_m"] == pytest.approx(math.sqrt(square + bounds[f"crb_range_{k}_m"] ** 2), rel=1e-9)
    for name in ("azimuth", "range", *(["elevation"] if "elevation_deg" in manifest else [])):
        unit = "m" if name == "range" else "deg"
        each = [bounds[f"crb_{name}_{k}_{unit}"] for k in (1, 2, 3)]
        assert bounds[f"crb_{name}_{unit}"] == pytest.approx(math.sqrt(np.mean(np.square(each))), rel=1e-12)


def test_bounds_are_missing_where_they_do_not_hold():
    faded, planar = draw(LINE, rician_k=10.0, fading="block"), draw(LINE, wavefront="planar")
    assert not [name for instance in (faded, planar) for name in instance.bounds() if name.startswith("crb")]


@pytest.mark.parametrize("manifest", [LINE, PLANE], ids=["line", "plane"])
def test_errors_are_as_large_as_the_bounds(manifest):
    """WSF attains the bounds: over 120 scenes, the mean of (error/bound)² is 1 to within four standard errors, and
    errors of both signs are equally frequent."""
    positions = [[-35, 0.3], [5, 0.4], [40, 0.5]]
    if manifest is PLANE:
        positions = [[-35, 20, 0.1], [5, -30, 0.12], [40, 10, 0.15]]
    names = ("azimuth", "deg"), ("range", "m"), *([("elevation", "deg")] if manifest is PLANE else [])
    ratios = {name: [] for name, _ in names}
    for seed in range(120):
        instance = draw(manifest, seed, positions=positions, snr_db=30.0)
        scores = instance.score(GridRefine().solve(instance, None).estimate)
        for name, unit in names:
            ratios[name] += [scores[f"{name}_error_{k}_{unit}"] / scores[f"crb_{name}_{k}_{unit}"] for k in (1, 2, 3)]
    for found in map(np.array, ratios.values()):
        assert abs(np.mean(found**2) - 1) < 4 * np.std(found**2) / math.sqrt(len(found)) < 0.5
        assert abs(np.mean(found > 0) - 0.5) < 2 / math.sqrt(len(found))


def test_parameter_bounds_are_the_deviations_of_the_covariance():
    instance = draw(PLANE)
    C = stochastic_bound(instance.manifold, instance.theta, instance.snr, 50)
    bounds = parameter_bounds(C, instance.theta)
    columns = [[f"crb_azimuth_{k}_deg", f"crb_elevation_{k}_deg", f"crb_range_{k}_m"] for k in (1, 2, 3)]
    found = np.array([[bounds[name] for name in row] for row in columns]) * [math.pi / 180, math.pi / 180, 1.0]
    assert_allclose(found.ravel() ** 2, np.diag(C), rtol=1e-12)
    assert np.isfinite(position_bounds(C, instance.theta)).all()


def test_positions_list_assigned_estimates_first_and_the_others_after_them():
    instance = draw(LINE, min_separation_deg=10.0)
    surplus = np.array([[0.0, 1.9]])
    truth, found = instance.positions(np.vstack([surplus, instance.theta[[2, 0, 1]]]))
    assert_allclose(found, np.vstack([cartesian(instance.theta), cartesian(surplus)]))
    assert_array_equal(truth, cartesian(instance.theta))
    truth, found = instance.positions(instance.theta[[1]])
    assert_array_equal(np.isnan(found[:, 0]), [True, False, True])
    assert instance.positions(np.empty((0, 2)))[1].shape == (3, 3)
