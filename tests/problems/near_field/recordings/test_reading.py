"""How data are read: blocks that are long enough, and covariances, sounds and truths that are recognized."""

import re

import numpy as np
import pytest
from scipy.io import wavfile
from simulated import OPTIONS, POSITIONS, TRUTH, snapshots

import nfbench
from nfbench import OptionError
from nfbench.problems.near_field.recordings.blocks import block_problem, default_block, longest_delay
from nfbench.problems.near_field.recordings.scenario import Recorded

Y = snapshots()
RATE = 16_000
LINE = np.column_stack([np.zeros(32), np.linspace(-0.3, 0.3, 32), np.zeros(32)])
WHERE = {"azimuth_deg": (-60, 60), "range_m": (0.3, 3.0), "frequency_hz": 2500.0, "speed_m_s": 343.0}
PLACES = np.array([[1.0, 0.3, 0.0], [0.9, -0.4, 0.0]])


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A .wav file of 32 microphones on a line with two sources of white noise, 20 dB above that of a microphone."""
    rng, n, extra = np.random.default_rng(0), 32_000, 4000
    f = np.fft.rfftfreq(n + extra, 1 / RATE)
    x = 0.1 * rng.standard_normal((32, n))
    for place in PLACES:
        spectrum = np.fft.rfft(rng.standard_normal(n + extra))
        for m, distance in enumerate(np.linalg.norm(LINE - place, axis=1)):
            delayed = np.fft.irfft(spectrum * np.exp(-2j * np.pi * f * distance / 343), n + extra)
            x[m] += delayed[extra // 2 : extra // 2 + n]
    path = tmp_path_factory.mktemp("sound") / "sound.wav"
    wavfile.write(path, RATE, (x.T / 20).astype(np.float32))
    return path


@pytest.fixture
def recorded(tmp_path):
    def make(data=Y, **options):
        np.save(tmp_path / "data.npy", data)
        return Recorded(data=str(tmp_path / "data.npy"), **{**OPTIONS, **options})

    return make


def test_a_sound_file_needs_no_further_options(sound):
    found = nfbench.localize(sound, LINE, sources=2, **WHERE)
    assert found.warnings == ()
    assert "blocks of 1024 samples" in found.notes[1]  # 28 samples of delay · 32 = 896
    places = sorted((source["x_m"], source["y_m"]) for source in found.sources)
    np.testing.assert_allclose(places, sorted(PLACES[:, :2].tolist()), atol=0.02)


def test_short_blocks_are_blamed_for_more_eigenvalues_and_not_the_number_of_sources(sound):
    (text,) = nfbench.localize(sound, LINE, sources=2, block=256, **WHERE).warnings
    assert re.match("4 eigenvalues rise above white noise, but 2 sources are searched: blocks of 256 samples", text)
    assert "28 samples" in text and "(--block 1024)" in text and "try sources" not in text


@pytest.mark.parametrize(
    ("delay", "samples", "snapshots", "expected"),
    [(0.0, 10**6, 32, 256), (8.0, 10**6, 32, 256), (8.1, 10**6, 32, 512), (28, 10**6, 32, 1024), (28, 4000, 32, 256)],
)
def test_the_default_block_is_the_shortest_power_of_two_that_is_long_enough(delay, samples, snapshots, expected):
    assert default_block(delay, samples, 0.5, snapshots) == expected
    problem = block_problem(expected, delay, samples)
    assert (problem is not None and problem[1]) == (samples == 4000)


def test_the_longest_delay_is_that_between_the_ends():
    assert longest_delay(LINE, 343.0, RATE) == pytest.approx(0.6 / 343 * RATE, rel=1e-12)
    many = np.random.default_rng(0).random((2500, 3))
    assert longest_delay(many, 1.0, 1.0) == pytest.approx(np.sqrt(3), rel=0.02)


def test_a_covariance_is_not_taken_for_snapshots(recorded):
    R = Y @ Y.conj().T / 60
    with pytest.raises(OptionError, match=r'probably a covariance: set data_kind = "covariance" \(--covariance\)'):
        recorded(R)
    with pytest.raises(OptionError, match="probably a covariance"):
        recorded(R.astype(np.complex64))
    recorded(Y[:, :16])  # square, but not Hermitian
    with pytest.raises(OptionError, match=r"expected a square covariance.*leave out .*\(--covariance\)"):
        recorded(data_kind="covariance")


def test_exchanged_axes_of_square_data_are_noted_and_found(recorded, tmp_path):
    np.save(tmp_path / "square.npy", Y[:, :16].T)
    options = {**OPTIONS, "array": {**_table()}}
    found = nfbench.localize(tmp_path / "square.npy", options.pop("array"), **options)
    assert "element_axis = 1 (--element-axis 1) takes the other" in found.notes[0]
    assert found.warnings[0].startswith("the data are probably transposed")
    right = nfbench.localize(tmp_path / "square.npy", _table(), element_axis=1, failed=[3], **options)
    assert not any("transposed" in text for text in right.warnings)
    places = np.array(sorted([source["x_m"], source["y_m"], source["z_m"]] for source in right.sources))
    np.testing.assert_allclose(places, TRUTH[np.argsort(TRUTH[:, 0])], atol=1e-3)
    wrong = nfbench.localize(tmp_path / "square.npy", _table(), failed=[3], **options)
    assert wrong.warnings[0].startswith("the data are probably transposed")


def test_no_snapshots_and_complex_samples_are_called_what_they_are(recorded):
    with pytest.raises(OptionError, match=r"data: expected at least one snapshot, got none: shape \(16, 0\)"):
        recorded(Y[:, :0])
    with pytest.raises(OptionError, match=r"the data are complex, as snapshots .* leave out sample_rate_hz"):
        recorded(data_kind="samples", sample_rate_hz=16e3)
    with pytest.raises(OptionError, match=r"give data_kind = \"samples\" and sample_rate_hz \(--sample-rate-hz\)"):
        recorded(Y.real)
    notes = recorded(np.tile(Y, 10), data_kind="samples", sample_rate_hz=16e3).draw(np.random.default_rng(0)).notes
    assert "leave out sample_rate_hz" in notes[1]


def test_a_partial_truth_is_warned_of(recorded):
    (text,) = recorded(truth_m=TRUTH[:1].tolist()).warnings()
    assert "truth_m: expected the positions of all 2 sources, got 1" in text and "may be too small" in text
    assert recorded(truth_m=TRUTH.tolist()).warnings() == []


@pytest.mark.parametrize(("factor", "unit"), [(1000, "mm"), (100, "cm")])
def test_a_truth_in_another_unit_is_refused(factor, unit, recorded, tmp_path):
    with pytest.raises(OptionError, match=f"truth_m: .* name its columns .*x_{unit}, y_{unit}, z_{unit}"):
        recorded(truth_m=(TRUTH * factor).tolist())
    path = tmp_path / "truth.csv"
    for header in ("", f"x_{unit},y_{unit},z_{unit}\n"):
        path.write_text(header + "\n".join(",".join(map(str, row)) for row in (TRUTH * factor).tolist()))
        if header:
            np.testing.assert_allclose(recorded(truth_file=str(path)).truth_m, TRUTH, rtol=1e-12)
        else:
            with pytest.raises(OptionError, match=r"got one .* m away: are these"):
                recorded(truth_file=str(path))
    assert any("outside the box" in text for text in recorded(truth_m=(TRUTH * 10).tolist()).warnings())


def _table():
    return {"kind": "custom", "origin": "center", "positions": POSITIONS.tolist(), "broadside": "+z", "up": "+y"}
