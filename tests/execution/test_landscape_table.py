"""The table of a study's landscapes has a row per problem, whatever the number of processes."""

import numpy as np
import pandas as pd
import pytest

import nfbench
from nfbench import NfbenchError
from nfbench.core import Formulation
from nfbench.execution import first_problem, landscape_table, write_landscape
from nfbench.plugins import Registry

NEAR_FIELD = """
name = "field"
scenes = 2
seed = 5
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 8, spacing_wavelengths = 0.5, origin = "center" }
wavelength_m = 0.02
sources = 1
snapshots = 10
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.1, 0.5]
[sweep]
sources = [1, 2]
[[formulation]]
kind = "nemo"
[[formulation]]
kind = "neef"
[[formulation]]
kind = "grid-refine"
[[solver]]
kind = "random-search"
[budget]
evaluations = 20
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "field.toml"
    path.write_text(NEAR_FIELD)
    return path


def test_one_row_per_formulation_point_and_scene_on_any_number_of_processes(study):
    said = []
    table = landscape_table(study, 12, warn=said.append)
    assert said == ["grid-refine minimizes no problem that a solver is given"]
    keys = table[["formulation", "scenario.sources", "scene"]].values.tolist()
    assert keys == [[f, k, s] for k in (1, 2) for f in ("nemo", "neef") for s in (0, 1)]
    assert table["dimension"].tolist() == [2, 2, 2, 2, 2, 2, 4, 4]
    assert (table["starts"] == 12).all() and table["global_share"].between(0, 1).all()
    one = table[table["scenario.sources"] == 1]
    # with one source ESF and RLS have nearly the same minima, and the same starts reach them
    assert one["global_share"].tolist()[:2] == pytest.approx(one["global_share"].tolist()[2:], abs=0.1)
    again = landscape_table(study, 12, jobs=2)
    pd.testing.assert_frame_equal(table, again)
    assert landscape_table(study, 12, scenes=1)["scene"].unique().tolist() == [0]


def test_the_table_is_that_of_the_manifest_in_a_results_folder(study, tmp_path):
    results = nfbench.run(nfbench.load_study(study), out=tmp_path / "out", jobs=0)
    path = write_landscape(results.folder / "manifest.toml", tmp_path / "new" / "landscape.csv", 6)
    other = write_landscape(study, tmp_path / "other.csv", 6)
    assert path.read_bytes() == other.read_bytes() and b"\r" not in path.read_bytes()


def test_a_study_that_minimizes_nothing_is_refused(study):
    text = NEAR_FIELD.replace('[[formulation]]\nkind = "nemo"\n', "").replace('[[formulation]]\nkind = "neef"\n', "")
    study.write_text(text.replace('[[solver]]\nkind = "random-search"\n', ""))
    with pytest.raises(NfbenchError, match="no formulation of the study minimizes a problem"):
        landscape_table(study, 4)


def test_plugin_files_that_a_manifest_names_are_not_imported(tmp_path):
    (tmp_path / "bad.py").write_text("raise SystemExit('imported')")
    path = tmp_path / "study.toml"
    path.write_text(NEAR_FIELD.replace("seed = 5", 'seed = 5\nplugins = ["bad.py"]'))
    assert len(landscape_table(path, 4, scenes=1)) == 4


def test_the_first_problem_is_caught_even_by_a_formulation_that_handles_exceptions():
    scenario = Registry().make("scenario", "functions", {"function": "sphere", "dimension": 3})
    instance = scenario.draw(np.random.default_rng(0))

    class Stubborn(Formulation):
        accepts = type(instance)

        def solve(self, instance, minimize):
            try:
                return minimize(instance.problem).x
            except Exception:
                return np.zeros(3)

    assert first_problem(Stubborn(), instance) is instance.problem
