"""Guards recordings of several frequencies: wideband samples over time, simulated by delays, and measured ones."""

import numpy as np
import pytest
from conftest import PROJECT
from numpy.testing import assert_allclose

from nfbench import OptionError
from nfbench.core.options import build
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.recordings.scenario import Recorded

RATE, SPEED = 16_000.0, 343.0
ELEMENTS = np.stack([np.zeros(12), np.linspace(-0.6, 0.6, 12), np.zeros(12)], axis=1)
TRUTH = np.array([[1.5, 0.3, 0.0], [1.2, -0.7, 0.0]])
MICROPHONES = PROJECT / ".." / "shared" / "data" / "MICS"


@pytest.fixture
def recorded(tmp_path):
    """Return a function that makes the scenario: 0.5 s of two sources of white noise, 12 dB above the noise."""
    rng = np.random.default_rng(3)
    emitted = np.fft.rfft(rng.normal(size=(2, 8000)))
    delays = np.linalg.norm(TRUTH - ELEMENTS[:, None], axis=-1) / SPEED  # (elements, sources) [s]
    f = np.fft.rfftfreq(8000, 1 / RATE)
    received = np.einsum("mkf,kf->mf", np.exp(-2j * np.pi * f * delays[..., None]), emitted)
    np.save(tmp_path / "data.npy", np.fft.irfft(received) + 0.25 * rng.normal(size=(12, 8000)))

    def make(**options):
        table = {
            "data": str(tmp_path / "data.npy"),
            "data_kind": "samples",
            "sample_rate_hz": RATE,
            "block": 512,
            "array": {"kind": "custom", "positions": ELEMENTS.tolist(), "origin": "center"},
            "frequency_hz": 1000.0,
            "speed_m_s": SPEED,
            "sources": 2,
            "azimuth_deg": [-60, 60],
            "range_m": [0.5, 4.0],
            "truth_m": TRUTH.tolist(),
        }
        return build(Recorded, table | options)

    return make


def localized(scenario):
    instance = scenario.draw(np.random.default_rng(0))
    return instance, GridRefine(objective="wsf").solve(instance, None).estimate


def test_each_frequency_is_a_bin_with_its_wavelength(recorded):
    scenario = recorded(further_frequencies_hz=[1500.0, 2000.0])
    instance = scenario.draw(np.random.default_rng(0))
    assert scenario.bins == len(instance.bands) == 3
    assert [band.manifold.wavelength_m for band in instance.bands] == [SPEED / f for f in (1000, 1500, 2000)]
    alone = recorded(frequency_hz=1500.0).draw(np.random.default_rng(0))
    assert_allclose(instance.bands[1].Y, alone.Y, rtol=1e-12)
    assert_allclose(instance.bands[1].manifold.positions, alone.manifold.positions, rtol=1e-12)


def test_all_frequencies_together_are_more_accurate_than_one(recorded):
    further = [1250.0, 1500.0, 1750.0, 2000.0, 2250.0, 2500.0]
    alone, together = (localized(recorded(further_frequencies_hz=each)) for each in ([], further))
    errors = [instance.score(estimate)["rmse_m"] for instance, estimate in (alone, together)]
    assert errors[1] < errors[0] / 2 and errors[1] < 0.03
    instance, estimate = together
    explained = [np.linalg.norm(band.Y) ** 2 for band in instance.bands]
    rest = [
        np.linalg.norm(band.Y - A @ np.linalg.lstsq(A, band.Y)[0]) ** 2
        for band in instance.bands
        for A in [band.manifold.response(estimate).T]
    ]
    scores = instance.score(estimate)
    assert_allclose(scores["misfit"], sum(rest) / sum(explained), rtol=1e-9)
    assert scores["misfit_limit"] < scores["misfit"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"further_frequencies_hz": [1000.0]}, "further_frequencies_hz: expected different frequencies"),
        ({"further_frequencies_hz": [9000.0]}, "further_frequencies_hz: expected a value"),
        ({"further_frequencies_hz": [-1.0]}, "further_frequencies_hz"),
    ],
)
def test_wrong_frequencies_are_refused_by_name(options, message, recorded):
    with pytest.raises(OptionError, match=message):
        recorded(**options)
