"""Studies of recordings run from manifest to figures, also without the truth; their scenes follow their numbers."""

import re
import shutil

import numpy as np
import pandas as pd
import pytest
from conftest import PROJECT
from simulated import POSITIONS, TRUTH, responses, snapshots

import nfbench
from nfbench import ManifestError, NfbenchError
from nfbench.figures import write_figures
from nfbench.results import export_csv
from nfbench.study import scene_numbers
from nfbench.tuning import Plan, tune

MANIFEST = """
name = "recorded"
scenes = 4
seed = 3
[scenario]
kind = "recorded"
data = "data.npy"
segments = 4
array = { kind = "custom", file = "microphones.csv", origin = "center", broadside = "+z", up = "+y" }
frequency_hz = 1700.0
speed_m_s = 340.0
sources = 2
azimuth_deg = [-50, 50]
elevation_deg = [-50, 50]
range_m = [0.3, 2.0]
TRUTH
[targets]
error = [0.02]
[[formulation]]
kind = "grid-refine"
[[formulation]]
kind = "neef"
[[solver]]
kind = "de"
[budget]
evaluations = 200
"""
RESPONSES = (
    MANIFEST.replace('kind = "recorded"', 'kind = "measured-responses"\npositions_file = "truth.csv"\nsnapshots = 20')
    .replace("segments = 4", "snr_db = 20.0")
    .replace('name = "recorded"', 'name = "responses"')
    .replace("scenes = 4", "scenes = 3")
    .replace("sources = 2", "sources = 1")
)


@pytest.fixture
def folder(tmp_path):
    np.save(tmp_path / "data.npy", snapshots(count=80, noise=0.1))
    np.savetxt(tmp_path / "microphones.csv", POSITIONS, delimiter=",", header="x_m,y_m,z_m", comments="")
    np.savetxt(tmp_path / "truth.csv", TRUTH, delimiter=",", header="x_m,y_m,z_m", comments="")
    return tmp_path


def study_of(folder, text, truth='truth_file = "truth.csv"'):
    path = folder / "study.toml"
    path.write_text(text.replace("TRUTH", truth))
    return nfbench.load_study(path)


def test_a_study_without_truth_is_ranked_by_the_misfit(folder):
    study = study_of(folder, MANIFEST, "")
    assert study.error == "misfit"
    results = nfbench.run(study, out=folder / "out", jobs=0)
    assert set(results.counts) == {"ok"}
    runs = results.runs
    assert "error_1_m" not in runs and runs["rmse_m"].isna().all()
    refined, searched = (runs[runs["formulation"] == name].set_index("scene") for name in ("grid-refine", "neef"))
    assert (refined["misfit"] < searched["misfit"]).all()
    assert (runs["misfit"] >= runs["misfit_limit"]).all()
    export_csv(results)
    summary = pd.read_csv(folder / "out" / "summary.csv").set_index("method")
    expected = refined["misfit"].median()
    assert summary.loc["grid-refine", "misfit_median"] == pytest.approx(expected, rel=1e-9)
    ranking = pd.read_csv(folder / "out" / "ranking.csv").set_index("method")
    assert ranking.loc["grid-refine", "mean_rank"] < ranking.loc["neef + de", "mean_rank"]
    drawn = [path.name for path in write_figures(results, folder / "figures")]
    assert "error.svg" in drawn and not any("positions" in name for name in drawn)


def test_scene_s_of_a_study_is_part_s_of_the_recording(folder):
    results = nfbench.run(study_of(folder, MANIFEST), out=folder / "out", jobs=0)
    runs = results.runs.query("formulation == 'grid-refine'").set_index("scene")
    Y = np.load(folder / "data.npy")
    for scene in range(4):
        part = folder / f"part{scene}.npy"
        np.save(part, Y[:, 20 * scene : 20 * scene + 20])
        text = MANIFEST.replace("data.npy", part.name).replace("segments = 4", "").replace("scenes = 4", "scenes = 1")
        alone = nfbench.run(study_of(folder, text), out=folder / f"out{scene}", jobs=0).runs
        own = alone.query("formulation == 'grid-refine'").iloc[0]
        assert runs.loc[scene, "rmse_m"] == pytest.approx(own["rmse_m"], rel=1e-9)
    assert runs["rmse_m"].nunique() == 4


def test_a_study_cannot_count_the_same_part_of_a_recording_twice(folder):
    for text, why in (
        (MANIFEST.replace("scenes = 4", "scenes = 5"), "expected at most 4, one per segment .*; raise segments, got 5"),
        (MANIFEST.replace("segments = 4", ""), "expected at most 1, one per segment .*; raise segments, got 4"),
        (
            MANIFEST.replace("segments = 4", "").replace("TRUTH", "TRUTH\n[sweep]\nsegments = [4, 3]\n"),
            "at most 3, one",
        ),
    ):
        with pytest.raises(ManifestError) as caught:
            study_of(folder, text)
        assert any(re.match(f"scenes: .*{why}", line) for line in caught.value.problems), caught.value.problems
    Y = np.load(folder / "data.npy")
    np.save(folder / "data.npy", Y @ Y.conj().T)
    with pytest.raises(ManifestError, match="scenes: expected at most 1, as a covariance has no parts, got 4"):
        study_of(folder, MANIFEST.replace("segments = 4", 'data_kind = "covariance"'))


def test_tuning_needs_other_scenes_for_training_than_the_study_has(folder):
    pytest.importorskip("optuna")
    study = study_of(folder, MANIFEST.replace("segments = 4", "segments = 6"))
    plan = Plan("de", training=3, held_out=4, trials=1)
    with pytest.raises(NfbenchError, match=r"at most 6 scenes together, one per segment .* got 7"):
        tune(study, plan, folder / "tuned")


def test_figures_of_positions_redraw_the_scene_with_its_number(folder, monkeypatch):
    results = nfbench.run(study_of(folder, MANIFEST), out=folder / "out", jobs=0)
    monkeypatch.setenv("NFBENCH_DATA", str(folder))  # the manifest's copy is in another folder than the data
    drawn = [path.name for path in write_figures(results, folder / "figures")]
    assert "positions.svg" in drawn


def test_scenes_of_responses_are_all_choices(folder):
    np.savez(folder / "data.npz", h=responses().T)
    study = study_of(folder, RESPONSES.replace("data.npy", "data.npz"), "")
    results = nfbench.run(study, out=folder / "out", jobs=0)
    assert set(results.counts) == {"ok"}
    ((_, scenario),) = nfbench.study.load_scenarios(folder / "study.toml")
    ranges = [scenario.draw_scene(np.random.default_rng(0), number).theta[0, 2] for number in range(3)]
    assert ranges[0] != ranges[1] and ranges[0] == ranges[2]
    assert results.runs.query("formulation == 'grid-refine'")["rmse_m"].lt(0.1).all()


def test_the_numbers_of_scenes_follow_from_their_seeds(folder):
    study = study_of(folder, MANIFEST)
    numbers = scene_numbers(folder / "study.toml")
    assert {spec.instance_seed: spec.scene for spec in study.specs()} == numbers
    assert sorted(numbers.values()) == [0, 1, 2, 3]


def test_a_moved_file_is_the_same_run_and_a_changed_one_is_not(folder):
    ids = [spec.run_id for spec in study_of(folder, MANIFEST).specs()]
    shutil.move(folder / "data.npy", folder / "moved.npy")
    moved = MANIFEST.replace("data.npy", "moved.npy")
    assert [spec.run_id for spec in study_of(folder, moved).specs()] == ids
    np.save(folder / "moved.npy", np.load(folder / "moved.npy") * 1.5)
    assert not set(ids) & {spec.run_id for spec in study_of(folder, moved).specs()}


@pytest.mark.parametrize("name", ["measured", "recorded"])
def test_the_studies_of_measured_data_say_where_missing_data_come_from(name, tmp_path, monkeypatch):
    monkeypatch.delenv("NFBENCH_DATA", raising=False)
    path = tmp_path / f"{name}.toml"
    shutil.copy(PROJECT / "studies" / path.name, path)
    with pytest.raises(ManifestError) as caught:
        nfbench.load_study(path)
    missing = [line for line in caught.value.problems if "no such file" in line]
    assert len(missing) == 3 and all("NFBENCH_DATA" in line for line in missing)
    assert "scenario.available_from: missing files are available from https://github.com/" in caught.value.problems[-1]


@pytest.mark.parametrize("name", ["measured", "recorded"])
def test_the_studies_of_measured_data_run(name, tmp_path, monkeypatch):
    data = PROJECT / ".." / "shared" / "data"
    if not data.is_dir():
        pytest.skip(f"the measured data are not in {data}")
    monkeypatch.setenv("NFBENCH_DATA", str(data))
    path = tmp_path / f"{name}.toml"
    text = (PROJECT / "studies" / path.name).read_text(encoding="utf-8")
    path.write_text(re.sub("evaluations = [0-9]+", "evaluations = 100", re.sub("scenes = [0-9]+", "scenes = 1", text)))
    study = nfbench.load_study(path)
    assert study.warnings == ()
    results = nfbench.run(study, out=tmp_path / "out", jobs=0)
    assert set(results.counts) == {"ok"}
    assert results.runs["rmse_m"].gt(0).all()
