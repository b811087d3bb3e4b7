"""A recording of two sources is localized to millimetres from any kind of data; wrong descriptions are refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated import ARRAY, FREQUENCY, OPTIONS, POSITIONS, SPEED, TRUTH, WAVELENGTH, manifold, snapshots

from nfbench import OptionError
from nfbench.core import canonical
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.recordings.measurement import (
    covariance_factor,
    normalized,
    spectral_snapshots,
)
from nfbench.problems.near_field.recordings.scenario import Recorded
from nfbench.testing import check_scenario

Y = snapshots()


@pytest.fixture
def recorded(tmp_path):
    """A function that writes an array to a file and returns the scenario of this recording."""

    def make(data=Y, name="data.npy", **options):
        np.save(tmp_path / name, data)
        return Recorded(data=str(tmp_path / name), **{**OPTIONS, **options})

    return make


def draw(scenario, number=0):
    return scenario.draw_scene(np.random.default_rng(0), number)


def localized(scenario):
    """The estimates in the coordinates of the positions, in the order of their x [m]."""
    instance = draw(scenario)
    found = scenario.frame.outward(cartesian(GridRefine().solve(instance, None).estimate))
    return found[np.argsort(-found[:, 0])]


def samples(rate=16_000.0, seconds=0.5):
    """Two tones near the frequency over time, whose phases at each element follow from the distances."""
    t = np.arange(round(rate * seconds)) / rate
    x = np.random.default_rng(1).standard_normal((len(t), 16)) * 1e-4
    for source, offset in zip(TRUTH, (-6.0, 6.0), strict=True):
        delays = np.linalg.norm(POSITIONS - source, axis=1) / SPEED
        x += np.cos(2 * math.pi * (FREQUENCY + offset) * (t[:, None] - delays))
    return x


@pytest.mark.parametrize(
    ("data", "options", "within"),
    [
        (Y, {}, 1e-3),
        (Y.T, {}, 1e-3),
        (Y.conj(), {"conjugate": True}, 1e-3),
        (Y @ Y.conj().T / 60, {"data_kind": "covariance", "snapshots": 60}, 1e-3),
        (Y @ Y.conj().T / 60, {"data_kind": "covariance"}, 1e-3),
        (samples(), {"data_kind": "samples", "sample_rate_hz": 16_000.0, "block": 512}, 5e-3),
        (samples().T, {"data_kind": "samples", "sample_rate_hz": 16_000.0, "block": 512}, 5e-3),
    ],
)
def test_the_sources_are_found_where_they_are(data, options, within, recorded):
    np.testing.assert_allclose(localized(recorded(data, **options)), TRUTH, atol=within)


def test_data_with_the_other_phase_convention_explain_little(recorded):
    right, wrong = (draw(recorded(data)) for data in (Y, Y.conj()))
    shares = [each.score(GridRefine().solve(each, None).estimate)["misfit"] for each in (right, wrong)]
    assert shares[0] < 1e-5
    assert shares[1] > 0.1


def test_elements_that_failed_are_left_out(recorded):
    broken = Y.copy()
    broken[[3, 9]] = 1e3 * np.random.default_rng(2).standard_normal((2, 60))
    scenario = recorded(broken, failed=(3, 9))
    np.testing.assert_allclose(localized(scenario), TRUTH, atol=1e-3)
    assert scenario.manifold().elements == 14
    np.testing.assert_array_equal(scenario.manifold().positions, np.delete(manifold().positions, [3, 9], axis=0))
    assert np.abs(localized(recorded(broken)) - TRUTH).max() > 0.1


def test_misfit_and_its_limit_are_those_of_projections(recorded):
    scenario = recorded(truth_m=TRUTH.tolist())
    instance = draw(scenario)
    estimate = np.array([[0.1, -0.1, 0.9], [-0.3, 0.2, 0.7], [0.0, 0.0, 1.5]])
    A = manifold().response(estimate).T
    residual = Y - A @ np.linalg.lstsq(A, Y, rcond=None)[0]
    energies = np.linalg.svd(Y, compute_uv=False) ** 2
    scores = instance.score(estimate)
    assert scores["misfit"] == pytest.approx(np.linalg.norm(residual) ** 2 / np.linalg.norm(Y) ** 2, rel=1e-10)
    assert scores["misfit_limit"] == pytest.approx(energies[3:].sum() / energies.sum(), rel=1e-9)
    assert scores["sources_found"] == 3
    assert instance.score(np.vstack([estimate[:1]] * 2))["misfit"] == pytest.approx(
        instance.score(estimate[:1])["misfit"], rel=1e-9
    )
    assert instance.score(np.empty((0, 3)))["misfit"] == 1.0
    assert math.isnan(instance.score(np.full((1, 3), np.nan))["misfit"])
    with pytest.raises(ValueError, match=r"estimate: expected shape \(K, 3\)"):
        instance.score(np.zeros((2, 2)))


def test_the_truth_is_the_position_in_the_coordinates_of_the_array(recorded, tmp_path):
    path = tmp_path / "truth.csv"
    path.write_text("x_m,y_m,z_m\n" + "\n".join(",".join(map(str, row)) for row in TRUTH.tolist()))
    given, read = recorded(truth_m=TRUTH.tolist()), recorded(truth_file=str(path))
    assert given == read
    theta = draw(read).truth()
    np.testing.assert_allclose(read.frame.outward(cartesian(theta)), TRUTH, atol=1e-12)
    r = np.linalg.norm(TRUTH - POSITIONS.mean(axis=0), axis=1)
    np.testing.assert_allclose(theta[:, 2], r, rtol=1e-12)
    moved = theta + np.array([0.0, 0.0, 0.05])
    scores = draw(read).score(moved)
    assert scores["rmse_m"] == pytest.approx(0.05, rel=1e-9)
    assert scores["range_bias_m"] == pytest.approx(0.05, rel=1e-9)
    assert scores["cross_range_m"] == pytest.approx(0.0, abs=1e-9)


def test_methods_are_ranked_by_the_misfit_where_the_truth_is_not_known(recorded):
    without, known = recorded(), recorded(truth_m=TRUTH.tolist())
    assert (without.ranked_by(), known.ranked_by()) == ("misfit", "rmse_m")
    scores = draw(without).score(np.array([[0.0, 0.0, 1.0]]))
    assert set(scores) == {"misfit", "misfit_limit", "sources_found"}
    assert draw(without).truth() is None
    truth, found = draw(without).positions(np.array([[0.0, 0.0, 1.0]]))  # all estimates are without a source
    assert truth.shape == (0, 6)
    np.testing.assert_allclose(found[:, :3], without.frame.outward(np.array([[1.0, 0.0, 0.0]])), atol=1e-15)
    np.testing.assert_allclose(found[:, 3:], [[0.0, 0.0, 1.0]], atol=1e-15)


def test_the_scenario_passes_the_checks_of_scenarios(recorded):
    formulations = [GridRefine()]
    check_scenario(recorded(), formulations)
    check_scenario(recorded(truth_m=TRUTH.tolist()), formulations)


def test_segments_are_the_parts_of_the_recording_in_their_order(recorded):
    scenario = recorded(segments=4)
    parts = [draw(scenario, number).Y for number in range(5)]
    for s in range(4):
        piece, _ = normalized(Y[:, 15 * s : 15 * (s + 1)], 2)
        np.testing.assert_array_equal(parts[s], piece)
    np.testing.assert_array_equal(parts[4], parts[0])


def test_what_the_sources_do_not_explain_has_unit_variance(recorded):
    eigenvalues = np.linalg.eigvalsh(draw(recorded()).Y @ draw(recorded()).Y.conj().T / 60)
    assert eigenvalues[:-2].mean() == pytest.approx(1.0, rel=1e-9)


def test_known_gains_and_noise_are_those_of_the_elements_that_are_used(recorded, tmp_path):
    gains = np.exp(1j * np.arange(16)) * np.linspace(0.5, 2, 16)
    powers = np.linspace(1.0, 2.0, 16) * 1e-4
    np.save(tmp_path / "gains.npy", gains)
    np.save(tmp_path / "noise.npy", powers)
    files = {"gains_file": str(tmp_path / "gains.npy"), "noise_file": str(tmp_path / "noise.npy")}
    instance = draw(recorded(failed=(0,), **files))
    np.testing.assert_array_equal(instance.gains, gains[1:])
    _, deviation = normalized(Y[1:], 2)
    np.testing.assert_allclose(instance.noise_covariance, np.diag(powers[1:]) / deviation**2, rtol=1e-12)
    np.save(tmp_path / "noise.npy", np.diag(powers) - 1e-3)
    with pytest.raises(OptionError, match=r"noise_file: expected a Hermitian, positive definite"):
        recorded(**files)
    np.save(tmp_path / "gains.npy", gains[:5])
    with pytest.raises(OptionError, match=r"gains_file: expected 16 gains other than 0, got 5"):
        recorded(**files)


def test_the_identity_is_the_content_of_the_file_and_not_its_place(recorded, tmp_path):
    first, copy = recorded(name="a.npy"), recorded(name="b.npy")
    assert canonical(first, defaults=False) == canonical(copy, defaults=False)
    assert canonical(first) != canonical(copy)
    other = recorded(Y * 1.01, name="a.npy")
    assert canonical(other, defaults=False) != canonical(copy, defaults=False)
    with pytest.raises(OptionError, match=r"sha256: expected the content .* got another one of data"):
        replace(copy, data=other.data)


@pytest.mark.parametrize(
    ("data", "options", "text"),
    [
        (Y[:15], {}, r"data: expected 16 entries along one axis, .* got an array of shape \(15, 60\)"),
        (Y, {"element_axis": 1}, "data: expected 16 entries along axis 1"),
        (Y[0], {}, "data: expected a table with an axis of 16 elements"),
        (Y.real, {}, 'data: expected complex snapshots, got real numbers.* data_kind = "samples"'),
        (Y.real + 0j, {}, "got real numbers, which have no phase"),
        (Y * 0, {}, "got zeros only"),
        (samples() * 0, {"data_kind": "samples", "sample_rate_hz": 16e3}, "data: expected data other than 0"),
        (Y @ Y.T, {"data_kind": "covariance"}, "data: expected a Hermitian covariance"),
        (-(Y @ Y.conj().T), {"data_kind": "covariance"}, "data: expected a positive semidefinite covariance"),
        (Y[:, :16] + 1j, {"data_kind": "covariance"}, "data: expected a Hermitian covariance"),
        (Y, {"data_kind": "covariance"}, r"data: expected a square covariance, got an array of shape \(16, 60\)"),
        (
            Y @ Y.conj().T,
            {"data_kind": "covariance", "snapshots": 7},
            "data: expected at least 16 snapshots, the rank of the covariance, got snapshots = 7",
        ),
        (samples(), {"data_kind": "samples"}, "sample_rate_hz: is required for samples over time"),
        (
            samples(),
            {"data_kind": "samples", "sample_rate_hz": 3300.0},
            "frequency_hz: expected a value from .* to 1637.11 Hz for blocks of 256 samples, got 1700",
        ),
        (samples(), {"data_kind": "samples", "sample_rate_hz": 16e3, "block": 2**14}, "block: expected at least one"),
        (samples(), {"data_kind": "samples", "sample_rate_hz": 16e3, "window": "hannn"}, "window: expected the name"),
        (Y, {"block": 128}, 'block: has an effect only with data_kind = "samples", got "snapshots"'),
        (Y, {"snapshots": 5}, 'snapshots: has an effect only with data_kind = "covariance"'),
        (Y, {"segments": 61}, "segments: expected at most 60, the number of snapshots, got 61"),
        (Y, {"failed": (16,)}, r"failed\[0\]: expected the number of an element, 0 to 15, got 16"),
        (Y, {"failed": ("mic",)}, r"failed\[0\]: expected a number or the name of an element, got 'mic'"),
        (Y, {"sources": 16}, "sources: expected fewer than the 16 elements that are used, got 16"),
        (Y, {"failed": tuple(range(14))}, "sources: expected fewer than the 2 elements that are used, got 2"),
        (Y, {"range_m": (2.0, 1.0)}, r"range_m: expected \[low, high\] with low < high"),
        (Y, {"elevation_deg": None, "truth_m": TRUTH.tolist()}, "truth_m: expected sources at elevation 0"),
        (Y, {"variable": "h"}, "data: data.npy: variable: a file of this format holds one array"),
    ],
)
def test_a_wrong_description_is_refused(data, options, text, recorded):
    with pytest.raises(OptionError, match=text):
        recorded(data, **options)


def test_every_missing_file_is_reported_with_where_it_can_be_obtained(tmp_path):
    options = {**OPTIONS, "array": {"kind": "custom", "origin": "center", "file": str(tmp_path / "p.npy")}}
    with pytest.raises(OptionError) as caught:
        Recorded(data=str(tmp_path / "d.npy"), available_from="https://example.org/data", **options)
    assert [path for path, _ in caught.value.problems] == ["array.file", "data", "available_from"]
    assert "missing files are available from https://example.org/data" in str(caught.value)
    assert "NFBENCH_DATA" in str(caught.value)


def test_files_are_looked_for_in_the_folder_of_the_environment(recorded, tmp_path, monkeypatch):
    scenario = recorded()
    monkeypatch.chdir("/")
    with pytest.raises(OptionError, match=r"no such file: data\.npy"):
        replace(scenario, data="data.npy")
    monkeypatch.setenv("NFBENCH_DATA", str(tmp_path))
    assert replace(scenario, data="data.npy") == scenario


def test_dead_channels_and_sources_outside_the_box_are_warned_of(recorded):
    weak = Y.copy()
    weak[5] *= 1e-3
    (text,) = recorded(weak).warnings()
    assert text.startswith("data: element 5 (counted from 0) is at least 40 dB weaker than the median of all; ")
    weak[2] = 0.0
    weak[7] = np.abs(Y).mean() * np.exp(2j * np.pi * np.random.default_rng(0).random(Y.shape[1]))
    (text,) = recorded(weak).warnings()
    assert text.startswith("data: element 2 (counted from 0) receives nothing, and element 5 (counted from 0) is")
    assert "and element 7 (counted from 0) hardly receives what the others receive" in text
    assert text.endswith("leave them out with failed = [2, 5, 7] (--failed 2,5,7)")
    (text,) = recorded(truth_m=TRUTH.tolist(), range_m=(0.3, 0.53)).warnings()
    assert text.startswith("truth_m: true sources 0 (counted from 0) are outside the box")
    assert recorded(truth_m=TRUTH.tolist()).warnings() == []


@pytest.mark.parametrize("window", ["hann", "boxcar", "blackman"])
@pytest.mark.parametrize("k", [1, 9, 63])
def test_a_snapshot_is_a_bin_of_the_fourier_transform_of_a_windowed_block(window, k):
    from scipy.signal import get_window

    x = np.random.default_rng(4).standard_normal((3, 500))
    found = spectral_snapshots(x, 1000.0, k * 1000 / 128, 128, window, 0.75)
    starts = range(0, 500 - 128 + 1, 32)
    expected = [np.fft.fft(x[:, s : s + 128] * get_window(window, 128), axis=1)[:, k] for s in starts]
    np.testing.assert_allclose(found, np.transpose(expected), atol=1e-10)


@pytest.mark.parametrize(("rank", "snapshots"), [(4, 4), (2, 3), (4, 50)])
def test_the_factor_of_a_covariance_gives_it_back(rank, snapshots):
    rng = np.random.default_rng(6)
    B = rng.standard_normal((4, rank)) + 1j * rng.standard_normal((4, rank))
    R = B @ B.conj().T
    F = covariance_factor(R, snapshots)
    assert F.shape == (4, snapshots)
    np.testing.assert_allclose(F @ F.conj().T / snapshots, R, atol=1e-12)


def test_the_description_says_how_the_data_were_read(recorded):
    assert draw(recorded(Y.T)).notes == ("axis 1 of the data, 16 long, is that of the elements",)
    notes = draw(recorded(samples(), data_kind="samples", sample_rate_hz=16e3, block=512)).notes
    assert notes[1] == "30 snapshots at 1700 Hz from blocks of 512 samples: bin 54.4 of 31.25 Hz"
    assert ARRAY.count == 16 and WAVELENGTH == 0.2
