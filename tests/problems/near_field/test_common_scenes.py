"""Two arrays that a study compares receive the same scenes: the same sources, symbols and noise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import nfbench
from nfbench.problems.near_field.scenario import NearField
from nfbench.study import load_scenarios

MANIFEST = """
name = "arrays"
scenes = 3
seed = 7
[scenario]
kind = "near-field"
array = {{ kind = "ula", elements = 128, spacing_wavelengths = 0.25, origin = "{origin}" }}
wavelength_m = 0.02
wavefront = "paper"
sources = 3
snapshots = 20
snr_db = 10.0
azimuth_deg = [-60, 60]
range_m = [1.27, 20.16]
min_separation_deg = 2.0
[sweep]
"array.elements" = [64, 128]
[[method]]
formulation = "grid-refine"
"""


@pytest.mark.parametrize("origin", ["first", "center"])
def test_arrays_of_64_and_128_elements_see_the_same_scenes_in_a_sweep(tmp_path, origin):
    path = tmp_path / "arrays.toml"
    path.write_text(MANIFEST.format(origin=origin), encoding="utf-8")
    specs = list(nfbench.load_study(path).specs())
    seeds = {
        elements: [spec.instance_seed for spec in specs if spec.point.swept["array.elements"] == elements]
        for elements in (64, 128)
    }
    assert seeds[64] == seeds[128]
    assert len(set(seeds[64])) == 3  # scenes

    scenarios = {swept["array.elements"]: scenario for swept, scenario in load_scenarios(path)}
    for seed in seeds[64]:
        small, large = (_draw(scenarios[elements], seed) for elements in (64, 128))
        assert (len(small.Y), len(large.Y)) == (64, 128)
        assert_array_equal(small.theta, large.theta)
        assert_array_equal(small.symbols, large.symbols)
        assert_allclose(_noise(small), _noise(large)[:64], rtol=0, atol=1e-12)
        assert np.abs(_noise(small)).std() > 0.3  # of unit variance
        if origin == "first":  # the first 64 elements are at the same places
            assert_allclose(small.Y, large.Y[:64], rtol=0, atol=1e-12)


def _draw(scenario: NearField, seed: int):
    return scenario.draw(np.random.default_rng(seed))


def _noise(instance) -> np.ndarray:
    """The received data without the sources, (M, T)."""
    return instance.Y - instance.H[0] @ instance.symbols
