"""Crosses, rings, spirals, sunflowers and panels: the positions of their elements against the formulas."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import PROJECT
from numpy.testing import assert_allclose

from nfbench import OptionError
from nfbench.core.options import OneOf, build, canonical
from nfbench.problems.near_field.arrays import (
    UCA,
    ULA,
    UPA,
    Cross,
    Panel,
    Panels,
    Rings,
    Spiral,
    Sunflower,
    read_positions,
)
from nfbench.problems.near_field.scenario import NearField

DATA = PROJECT / ".." / "shared" / "data"
WAVELENGTH = 0.02
ALL = [
    Cross(columns=5, rows=3, spacing_wavelengths=0.5, origin="center"),
    Cross(columns=5, rows=4, spacing_m=[0.01, 0.02], origin="center"),
    Rings(radii_wavelengths=[1.0, 2.0], elements=[5, 8], center=True, stagger=True, origin="center"),
    Rings(radii_m=[0.1, 0.2, 0.3], elements=7, origin="center"),
    Spiral(form="archimedean", elements=9, arms=3, radius_m=0.5, turns=0.5, origin="center"),
    Spiral(form="logarithmic", elements=9, arms=2, radius_wavelengths=8.0, origin="center"),
    Sunflower(elements=64, radius_m=0.75, origin="center"),
    UPA(columns=3, rows=4, spacing_wavelengths=[0.5, 0.25], origin="center"),
    UPA(columns=3, rows=4, spacing_m=0.01, origin="center"),
    ULA(elements=5, spacing_m=0.01, origin="center"),
    UCA(elements=5, radius_m=0.1, origin="center"),
    Panels(
        panels=[
            {"array": {"kind": "ula", "elements": 4, "spacing_wavelengths": 0.5, "origin": "center"},
             "position_m": [0, y, 0]}
            for y in (-1.0, 1.0)
        ],
        origin="center",
    ),
]  # fmt: skip
EACH = pytest.mark.parametrize("array", ALL, ids=lambda array: array.kind)


@EACH
def test_every_array_has_as_many_distinct_elements_as_it_says(array):
    Q = array.place(WAVELENGTH)
    assert Q.shape == (array.count, 3)
    assert len(np.unique(np.round(Q, 12), axis=0)) == array.count
    assert len(array.element_names) == array.count


@EACH
def test_arrays_face_the_x_axis(array):
    if array.kind != "uca":
        assert_allclose(array.place(WAVELENGTH)[:, 0], 0.0, atol=1e-15)


@EACH
def test_the_origin_moves_an_array_without_changing_it(array):
    center, first = array.place(WAVELENGTH), replace(array, origin="first").place(WAVELENGTH)
    assert_allclose(first[0], 0.0, atol=1e-15)
    assert_allclose(first - first.mean(axis=0), center - center.mean(axis=0), atol=1e-14)


@EACH
def test_sizes_in_metres_do_not_change_with_the_wavelength_and_those_in_wavelengths_do(array):
    one, other = array.place(WAVELENGTH), array.place(3 * WAVELENGTH)
    if array.in_metres:
        assert_allclose(other, one, rtol=0, atol=0)
    elif array.kind != "panels":
        assert_allclose(other, 3 * one, rtol=1e-14, atol=1e-15)


@EACH
def test_arrays_survive_the_way_through_a_manifest(array):
    assert OneOf(type(array))._build(canonical(array)) == array
    assert OneOf(type(array))._build(canonical(array, defaults=False)) == array


def test_lengths_in_metres_equal_those_in_wavelengths():
    in_wavelengths = UPA(columns=3, rows=2, spacing_wavelengths=[0.5, 0.25], origin="first").place(WAVELENGTH)
    assert_allclose(in_wavelengths, [[0, 0.01 * y, 0.005 * z] for z in range(2) for y in range(3)], atol=1e-15)
    in_metres = UPA(columns=3, rows=2, spacing_m=[0.01, 0.005], origin="first").place(WAVELENGTH)
    assert_allclose(in_metres, in_wavelengths, rtol=1e-15)
    uneven = UPA(columns=16, rows=8, spacing_m=[0.01, 0.02], origin="first")
    assert uneven.aperture_m(WAVELENGTH) == pytest.approx(math.hypot(16 * 0.01, 8 * 0.02))


def test_a_cross_shares_its_centre_only_if_both_lines_have_one():
    odd = Cross(columns=3, rows=3, spacing_m=1.0, origin="center").place(WAVELENGTH)
    assert_allclose(odd, [[0, -1, 0], [0, 0, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])
    even = Cross(columns=2, rows=3, spacing_m=[2.0, 1.0], origin="center").place(WAVELENGTH)
    assert_allclose(even, [[0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 0], [0, 0, 1]])


def test_rings_have_their_radii_and_angles():
    rings = Rings(radii_m=[1.0, 3.0], elements=[4, 6], center=True, stagger=True, origin="center")
    _, y, z = rings.place(WAVELENGTH).T
    assert_allclose(np.hypot(y, z), [0, *[1] * 4, *[3] * 6], atol=1e-14)
    angles = np.degrees(np.arctan2(z, y)[1:]) % 360
    assert_allclose(angles, [0, 90, 180, 270, 30, 90, 150, 210, 270, 330], atol=1e-9)


def test_an_archimedean_spiral_turns_evenly():
    arm = Spiral(form="archimedean", elements=11, turns=2.0, radius_m=1.0, inner=0.2, origin="center")
    _, y, z = (arm.place(WAVELENGTH) - arm.place(WAVELENGTH)[0] + [0, 0.2, 0]).T
    assert_allclose(np.hypot(y, z), np.linspace(0.2, 1.0, 11), rtol=1e-12)
    assert_allclose(np.unwrap(np.arctan2(z, y)), 4 * np.pi * np.linspace(0, 1, 11), atol=1e-12)


def test_a_logarithmic_spiral_crosses_all_radii_at_one_angle_in_equal_steps_along_its_arm():
    arm = Spiral(form="logarithmic", elements=2001, turns=1.5, radius_m=1.0, inner=0.1, origin="center")
    Q = arm.place(WAVELENGTH)
    _, y, z = (Q - Q[0] + [0, 0.1, 0]).T
    r, angle = np.hypot(y, z), np.unwrap(np.arctan2(z, y))
    slope = np.diff(np.log(r)) / np.diff(angle)  # the cotangent of the angle between the arm and the radius
    assert_allclose(slope, math.log(10) / (3 * np.pi), rtol=1e-9)
    steps = np.hypot(np.diff(y), np.diff(z))
    assert_allclose(steps, steps.mean(), rtol=1e-3)  # chords instead of arcs


def test_arms_are_turned_copies_of_the_first():
    spiral = Spiral(form="logarithmic", elements=6, arms=5, radius_m=1.0, origin="center")
    w = spiral.place(WAVELENGTH)[:, 1:] @ [1, 1j]
    arms = w.reshape(5, 6)
    assert_allclose(arms, arms[0] * np.exp(2j * np.pi * np.arange(5)[:, None] / 5), atol=1e-14)
    assert_allclose(w.sum(), 0, atol=1e-13)


def test_a_sunflower_fills_its_disc_evenly_at_the_golden_angle():
    sunflower = Sunflower(elements=200, radius_m=2.0, origin="first")
    w = sunflower.place(WAVELENGTH)[:, 1:] @ [1, 1j]
    w += 2.0 * np.sqrt(1 / 200) * np.exp(1j * np.pi * (1 + math.sqrt(5)))
    assert_allclose(np.abs(w) ** 2, 4.0 * np.arange(1, 201) / 200, rtol=1e-12)
    assert_allclose(np.degrees(np.angle(w[1:] / w[:-1])) % 360, 180 * (1 + math.sqrt(5)) % 360, rtol=1e-9)


@pytest.mark.skipif(not DATA.is_dir(), reason="the measured data are not there")
def test_the_angles_of_a_real_sunflower():
    """The array of the MIRACLE data set is a Vogel spiral with V = 5, wound the other way and numbered differently."""
    Q, _ = read_positions(DATA / "miracle" / "positions_m.csv")
    real = Q[np.argsort(np.hypot(*Q.T[:2]))][:, :2] @ [1, 1j]
    ours = Sunflower(elements=64, radius_m=0.75, origin="center").place(WAVELENGTH)[:, 1:] @ [1, 1j]
    ours -= ours[-1] - 0.75 * np.exp(64j * np.pi * (1 + math.sqrt(5)))
    turns = np.angle(real[1:] / real[:-1] * ours[1:] / ours[:-1])  # opposite angles cancel
    assert_allclose(turns, 0.0, atol=1e-5)


def panel(array, position_m, **axes):
    return build(Panel, {"array": array, "position_m": position_m, **axes})


def test_panels_are_turned_to_their_front_and_moved_to_their_place():
    line = {"kind": "custom", "positions": [[0, 0, 0], [0, 1, 0], [0, 0, 2]], "origin": "first"}
    panels = Panels(
        panels=(panel(line, [1, 0, 0]), panel(line, [0, 5, 0], broadside="+y"), panel(line, [0, 0, 0], broadside="+z")),
        origin="first",
    )
    expected = [
        *([1, 0, 0], [1, 1, 0], [1, 0, 2]),
        *([0, 5, 0], [-1, 5, 0], [0, 5, 2]),  # facing +y, the left is −x
        *([0, 0, 0], [1, 0, 0], [0, 2, 0]),  # facing +z with +y upwards, the left is +x
    ]
    frame = panels.frame(WAVELENGTH)
    assert_allclose(frame.outward(panels.place(WAVELENGTH)), expected, atol=1e-15)
    assert_allclose(panels.place(WAVELENGTH), np.array(expected) - [1, 0, 0], atol=1e-15)
    assert_allclose(frame.origin, [1, 0, 0])


def test_panels_have_a_front_together():
    line = {"kind": "custom", "positions": [[0, 0, 0], [0, 1, 0], [0, 0, 2]], "origin": "first"}
    panels = Panels(panels=(panel(line, [0, 0, 7], broadside="+z"),), origin="first", broadside="+z")
    assert_allclose(panels.place(WAVELENGTH), line["positions"], atol=1e-15)
    assert_allclose(panels.frame(WAVELENGTH).outward(np.array([[1.0, 0.0, 0.0]])), [[0, 0, 8]], atol=1e-15)
    with pytest.raises(OptionError, match="up: expected a direction"):
        replace(panels, up="+z")


def test_two_panels_make_the_array_of_their_elements():
    half = {"kind": "ula", "elements": 4, "spacing_wavelengths": 0.5, "origin": "center"}
    panels = Panels(panels=(panel(half, [0, -0.02, 0]), panel(half, [0, 0.02, 0])), origin="center")
    whole = ULA(elements=8, spacing_wavelengths=0.5, origin="center")
    assert_allclose(panels.place(WAVELENGTH), whole.place(WAVELENGTH), atol=1e-16)


@pytest.mark.parametrize(
    ("cls", "options", "complaint"),
    [
        (ULA, {"elements": 8, "origin": "first"}, "spacing_wavelengths: expected either .* or spacing_m, got neither"),
        (ULA, {"elements": 8, "spacing_m": 1.0, "spacing_wavelengths": 1.0, "origin": "first"}, "got both"),
        (UCA, {"elements": 8, "origin": "first"}, "radius_wavelengths: expected either .* or radius_m, got neither"),
        (UPA, {"columns": 2, "rows": 2, "spacing_m": [1.0, 1.0, 1.0], "origin": "first"}, "spacing_m: expected"),
        (UPA, {"columns": 2, "rows": 2, "spacing_m": [1.0, 0.0], "origin": "first"}, r"spacing_m\[1\]: .*got 0"),
        (Cross, {"columns": 1, "rows": 3, "spacing_m": 1.0, "origin": "center"}, "columns: .*got 1"),
        (Cross, {"columns": 60_000, "rows": 60_000, "spacing_m": 1.0, "origin": "center"}, "at most 100,000 elements"),
        (Rings, {"radii_m": [], "elements": 4, "origin": "center"}, "radii_m: expected one or more different radii"),
        (Rings, {"radii_m": [1.0, 1.0], "elements": 4, "origin": "center"}, r"different radii, got \[1.0, 1.0\]"),
        (Rings, {"radii_m": [1.0, 2.0], "elements": [4], "origin": "center"}, "expected one number, or 2"),
        (Rings, {"radii_m": [1.0], "elements": 1, "origin": "center"}, "expected 2 to 100,000 elements, got 1"),
        (Spiral, {"form": "golden", "elements": 4, "radius_m": 1.0, "origin": "center"}, "form: .*'golden'"),
        (Spiral, {"form": "logarithmic", "elements": 1000, "arms": 999, "radius_m": 1.0, "origin": "center"}, "= 999,"),
        (Spiral, {"form": "logarithmic", "elements": 4, "radius_m": 1.0, "inner": 1.0, "origin": "center"}, "inner: "),
        (Panels, {"panels": [], "origin": "center"}, "panels: expected 1 to 1,000 panels, got 0"),
        (Panels, {"panels": [{"array": {"kind": "ulla"}, "position_m": [0, 0, 0]}], "origin": "center"},
         r"panels\[0\].array.kind: unknown kind 'ulla'"),
        (Panels, {"panels": [{"position_m": [0, 0, 0]}], "origin": "center"}, r"panels\[0\].array: is required"),
        (Panel, {"array": ALL[0], "position_m": [0, 0, 0], "broadside": [0, 0, 0]}, "broadside: expected a direction"),
        (Panel, {"array": ALL[0], "position_m": [0, 0, 0], "broadside": "+z", "up": "-z"}, "up: expected a direction"),
        (Panel, {"array": ALL[-1], "position_m": [0, 0, 0]}, "array: expected a table with a kind"),
    ],
)  # fmt: skip
def test_invalid_arrays_are_refused(cls, options, complaint):
    with pytest.raises(OptionError, match=complaint):
        build(cls, options)


def scenario(**changes):
    options = {
        "wavelength_m": WAVELENGTH, "sources": 1, "snapshots": 10, "snr_db": 20.0, "azimuth_deg": [-60, 60],
        "range_m": [0.5, 2.0],
    }  # fmt: skip
    return build(NearField, options | changes)


def test_panels_that_share_an_element_are_refused_where_the_wavelength_is_known():
    half = {"kind": "ula", "elements": 5, "spacing_wavelengths": 0.5, "origin": "center"}
    two = [{"array": half, "position_m": [0, y, 0]} for y in (-0.02, 0.02)]
    table = {"kind": "panels", "panels": two, "origin": "center"}
    with pytest.raises(OptionError, match=r"array.panels: .*got two at \[0, 0, 0\] m, one of them in panels\[[01]\]"):
        scenario(array=table)
    assert scenario(array=table, wavelength_m=0.019).manifold().elements == 10


@EACH
def test_scenes_of_every_array_can_be_localized(array):
    from nfbench.problems.near_field.estimators.grid_refine import GridRefine

    elevation = {} if array.kind in ("ula", "uca", "panels") else {"elevation_deg": [-30, 30]}
    instance = scenario(array=array, snr_db=40.0, range_m=[0.3, 0.5], **elevation).draw(np.random.default_rng(3))
    found = GridRefine().solve(instance, None)
    estimate = getattr(found, "estimate", found)
    assert instance.score(estimate)["rmse_m"] < 0.02
