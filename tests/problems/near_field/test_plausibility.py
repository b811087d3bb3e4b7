"""Tests that plausible wrong input is named in a warning with its numbers, and that usual input is not."""

import math
import time

import numpy as np
import pytest

from nfbench.core.options import build
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid, Music, search_s
from nfbench.problems.near_field.geometry import ambiguity, directions, flatness, nearest_distances
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import grid_size, resolution_grid

WAVELENGTH = 0.02
ULA = {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"}
UPA = {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"}
UCA = {"kind": "uca", "elements": 32, "radius_wavelengths": 2.5, "origin": "center"}
BASE = {
    "array": ULA,
    "wavelength_m": WAVELENGTH,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
NEAR = {"range_m": [0.1, 0.5]}
GRID = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) * 0.01  # λ/2 apart


def plane(*axes, scale=1.0, tilt_deg=0.0):
    """A custom array of 8 × 8 elements in the plane of two axes, e.g. 1, 2 for the y-z plane, turned about z."""
    Q = np.zeros((64, 3))
    Q[:, axes] = GRID * scale
    c, s = math.cos(math.radians(tilt_deg)), math.sin(math.radians(tilt_deg))
    Q = Q @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return {"kind": "custom", "origin": "center", "positions": Q.tolist()}


def line(direction):
    Q = np.outer(np.arange(16) * 0.01, direction)
    return {"kind": "custom", "origin": "center", "positions": Q.tolist()}


def warnings(**changes):
    return build(NearField, BASE | changes).warnings()


USUAL = {
    "the paper's ULA": {},
    "the ULA at λ/2": {"array": ULA | {"spacing_wavelengths": 0.5}, "range_m": [2.54, 80.6]},
    "the paper's UPA": {"array": UPA, "elevation_deg": [-30, 30], "range_m": [0.452, 2.56]},
    "a horizontal circle": {"array": UCA, "azimuth_deg": [-180, 180], **NEAR},
    "a circle that looks up": {"array": UCA, "azimuth_deg": [-180, 180], "elevation_deg": [5, 60], **NEAR},
    "a plane that faces the sources": {"array": plane(1, 2), "elevation_deg": [-30, 30], **NEAR},
    "a line along y": {"array": line([0, 1, 0]), **NEAR},
    "a line up to its ends": {"azimuth_deg": [-90, 90]},
    "all behind the line": {"azimuth_deg": [100, 170]},
    "clusters": {"nlos": {"kind": "clusters"}, "rician_k": 10.0, "fading": "block"},
    "sources 1° apart": {"min_separation_deg": 1.0},
    "fixed positions": {"positions": [[-10, 5], [0, 6], [10, 7]]},
    "a sixth beyond the near field": {"range_m": [1.27, 48.0]},
}


@pytest.mark.parametrize("name", USUAL)
def test_usual_input_has_no_warnings(name):
    assert warnings(**USUAL[name]) == []


UNUSUAL = {
    "millimetres": (
        {"array": plane(1, 2, scale=1000.0), "elevation_deg": [-30, 30]},
        "array: its 64 elements have an aperture of 98.99 m, 4,950 wavelengths of 0.02 m, and are at least 10 m apart, "
        "500 wavelengths; half a wavelength is usual; positions are in metres: are these millimetres?",
    ),
    "centimetres": ({"array": plane(1, 2, scale=100.0), "elevation_deg": [-30, 30]}, "1 m apart, 50 wavelengths"),
    "a wide spacing": ({"array": ULA | {"spacing_wavelengths": 5.0}}, "0.1 m apart, 5 wavelengths; half a wavelength"),
    "an extent over 1,000 wavelengths": (
        {"array": ULA | {"elements": 3000, "spacing_wavelengths": 0.5}},
        "array: its 3000 elements have an aperture of 29.99 m, 1,500 wavelengths",
    ),
    "a tiny array": (
        {"array": plane(1, 2, scale=1e-3), **NEAR},
        "array: its 64 elements have an aperture of 9.899e-05 m",
    ),
    "in the x-y plane": (
        {"array": plane(0, 1), "elevation_deg": [5, 30], **NEAR},
        "array: its elements lie in a plane that contains the x axis, from which azimuths are measured and which is "
        "assumed to be the broadside (for example the x-y plane); set broadside to the direction in front of the "
        'array, for example "+z" or "-z"',
    ),
    "in the x-z plane": ({"array": plane(0, 2), "azimuth_deg": [5, 60], **NEAR}, "in a plane that contains the x axis"),
    "along x": ({"array": line([1, 0, 0]), "azimuth_deg": [5, 60], **NEAR}, "array: its elements lie on a line along"),
    "both sides of a line": (
        {"azimuth_deg": [-180, 180]},
        "azimuth_deg: the box contains both sides of the array, whose elements lie on a line, seen along the z axis, "
        "and cannot distinguish, for example, the azimuths",
    ),
    "some of both sides of a line": ({"azimuth_deg": [-60, 120]}, "for example, the azimuths 120° and 60°"),
    "both sides of a turned line": (
        {"array": line([-math.sin(0.5), math.cos(0.5), 0]), "azimuth_deg": [-89, 150], **NEAR},
        "azimuth_deg: the box contains both sides of the array, whose elements lie on a line",
    ),
    "around a line": (
        {"elevation_deg": [-30, 30]},
        "azimuth_deg and elevation_deg: the box contains both sides of the array, whose elements lie on a line and",
    ),
    "azimuths of a vertical line": ({"array": line([0, 0, 1]), **NEAR}, "the azimuths -60° and 60°"),
    "both sides of a plane": (
        {"array": UPA, "azimuth_deg": [-60, 150], "elevation_deg": [-30, 30], **NEAR},
        "whose elements lie in a plane and cannot distinguish, for example, the directions (150°, 0°) and (30°, 0°)",
    ),
    "both sides of a plane in 2D": ({"array": UPA, "azimuth_deg": [-120, 120], **NEAR}, "azimuths -120° and -60°"),
    "both sides of a circle": (
        {"array": UCA, "azimuth_deg": [-180, 180], "elevation_deg": [-30, 30], **NEAR},
        "azimuth_deg and elevation_deg: the box contains both sides of the array, whose elements lie in a plane",
    ),
    "radians": (
        {"azimuth_deg": [-1.047, 1.047]},
        "azimuth_deg: [-1.047, 1.047]° is an unusually narrow interval; are these radians? [-1.047, 1.047] rad is "
        "[-59.99, 59.99]°",
    ),
    "a circle in radians": ({"array": UCA, "azimuth_deg": [-3.1416, 3.1416], **NEAR}, "[-180, 180]°"),
    "an elevation in radians": (
        {"array": UPA, "elevation_deg": [-0.5236, 0.5236], **NEAR},
        "elevation_deg: [-0.5236, 0.5236]° is an unusually narrow interval; are these radians?",
    ),
    "a separation in radians": ({"min_separation_deg": 0.035}, "min_separation_deg: 0.035° is unusually small"),
    "positions in radians": (
        {"positions": [[-0.5, 5], [0, 6], [0.7, 7]]},
        "positions: all azimuths are within ±0.7°; are these radians? 0.7 rad is 40.1°",
    ),
    "a spread in radians": (
        {"nlos": {"kind": "clusters", "angular_spread_deg": 0.087}, "rician_k": 10.0, "fading": "block"},
        "nlos.angular_spread_deg: 0.087° is unusually small; is it in radians? 0.087 rad are 4.98°",
    ),
    "a spread around a source in radians": (
        {"nlos": {"kind": "cluster-around-source", "angular_spread_deg": 0.1}},
        "nlos.angular_spread_deg: 0.1°",
    ),
    "beyond the near field": (
        {"range_m": [50, 100]},
        "range_m: 100% of [50, 100] m lie beyond the Fraunhofer distance 2D²/λ = 40.32 m of this array",
    ),
    "mostly beyond the near field": ({"range_m": [1.27, 200]}, "range_m: 80% of [1.27, 200] m lie beyond"),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_unusual_input_is_named_with_its_numbers(name):
    changes, part = UNUSUAL[name]
    assert any(part in text for text in warnings(**changes)), warnings(**changes)


def test_the_fraunhofer_distance_of_the_paper():
    """The paper takes √2·16·δ = 0.226 m for 16 × 16 elements at λ/2, and (M − 1)·δ = 0.635 m for 128 at λ/4."""
    for array, expected in ((UPA, 0.226), (ULA, 0.635), (UCA, 0.1)):
        assert build(NearField, BASE | {"array": array}).array.aperture_m(WAVELENGTH) == pytest.approx(
            expected, abs=5e-4
        )


@pytest.mark.parametrize("seed", range(20))
def test_a_pair_that_cannot_be_distinguished_has_equal_distances(seed):
    rng = np.random.default_rng(seed)
    Q = rng.normal(size=(10, 3))
    rank = seed % 2 + 1
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    Q = (Q @ axes)[:, :rank] @ axes[:, :rank].T  # on a line or in a plane, turned at random
    shape, pair = ambiguity(Q, np.array([-3.1, -1.5, 0.1]), np.array([3.1, 1.5, 1.0]), 1e-9)
    assert shape == ("line" if rank == 1 else "plane")
    u = directions(np.column_stack([pair, np.ones(2)]))
    for r in (0.5, 3.0):
        distances = np.linalg.norm(r * u[:, None] - Q, axis=-1)
        np.testing.assert_allclose(distances[0], distances[1], rtol=1e-9)
    assert np.linalg.norm(u[0] - u[1]) > 0.03


def test_an_array_that_fills_space_distinguishes_all_directions():
    rng = np.random.default_rng(0)
    lower, upper = np.array([-3.1, -1.5, 0.1]), np.array([3.1, 1.5, 1.0])
    assert ambiguity(rng.normal(size=(10, 3)), lower, upper, 1e-9) is None
    assert ambiguity(rng.normal(size=(10, 3)), lower[[0, 2]], upper[[0, 2]], 1e-9) is None


def test_flatness_and_nearest_distances():
    rng = np.random.default_rng(0)
    Q = rng.uniform(-1, 1, (200, 3))
    assert [flatness(Q * scale, 1e-3)[0] for scale in ([1, 1, 1], [1, 1, 1e-4], [1, 1e-4, 1e-4])] == [3, 2, 1]
    assert abs(flatness(Q * [1, 1e-6, 1], 1e-3)[1][2, 1]) == pytest.approx(1.0, abs=1e-6)
    brute = np.linalg.norm(Q[:, None] - Q, axis=-1) + 9 * np.eye(200)
    np.testing.assert_allclose(nearest_distances(Q), brute.min(axis=1))


def near_field(**changes):
    return build(NearField, BASE | changes)


def test_a_default_grid_that_takes_long_is_named():
    large = near_field(array=UPA, elevation_deg=[-30, 30], range_m=[0.452, 2.56])
    assert Music().warnings(large) == []  # interpolated along the range, it takes about a second
    (text,) = Music(interpolate=False).warnings(large)
    assert text.startswith("grid: the default of 200 × 200 × 400 points with 256 elements takes about ")
    assert Music(Grid(200, 200, 400), interpolate=False).warnings(large) == []  # as it was chosen
    assert len(Music(Grid(azimuth=200), interpolate=False).warnings(large)) == 1
    assert Music(Grid(40, 40, 40)).warnings(large) == Music().warnings(near_field()) == []
    long = near_field(array=ULA | {"elements": 20_000}, range_m=[1.27, 20.16])
    assert "400 × 2000 points with 20000 elements" in Music().warnings(long)[0]


def test_modified_music_warns_only_where_its_lines_take_long():
    assert ModifiedMusic().warnings(near_field()) == []
    vast = near_field(array=ULA | {"elements": 100_000}, sources=1000, snapshots=900)
    (text,) = ModifiedMusic().warnings(vast)
    assert text.startswith("grid: the default of 400 azimuths and 2000 ranges with 100000 elements and 1000 sources")
    assert ModifiedMusic(Grid(azimuth=400, range=2000)).warnings(vast) == []


def test_a_default_density_that_takes_long_is_named_and_a_high_one_that_fills_the_memory():
    large = near_field(array=UPA | {"columns": 64, "rows": 64}, elevation_deg=[-60, 60], range_m=[0.5, 40.0])
    (text,) = GridRefine().warnings(large)
    assert text.startswith("density: the default, 1.5, gives a grid of about ") and "with 4096 elements" in text
    assert GridRefine().warnings(near_field()) == GridRefine(density=3.0).warnings(large) == []
    (text,) = GridRefine(density=100.0).warnings(large)
    assert text.startswith("density: 100 gives a grid of about ") and "may not fit in memory" in text


@pytest.mark.parametrize(
    "changes",
    [{}, {"array": UPA, "elevation_deg": [-30, 30], **NEAR}, {"array": UCA, "azimuth_deg": [-180, 180], **NEAR}],
)
def test_the_estimated_size_of_a_grid_is_that_of_the_grid(changes):
    scenario = near_field(**changes)
    estimated = math.prod(grid_size(scenario.manifold(), *scenario.box(), 2.0))
    assert estimated == pytest.approx(len(resolution_grid(scenario.manifold(), *scenario.box(), 2.0)), rel=0.1)


def test_the_estimated_time_of_a_search_is_of_the_right_order():
    instance = near_field().draw(np.random.default_rng(0))
    Music(Grid(azimuth=4, range=4)).solve(instance, None)
    start = time.process_time()
    Music(Grid(azimuth=400, range=2000), interpolate=False).solve(instance, None)
    assert 0.1 < (time.process_time() - start) / search_s(800_000, 128, 3) < 10


def test_warnings_of_the_largest_array_take_little_time():
    vast = near_field(array=ULA | {"elements": 100_000}, snapshots=900)
    start = time.process_time()
    assert vast.warnings() and GridRefine().warnings(vast) and Music().warnings(vast)
    assert time.process_time() - start < 5


@pytest.mark.parametrize(("header", "hint"), [("x,y,z", True), ("x_cm,y_cm,z_cm", False)])
def test_millimetres_are_suspected_only_where_no_unit_is_stated(tmp_path, header, hint):
    path = tmp_path / "q.csv"
    path.write_text(f"{header}\n" + "\n".join(f"0,{5e4 * m},{5e4 * (m % 3)}" for m in range(9)))
    (text, *_) = warnings(array={"kind": "custom", "origin": "center", "file": str(path)})
    assert ("are these millimetres?" in text) == hint
    assert "check the frequency [Hz], --frequency-hz, and the speed [m/s], --speed" in text
