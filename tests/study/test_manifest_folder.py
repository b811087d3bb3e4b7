"""Relative paths in the copy of a manifest in a results folder keep their meaning, whatever else is in that folder."""

import json

import nfbench
from nfbench.study import load_scenarios

MANIFEST = """
name = "own-array"
scenes = 2
seed = 1
[scenario]
kind = "near-field"
array = { kind = "custom", file = "positions.csv", origin = "first" }
wavelength_m = 0.02
sources = 1
snapshots = 20
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.05, 0.4]
[[formulation]]
kind = "neef"
[[solver]]
kind = "random-search"
[budget]
evaluations = 20
"""


def test_the_copy_in_a_results_folder_reads_the_files_of_the_study(tmp_path):
    study = tmp_path / "studies" / "own.toml"
    study.parent.mkdir()
    study.write_text(MANIFEST)
    rows = [[0.0, 0.005 * m, 0.0] for m in range(8)]
    (study.parent / "positions.csv").write_text("\n".join(",".join(map(str, row)) for row in rows))
    folder = tmp_path / "results" / "own"
    nfbench.run(nfbench.load_study(study), out=folder, jobs=1)
    assert (folder / "positions.csv").read_text().startswith("run_id")  # not the positions of elements
    assert json.loads((folder / "environment.json").read_text())["manifest_folder"] == "../../studies"
    [(_, scenario)] = load_scenarios(folder / "manifest.toml")
    assert [list(row) for row in scenario.array.positions] == rows
    again = nfbench.run(nfbench.load_study(folder / "manifest.toml"), out=tmp_path / "again", jobs=1)
    assert again.runs["rmse_m"].tolist() == nfbench.Results(folder).runs["rmse_m"].tolist()


def test_a_damaged_environment_does_not_matter(tmp_path):
    path = tmp_path / "manifest.toml"
    path.write_text(MANIFEST)
    (tmp_path / "positions.csv").write_text("0,0,0\n0,0.01,0\n0,0.02,0\n")
    for text in ("", "[]", "{", '{"manifest_folder": 3}', '{"manifest_folder": "../not-there"}', "[" * 100_000):
        (tmp_path / "environment.json").write_text(text)
        assert load_scenarios(path)[0][1].array.count == 3
