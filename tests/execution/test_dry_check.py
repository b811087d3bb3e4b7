"""Tests that a formulation that can solve no scene of a study is found before the study runs, and no other."""

import pytest

from nfbench import NfbenchError, load_study
from nfbench.execution import dead_formulations, refuse_dead

ARRAY = """
name = "dead"
scenes = 2
seed = 1
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 17, spacing_wavelengths = SPACING, origin = "center" }
wavelength_m = 0.1
sources = 2
snapshots = 20
snr_db = 15.0
azimuth_deg = [-50, 50]
range_m = [1.0, 4.0]
[sweep]
SWEEP
[[formulation]]
kind = "neef"
[[formulation]]
kind = "modified-music"
grid = { azimuth = 8, range = 8 }
[[solver]]
kind = "de"
[budget]
evaluations = 100
"""


def study(tmp_path, spacing, sweep="snr_db = [0, 10]"):
    path = tmp_path / "dead.toml"
    path.write_text(ARRAY.replace("SPACING", str(spacing)).replace("SWEEP", sweep), encoding="utf-8")
    return load_study(path)


def test_a_formulation_that_declines_every_scene_is_refused_with_its_reason(tmp_path):
    found = dead_formulations(study(tmp_path, 0.5))
    assert list(found) == ["modified-music"]
    assert "expected a spacing below" in found["modified-music"] and "got 0.5 λ" in found["modified-music"]
    with pytest.raises(NfbenchError, match=r"nothing was run.*modified-music: array: .*--keep-skipped"):
        refuse_dead(study(tmp_path, 0.5))


def test_a_formulation_that_works_at_one_swept_point_is_kept(tmp_path):
    assert dead_formulations(study(tmp_path, 0.25)) == {}
    refuse_dead(study(tmp_path, 0.25))
    assert (
        dead_formulations(
            study(tmp_path, 0.5, "spacing = [0.5, 0.25]".replace("spacing", '"array.spacing_wavelengths"'))
        )
        == {}
    )
