"""Measured data with known sources: the errors are the reference values of the data. Skipped without the data."""

import numpy as np
import pytest
from conftest import PROJECT

from nfbench.problems.near_field.arrays import Custom
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.recordings.points import read_points
from nfbench.problems.near_field.recordings.responses import MeasuredResponses
from nfbench.problems.near_field.recordings.scenario import Recorded

DATA = PROJECT / ".." / "shared" / "data"
MICROPHONES, LOUDSPEAKERS = DATA / "miracle", DATA / "rs-mnmf"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured data are not in {DATA}")


def microphones(name, frequency_hz=1000.0, **options):
    """The recording of two sources in an anechoic chamber, 64 microphones in the x-y plane."""
    positions = read_points(str(MICROPHONES / "positions_m.csv"))
    return Recorded(
        data=str(MICROPHONES / name),
        array=Custom(origin="center", positions=positions.tolist(), broadside="+z", up="+y"),
        frequency_hz=frequency_hz,
        speed_m_s=344.7,
        sources=2,
        azimuth_deg=(-60.0, 60.0),
        elevation_deg=(-60.0, 60.0),
        range_m=(0.4, 2.0),
        truth_file=str(MICROPHONES / "sources_m.csv"),
        **options,
    )


def scores(scenario, number=0):
    instance = scenario.draw_scene(np.random.default_rng(number), number)
    return instance.score(GridRefine().solve(instance, None).estimate)


def errors_mm(scenario):
    found = scores(scenario)
    return sorted([1e3 * found["error_1_m"], 1e3 * found["error_2_m"]])


def test_snapshots_at_1_khz():
    assert errors_mm(microphones("snapshots_1khz.npy")) == pytest.approx([5.5, 7.7], abs=0.1)


def test_the_covariance_gives_the_same_as_the_snapshots():
    found = errors_mm(microphones("covariance_1khz_welch.npy", data_kind="covariance", snapshots=124))
    assert found == pytest.approx([5.5, 7.7], abs=0.1)


@pytest.mark.parametrize(("khz", "expected"), [(4, [9.5, 10.7]), (6, [3.0, 8.4]), (8, [7.7, 9.2])])
def test_samples_over_time(khz, expected):
    time = {"data_kind": "samples", "sample_rate_hz": 32_000.0}
    assert errors_mm(microphones("time_data_32khz.npy", 1e3 * khz, **time)) == pytest.approx(expected, abs=0.1)


def test_the_other_phase_convention_fails():
    found = scores(microphones("snapshots_1khz.npy", conjugate=True))
    assert found["error_1_m"] > 1 and found["error_2_m"] > 1
    assert found["misfit"] > 0.8


def loudspeakers(frequency_hz, speed_m_s=340.0):
    """Three of nine loudspeaker positions in an office, in front of a line of 32 microphones."""
    positions = read_points(str(LOUDSPEAKERS / "positions_m.csv"))
    return MeasuredResponses(
        data=str(LOUDSPEAKERS / "impulse_responses_48khz.npz"),
        positions_file=str(LOUDSPEAKERS / "sources_m.csv"),
        array=Custom(origin="center", positions=positions.tolist(), broadside="+x", up="-y"),
        sample_rate_hz=48_000.0,
        gate_samples=200,
        frequency_hz=frequency_hz,
        speed_m_s=speed_m_s,
        sources=3,
        snapshots=200,
        snr_db=20.0,
        azimuth_deg=(-75.0, 75.0),
        range_m=(0.15, 3.0),
    )


def seen_from_the_array(rows):
    """Cartesian positions relative to the origin of ranges, from the azimuth, elevation and range in rows."""
    azimuth, elevation, r = rows[:, -3:].T
    across = r * np.cos(elevation)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), r * np.sin(elevation)])


@pytest.mark.parametrize("frequency_hz", [3000.0, 4000.0, 5000.0])
def test_loudspeakers_are_found_in_their_direction_and_too_near_by_4_to_12_cm(frequency_hz):
    scenario = loudspeakers(frequency_hz)
    along, across = [], []
    for number in range(0, 84, 4):
        instance = scenario.draw_scene(np.random.default_rng(number), number)
        estimate = GridRefine().solve(instance, None).estimate
        truth, found = map(seen_from_the_array, instance.positions(estimate))
        along += (np.linalg.norm(found, axis=1) - np.linalg.norm(truth, axis=1)).tolist()
        across += (np.cross(truth, found)[:, 2] / np.linalg.norm(truth, axis=1)).tolist()
        bias = instance.score(estimate)["range_bias_m"]
        assert bias == pytest.approx(np.mean(along[-3:]), rel=1e-9)
    assert -0.12 < np.mean(along) < -0.04
    assert abs(np.mean(across)) < 0.0025
