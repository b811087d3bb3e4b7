"""Swept tables, such as arrays, appear under labels or short descriptions, which do not change the runs."""

import json

import numpy as np
import pandas as pd
import pytest

import nfbench
from nfbench.core import ManifestError, OptionError
from nfbench.core.options import build
from nfbench.problems.near_field.scenario import NearField
from nfbench.results import Results

HEAD = """
name = "arrays"
scenes = 2
seed = 1
[scenario]
kind = "near-field"
wavelength_m = 0.02
sources = 1
snapshots = 10
snr_db = 20
azimuth_deg = [-60, 60]
range_m = [0.3, 1.0]
"""
TAIL = """
[[formulation]]
kind = "grid-refine"
"""
LINE = '{ kind = "custom", file = "line.csv", origin = "center" }'
GRID = '{ kind = "custom", file = "grid of 64.csv", origin = "center" }'
SMALL = '{ kind = "ula", elements = 8, spacing_wavelengths = 0.5, origin = "center" }'


@pytest.fixture
def folder(tmp_path):
    grid = [(0, 0.01 * y, 0.01 * z) for y in range(8) for z in range(8)]
    np.savetxt(tmp_path / "grid of 64.csv", grid, delimiter=",")
    np.savetxt(tmp_path / "line.csv", [(0, 0.01 * y, 0) for y in range(16)], delimiter=",")
    return tmp_path


def study(folder, *arrays, sweep=""):
    text = f'{HEAD}[sweep]\n"scenario.array" = [{", ".join(arrays)}]\n{sweep}{TAIL}'
    (folder / "study.toml").write_text(text)
    return nfbench.load_study(folder / "study.toml")


def labelled(array, label):
    return array.replace(" }", f', label = "{label}" }}')


def shown(loaded):
    return [point.swept["array"] for point in loaded.points]


def test_labels_stand_for_arrays(folder):
    assert shown(study(folder, labelled(LINE, "line"), labelled(GRID, "grid"), labelled(SMALL, "small"))) == [
        "line",
        "grid",
        "small",
    ]


def test_arrays_without_labels_are_described_in_a_few_words(folder):
    found = shown(study(folder, LINE, GRID, SMALL))
    assert found[:2] == ["custom (line.csv, 16 positions)", "custom (grid of 64.csv, 64 positions)"]
    assert found[2] == {"kind": "ula", "elements": 8, "spacing_wavelengths": 0.5, "origin": "center"}


def test_descriptions_differ_where_arrays_differ(folder):
    turned = LINE.replace(" }", ', broadside = "-x" }')
    inline = '{ kind = "custom", origin = "center", positions = [[0, 0, 0], [0, 0.01, 0], [0, 0.02, 0]] }'
    found = shown(study(folder, LINE, turned, inline, inline.replace("0.02", "0.03")))
    assert found[:2] == ["custom (line.csv, 16 positions)", "custom (line.csv, broadside = -x, 16 positions)"]
    assert found[2:] == ["custom (3 positions)", "custom (3 positions) no. 2"]


def test_labels_are_no_part_of_the_identity_of_runs(folder):
    plain = study(folder, LINE, GRID)
    with_labels = study(folder, labelled(LINE, "one"), labelled(GRID, "two"))
    assert [spec.run_id for spec in plain.specs()] == [spec.run_id for spec in with_labels.specs()]
    assert plain.scenarios == with_labels.scenarios
    assert plain.fingerprint != with_labels.fingerprint  # the same runs with other labels


def test_a_label_is_allowed_in_every_table_of_a_scenario(folder):
    array = {"kind": "ula", "elements": 8, "spacing_wavelengths": 0.5, "origin": "center"}
    options = {
        "wavelength_m": 0.02, "sources": 1, "snapshots": 10, "snr_db": 20.0, "azimuth_deg": [-60, 60],
        "range_m": [0.3, 1.0],
    }  # fmt: skip
    assert build(NearField, options | {"array": array | {"label": "x"}}) == build(NearField, options | {"array": array})
    with pytest.raises(OptionError, match=r"array.label: expected a string, got 5"):
        build(NearField, options | {"array": array | {"label": 5}})
    with pytest.raises(OptionError, match=r"array.labels: unknown option"):
        build(NearField, options | {"array": array | {"labels": "x"}})


@pytest.mark.parametrize(
    ("label", "complaint"),
    [
        ("line", r"sweep.array\[1\].label: 'line' is also the label of array\[0\]"),
        ("=1+1", r"sweep.array\[1\].label: expected a label that does not start with ="),
        ("12", r"sweep.array\[1\].label: expected a label with letters"),
    ],
)
def test_labels_are_distinct_and_survive_a_csv_file(folder, label, complaint):
    with pytest.raises(ManifestError, match=complaint):
        study(folder, labelled(LINE, "line"), labelled(GRID, label))


def test_tables_figures_and_files_use_the_names(folder):
    loaded = study(folder, labelled(LINE, "a line: λ/2"), GRID, sweep='"scenario.snr_db" = [10, 20]\n')
    nfbench.run(loaded, out=folder / "out", jobs=0)
    names = ["a line: λ/2", "custom (grid of 64.csv, 64 positions)"]
    runs = pd.read_csv(folder / "out" / "runs.csv")
    assert runs["scenario.array"].unique().tolist() == names
    assert Results(folder / "out").runs["scenario.array"].unique().tolist() == names
    assert pd.read_csv(folder / "out" / "summary.csv")["scenario.array"].unique().tolist() == names
    from nfbench.figures import Drawing, write_figures

    how = Drawing(only=("error", "positions"), manifest=folder / "study.toml")
    paths = write_figures(Results(folder / "out"), folder / "figures", ["svg"], how)
    stems = {path.stem for path in paths}
    assert any("a-line" in stem for stem in stems)
    assert any("custom-grid-of-64.csv-64-positions" in stem for stem in stems)
    assert all(len(path.name) < 200 for path in paths)
    assert not nfbench.run(study(folder, labelled(LINE, "a line: λ/2"), GRID, sweep='"scenario.snr_db" = [10, 20]\n'),
                           out=folder / "out", jobs=0).counts.get("open")  # fmt: skip


def test_short_tables_of_other_options_stand_for_themselves(folder):
    text = f'{HEAD}rician_k = 1.0\nfading = "block"\narray = {SMALL}\n[sweep]\n"scenario.nlos" = [\n'
    text += '{ kind = "iid" }, { kind = "clusters", clusters = 2 } ]\n'
    (folder / "study.toml").write_text(text + TAIL)
    found = [point.swept["nlos"] for point in nfbench.load_study(folder / "study.toml").points]
    assert found[0] == {"kind": "iid"}
    assert found[1]["kind"] == "clusters" and found[1]["clusters"] == 2
    assert None not in found[1].values()
    json.dumps(found)
