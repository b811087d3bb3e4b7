"""Frequencies in place of wavelengths, sources in Cartesian coordinates, and sectors of azimuth across ±180°."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible, OptionError
from nfbench.core.options import build, canonical
from nfbench.problems.near_field.estimators.certified import Certified
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid, Music
from nfbench.problems.near_field.geometry import azimuth_near, cartesian
from nfbench.problems.near_field.scenario import NearField

ULA = {"kind": "ula", "elements": 24, "spacing_wavelengths": 0.25, "origin": "center"}
UCA = {"kind": "uca", "elements": 24, "radius_wavelengths": 3.0, "origin": "center"}
MANIFEST = {
    "array": ULA,
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 50,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.3, 2.0],
}


def scenario(**changes):
    options = MANIFEST | changes
    return build(NearField, {name: value for name, value in options.items() if value is not None})


def draw(seed=0, **changes):
    return scenario(**changes).draw(np.random.default_rng(seed))


def bound(instance):
    return instance.score(instance.theta)["crb_m"]


# the wavelength


def test_a_frequency_and_a_speed_give_the_wavelength():
    by_frequency = scenario(wavelength_m=None, frequency_hz=15e9, speed_m_s=3e8)
    assert by_frequency.wavelength == 0.02
    assert scenario().wavelength == 0.02
    assert_array_equal(by_frequency.draw(np.random.default_rng(0)).Y, draw().Y)
    assert by_frequency.warnings() == scenario().warnings()
    assert scenario(wavelength_m=None, frequency_hz=1000.0, speed_m_s=344.7).wavelength == pytest.approx(0.3447)


def test_the_identity_of_a_scenario_with_a_wavelength_has_no_frequency():
    identity = canonical(scenario(), defaults=False)
    assert identity["wavelength_m"] == 0.02
    assert not {"frequency_hz", "speed_m_s", "positions_m"} & set(identity)


@pytest.mark.parametrize(
    ("changes", "path", "complaint"),
    [
        ({"wavelength_m": None}, "wavelength_m", "is required, unless frequency_hz and speed_m_s are given"),
        ({"frequency_hz": 1e9}, "frequency_hz", "expected either wavelength_m or frequency_hz, got both"),
        ({"wavelength_m": None, "frequency_hz": 1e9}, "speed_m_s", "299792458 for radio waves, about 343 for sound"),
        ({"speed_m_s": 343.0}, "speed_m_s", "expected none with wavelength_m, got 343.0"),
        ({"wavelength_m": None, "frequency_hz": -1.0, "speed_m_s": 343.0}, "frequency_hz", "got -1"),
        ({"wavelength_m": None, "frequency_hz": 1e18, "speed_m_s": 1.0}, "frequency_hz", "1e-09 to 1e+09 m, got 1e-18"),
    ],
)
def test_exactly_one_way_to_give_the_wavelength(changes, path, complaint):
    with pytest.raises(OptionError) as caught:
        scenario(**changes)
    assert [found for found, _ in caught.value.problems] == [path]
    assert complaint in caught.value.problems[0][1]


def test_frequency_and_speed_can_be_swept(tmp_path):
    from nfbench import load_study

    path = tmp_path / "study.toml"
    path.write_text(
        'name = "bins"\nscenes = 1\nseed = 1\n[scenario]\nkind = "near-field"\nspeed_m_s = 343\nsources = 1\n'
        "snapshots = 10\nsnr_db = 20\nazimuth_deg = [-60, 60]\nrange_m = [0.3, 2.0]\n"
        'array = { kind = "ula", elements = 16, spacing_m = 0.03, origin = "center" }\n'
        '[sweep]\n"scenario.frequency_hz" = [1000, 2000]\n"scenario.speed_m_s" = [340, 346]\n'
        '[[formulation]]\nkind = "grid-refine"\n'
    )
    study = load_study(path)
    assert [tuple(point.swept.values()) for point in study.points] == [(1e3, 340), (1e3, 346), (2e3, 340), (2e3, 346)]


# positions in metres


TURNED = {
    "kind": "custom",
    "positions": [[x, y, 5.0] for x in np.arange(4) * 0.01 for y in np.arange(5) * 0.01],
    "origin": "center",
    "broadside": "+z",
    "up": "+y",
}
SPACE = {"array": TURNED, "elevation_deg": [-60, 60], "range_m": [0.1, 3.0]}


def test_positions_in_metres_are_those_of_the_array():
    given = np.array([[0.2, -0.1, 6.0], [-0.3, 0.4, 5.5]])
    near_field = scenario(**SPACE, positions_m=given.tolist())
    instance = near_field.draw(np.random.default_rng(0))
    frame = near_field.array.frame(near_field.wavelength)
    assert_allclose(frame.outward(cartesian(instance.theta)), given, atol=1e-12)
    elements = frame.outward(instance.manifold.positions)
    distances = np.linalg.norm(given[:, None] - elements, axis=-1)
    phases = 2 * np.pi / 0.02 * (instance.theta[:, -1:] - distances)
    assert_allclose(instance.manifold.response(instance.theta), np.exp(1j * phases), atol=1e-9)


def test_positions_in_metres_of_a_built_in_array_are_relative_to_its_origin():
    for array in (ULA, ULA | {"origin": "first"}):
        instance = draw(array=array, positions_m=[[1.0, 0.5, 0.0], [0.4, -0.3, 0.0]])
        assert_allclose(cartesian(instance.theta), [[1.0, 0.5, 0.0], [0.4, -0.3, 0.0]], atol=1e-15)


def test_both_ways_to_fix_sources_give_the_same_scene():
    spherical = draw(positions=[[30, 1.0], [-20, 0.5]])
    metres = cartesian(spherical.theta).tolist()
    assert_allclose(draw(positions_m=metres).Y, spherical.Y, atol=1e-9)


@given(st.floats(-59.9, 59.9), st.floats(0.3, 2.0), st.sampled_from([-60.0, 60.0]))
@settings(max_examples=60, deadline=None)
def test_sources_up_to_the_edge_of_the_box_are_inside(azimuth, r, edge):
    angles = np.radians([azimuth, edge])
    points = np.stack([r * np.cos(angles), r * np.sin(angles), [0, 0]], axis=1)
    instance = draw(positions_m=points.tolist())
    assert (instance.theta >= instance.lower).all() and (instance.theta <= instance.upper).all()
    assert_allclose(cartesian(instance.theta), points, atol=1e-8)


@pytest.mark.parametrize(
    ("changes", "path", "complaint"),
    [
        ({"positions_m": [[1, 0, 0]]}, "positions_m", "expected 2 positions, one per source, got 1"),
        ({"positions_m": [[1, 0], [1, 0]]}, "positions_m[0][2]", ""),
        ({"positions_m": [[1, 0, 0], [1, 1, 0]], "positions": [[0, 1], [5, 1]]}, "positions_m", "got both"),
        (
            {"positions_m": [[1, 0, 0.25], [1, 1, 0]]},
            "positions_m[0]",
            "got [1.0, 0.0, 0.25], which is 0.25 m off that plane; set elevation_deg",
        ),
        (
            {"positions_m": [[1, 0, 0], [5, 0, 0]]},
            "positions_m[1]",
            "expected range_m within [0.3, 2], got [5.0, 0.0, 0.0], which is at azimuth 0°, elevation 0° and range 5 m",
        ),
        (
            {"positions_m": [[-1, 0, 0], [1, 0, 0]]},
            "positions_m[0]",
            "expected azimuth_deg within [-60, 60], got [-1.0",
        ),
        (
            SPACE | {"positions_m": [[0, 0, 6], [0, 5, 5.1]]},
            "positions_m[1]",
            "expected elevation_deg within [-60, 60]",
        ),
    ],
)
def test_wrong_positions_in_metres_are_refused(changes, path, complaint):
    with pytest.raises(OptionError) as caught:
        scenario(**changes)
    assert any(found == path and complaint in text for found, text in caught.value.problems)


# sectors


BEHIND = {"array": UCA, "azimuth_deg": [150, 210], "range_m": [0.2, 0.8]}


@pytest.mark.parametrize("azimuth_deg", [[150, 210], [-210, -150], [-200, 160], [180, 360], [-360, 0]])
def test_a_sector_may_extend_beyond_180_degrees(azimuth_deg):
    instance = draw(**BEHIND | {"azimuth_deg": azimuth_deg, "sources": 10, "min_separation_deg": 2.0})
    degrees = np.degrees(instance.theta[:, 0])
    assert (degrees >= azimuth_deg[0]).all() and (degrees <= azimuth_deg[1]).all()


def test_a_sector_turned_by_full_turns_gives_the_same_scenes():
    one, other = draw(**BEHIND), draw(**BEHIND | {"azimuth_deg": [-210, -150]})
    assert_allclose(other.theta[:, 0] + 2 * np.pi, one.theta[:, 0], rtol=1e-14)
    assert_allclose(other.Y, one.Y, atol=1e-9)
    assert_allclose(bound(other), bound(one), rtol=1e-9)


def test_fixed_azimuths_are_understood_up_to_full_turns():
    """Both −170° and 190° are in the sector from 150° to 210°."""
    in_sector = draw(**BEHIND | {"positions": [[190, 0.5], [160, 0.4]]})
    outside = draw(**BEHIND | {"positions": [[-170, 0.5], [160, 0.4]]})
    assert_allclose(outside.theta, in_sector.theta, rtol=1e-14)
    in_metres = draw(**BEHIND | {"positions_m": cartesian(in_sector.theta).tolist()})
    assert_allclose(in_metres.theta, in_sector.theta, rtol=1e-12)
    with pytest.raises(OptionError, match=r"positions\[0\]: expected azimuth_deg within \[150, 210\], got 140"):
        scenario(**BEHIND | {"positions": [[140, 0.5], [160, 0.4]]})


@pytest.mark.parametrize("across", [True, False], ids=["across 180°", "in front"])
def test_estimators_are_as_accurate_across_180_degrees_as_in_front(across):
    """A circular array, turned by half a turn, sees the same: the errors agree to the rounding of the search."""
    sector = {"azimuth_deg": [150, 210] if across else [-30, 30]}
    instance = draw(seed=5, **BEHIND | sector, min_separation_deg=10.0, snr_db=30.0)
    music = Music(grid=Grid(azimuth=300, range=60), refine=True)
    for formulation in (GridRefine(), music, Certified()):
        found = formulation.solve(instance, None)
        estimate = getattr(found, "estimate", found)
        error = instance.score(estimate)["rmse_m"]
        assert error < 3 * bound(instance) + 1e-3, formulation
        assert (estimate >= instance.lower - 1e-12).all() and (estimate <= instance.upper + 1e-12).all()


def test_modified_music_sees_the_largest_sine_of_the_sector():
    """Within 30° of the broadside, on either side of the line, |sin φ| <= 1/2, so the spacing may be up to λ/2."""
    table = {"kind": "ula", "elements": 24, "spacing_wavelengths": 0.45, "origin": "center"}
    behind = draw(array=table, azimuth_deg=[155, 205], range_m=[0.5, 2.0], seed=2, min_separation_deg=15.0)
    estimate = ModifiedMusic(grid=Grid(azimuth=1000, range=500)).solve(behind, None)
    assert behind.score(estimate)["rmse_m"] < 0.2
    with pytest.raises(Incompatible, match="modified MUSIC"):
        ModifiedMusic().solve(draw(array=table, azimuth_deg=[100, 205], range_m=[0.5, 2.0]), None)


def test_ambiguities_are_found_across_180_degrees():
    behind = scenario(azimuth_deg=[100, 170], range_m=[0.3, 2.0])
    assert not [text for text in behind.warnings() if "both sides" in text]
    both = scenario(azimuth_deg=[100, 280], range_m=[0.3, 2.0])  # the ends of the line are at 90° and 270°
    assert [text for text in both.warnings() if "both sides" in text]
    beyond = scenario(azimuth_deg=[60, 240])
    assert [text for text in beyond.warnings() if "both sides" in text]
    plane = {"kind": "upa", "columns": 4, "rows": 4, "spacing_wavelengths": 0.5, "origin": "center"}
    around = scenario(array=plane, azimuth_deg=[200, 340], elevation_deg=[-20, 20], range_m=[0.05, 0.1])
    assert [text for text in around.warnings() if "both sides" in text]


def test_azimuths_are_turned_next_to_others():
    assert_allclose(azimuth_near(np.array([3.0, -3.0, 0.0]), 3.1), [3.0, 2 * math.pi - 3, 0.0])
    assert_allclose(azimuth_near(np.array([10.0]), 0.0), [10.0 - 4 * math.pi])
