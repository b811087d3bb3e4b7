"""Hits agree with a second implementation on ``Results.traces``, also in older folders and without their manifest."""

import json
import sqlite3

import numpy as np
import pandas as pd
import pytest
from conftest import BASIC
from traced_studies import ERRORS, FUNCTIONS, GAPS, NEAR_FIELD, changed, copied, studied

import nfbench
from nfbench import load_study
from nfbench.analysis.distributions import aocc_table, fixed_budget_table, runtime_distribution
from nfbench.analysis.targets import Target, target_table
from nfbench.core.status import Status
from nfbench.core.trace import Trace
from nfbench.results import curves
from nfbench.results.hits import find_hits, find_progress, targets_of
from nfbench.results.store import Store
from nfbench.study import load_scenarios
from nfbench.study.records import RunRecord


@pytest.fixture(scope="module")
def functions(tmp_path_factory):
    return studied(tmp_path_factory.mktemp("functions"), FUNCTIONS)


@pytest.fixture(scope="module")
def near_field(tmp_path_factory):
    return studied(tmp_path_factory.mktemp("near_field"), NEAR_FIELD)


def by_run(frame, target):
    """Hit and evaluations of each run for one target, by run id."""
    found = frame[frame["target"] == target.label].set_index("run_id")
    return {run_id: (bool(row.hit), row.evaluations) for run_id, row in found.iterrows()}


# --- gaps -------------------------------------------------------------------------------------------------------------


def brute_force_gaps(results, target):
    """Search the traces for the first value within the target of the best one of all runs of the scene."""
    runs, traces = results.runs.set_index("run_id"), results.traces
    traces = traces[(traces["problem"] == 0) & (traces["run_id"].map(runs["status"]) == "ok")]
    swept = [name for name in runs.columns if name.startswith("scenario.")]
    found = {}
    for _, same in runs.groupby([*swept, "scene", "formulation"]):
        of_scene = traces[traces["run_id"].isin(same.index)]
        optimum = same["optimum"].iloc[0] if "optimum" in same else of_scene["value"].min()
        for run_id in same.index[same["solver"] != ""]:
            rows = of_scene[(of_scene["run_id"] == run_id) & (of_scene["value"] - optimum <= target.value)]
            found[run_id] = (len(rows) > 0, rows["evaluations"].min() if len(rows) else np.inf)
    return found


@pytest.mark.parametrize("target", GAPS, ids=lambda target: target.label)
@pytest.mark.parametrize("study", ["functions", "near_field"])
def test_gaps_agree_with_a_search_of_the_traces(study, target, request):
    results = request.getfixturevalue(study)
    assert by_run(find_hits(results, GAPS, cached=False).frame, target) == brute_force_gaps(results, target)


def test_the_gap_of_functions_is_their_error(functions):
    """The known minimum, not the best value found, is the reference."""
    finals = find_progress(functions, "gap").frame.groupby("run_id")["value"].last()
    errors = functions.runs.set_index("run_id")["gap"]
    np.testing.assert_allclose(finals.reindex(errors.index), errors, rtol=1e-9)
    assert finals.min() > 0


def test_the_best_run_of_a_scene_has_the_gap_zero_where_the_minimum_is_not_known(near_field):
    progress = find_progress(near_field, "gap").frame
    last = (
        progress.groupby("run_id", sort=False).last().assign(formulation=lambda f: f["method"].str.partition(" +")[0])
    )
    assert "music" not in set(last["formulation"])
    assert (last.groupby(["scene", "formulation"])["value"].min() == 0).all()


def without_optimum(results, folder):
    """A copy of the folder as an nfbench that did not record the known minimum wrote it."""
    older = copied(results, folder)
    scores = {run_id: json.loads(text) for run_id, text in _scores(older)}
    assert all(score.pop("optimum") == "0.0" for score in scores.values())
    changed(older, *(("UPDATE results SET scores = ? WHERE run_id = ?", (json.dumps(s), i)) for i, s in scores.items()))
    assert "optimum" not in older.runs
    return older


def test_a_known_minimum_is_found_by_redrawing_in_folders_that_do_not_record_it(functions, tmp_path):
    older = without_optimum(functions, tmp_path)
    pd.testing.assert_frame_equal(find_hits(older, GAPS).frame, find_hits(functions, GAPS).frame)


@pytest.mark.parametrize("target", GAPS, ids=lambda target: target.label)
def test_a_minimum_that_is_not_known_is_the_best_value_at_each_swept_point(functions, tmp_path, target):
    older = without_optimum(functions, tmp_path)
    (older.folder / "manifest.toml").unlink()
    assert by_run(find_hits(older, GAPS).frame, target) == brute_force_gaps(older, target)


def _scores(results):
    db = sqlite3.connect(results.folder / "runs.sqlite")
    rows = db.execute("SELECT run_id, scores FROM results").fetchall()
    db.close()
    return rows


def test_gaps_of_several_problems_are_those_of_the_first(near_field):
    frame = find_hits(near_field, [Target("gap", 1e-9), Target("error", 5.0)], cached=False).frame
    nemo = frame[frame["method"] == "nemo + de"]
    assert nemo[nemo["number"] == 0]["spent"].tolist() == [300.0] * 3
    assert nemo[nemo["number"] == 0]["cap"].tolist() == [300.0] * 3
    assert nemo[nemo["number"] == 1]["spent"].tolist() == [600.0] * 3  # of two problems


def test_a_method_without_a_solver_has_no_gap(near_field):
    frame = find_hits(near_field, [*GAPS, *ERRORS], cached=False).frame
    assert set(frame[frame["method"] == "music"]["number"]) == {3, 4, 5}
    assert set(frame[frame["method"] == "neef + de"]["number"]) == {0, 1, 2, 3, 4, 5}


# --- errors -----------------------------------------------------------------------------------------------------------


def limits(results, target):
    runs = results.runs.set_index("run_id")
    return runs["rmse_m"], target.value * (runs["crb_m"] if target.kind == "error_in_bounds" else 1.0)


@pytest.mark.parametrize("target", ERRORS, ids=lambda target: target.label)
def test_a_hit_is_a_final_error_at_the_target(near_field, target):
    errors, limit = limits(near_field, target)
    found = by_run(find_hits(near_field, ERRORS, cached=False).frame, target)
    assert {run_id: hit for run_id, (hit, _) in found.items()} == (errors <= limit).to_dict()


@pytest.mark.parametrize("target", ERRORS, ids=lambda target: target.label)
def test_errors_along_a_trace_agree_with_scoring_every_point(near_field, target):
    """The second implementation draws the scenes itself and scores one estimate after the other."""
    runs = near_field.runs.set_index("run_id")
    ((_, scenario),) = load_scenarios(near_field.folder / "manifest.toml")
    found = by_run(find_hits(near_field, ERRORS, cached=False).frame, target)
    _, limit = limits(near_field, target)
    limit = limit if isinstance(limit, pd.Series) else pd.Series(limit, runs.index)
    for run_id, (trace,) in _single(near_field, runs):
        instance = scenario.draw(np.random.default_rng(int(runs.loc[run_id, "instance_seed"])))
        errors = [instance.score(x.reshape(2, 2))["rmse_m"] for x in trace.points]
        stays = [i for i in range(len(errors)) if all(error <= limit[run_id] for error in errors[i:])]
        expected = (True, trace.evaluations[stays[0]]) if stays else (False, np.inf)
        assert found[run_id] == expected, run_id


def _single(results, runs):
    return [(run_id, traces) for run_id, traces in results.run_traces() if runs.loc[run_id, "formulation"] == "neef"]


def test_where_the_error_along_the_run_is_not_known_the_hit_is_at_its_end(near_field):
    found = find_hits(near_field, [Target("error", 1e3)], cached=False)
    for method, evaluations in {"neef + de": 1, "refined + de": 300, "nemo + de": 600, "music": 0}.items():
        rows = found.frame[found.frame["method"] == method]
        assert rows["hit"].all()
        assert set(rows["evaluations"]) == {evaluations}
    assert found.notes == (
        "refined: the estimate does not follow from the best point alone, so the error is known at the end of a run "
        "only",
        "nemo: several problems are minimized, so the error is known at the end of a run only",
    )


def test_one_source_makes_nemo_a_single_problem(tmp_path):
    text = NEAR_FIELD.replace("sources = 2", "sources = 1").replace("scenes = 3", "scenes = 1")
    frame = find_hits(studied(tmp_path, text), [Target("error", 1e3)]).frame
    assert set(frame[frame["method"] == "nemo + de"]["evaluations"]) == {1}


def test_the_data_of_a_scene_are_drawn_where_the_estimates_need_them(tmp_path):
    """The number of sources is estimated from the data, of which the truth of a scene has none."""
    text = NEAR_FIELD.replace("sources = 2", "sources = 1").replace("scenes = 3", "scenes = 1")
    estimated = text.replace('kind = "nemo"', 'kind = "nemo"\nsources = "estimate"', 1)
    assert estimated != text
    found = find_hits(studied(tmp_path, estimated), [Target("error", 1e3)])
    rows = found.frame[found.frame["method"].str.startswith("nemo")]
    assert set(rows["evaluations"]) == {1} and not any("nemo" in note for note in found.notes)


def test_a_scene_that_is_redrawn_differently_is_not_used(near_field, tmp_path):
    """As if the scenario had changed since the study ran: the stored seeds now give other scenes."""
    other = changed(copied(near_field, tmp_path), ("UPDATE plan SET instance_seed = instance_seed + 1",))
    found = find_hits(other, ERRORS)
    neef = found.frame[found.frame["method"].str.startswith("neef") & found.frame["hit"]]
    assert set(neef["evaluations"]) == {300}
    assert "neef: the redrawn scene is not that of the run, as it gives another error" in found.notes[0]
    for target in ERRORS:
        errors, limit = limits(other, target)
        assert {i: hit for i, (hit, _) in by_run(found.frame, target).items()} == (errors <= limit).to_dict()


@pytest.mark.parametrize("damage", ["missing", "no TOML", "another scenario"])
def test_without_a_readable_manifest_errors_are_those_at_the_end(near_field, tmp_path, damage):
    other = copied(near_field, tmp_path)
    manifest = other.folder / "manifest.toml"
    text = manifest.read_text()
    manifest.unlink()
    if damage != "missing":
        manifest.write_text("= 1" if damage == "no TOML" else text.replace('"near-field"\n', '"toy"\n'))
    found = find_hits(other, ERRORS)
    assert "the scenes cannot be redrawn" in found.notes[0]
    reference = find_hits(near_field, ERRORS, cached=False).frame
    assert found.frame["hit"].tolist() == reference["hit"].tolist()


def test_plugin_files_of_a_manifest_are_not_imported(manifest, tmp_path):
    """Reading a folder must not run code that comes with it."""
    results = nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)
    plugin = tmp_path / "evil.py"
    plugin.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    (results.folder / "manifest.toml").write_text(
        (results.folder / "manifest.toml").read_text().replace("plugins = [", f"plugins = [{str(plugin)!r}, ")
    )
    found = find_hits(results, [Target("error", 2.0), Target("gap", 1e-3)])
    assert not (tmp_path / "ran").exists()
    assert "the scenes cannot be redrawn" in found.notes[0]
    assert found.frame[found.frame["number"] == 0]["evaluations"].tolist() == [40.0] * 3


# --- failures ---------------------------------------------------------------------------------------------------------


def written(manifest, folder, records):
    """A folder whose runs have these records: (status, evaluations, traces, scores)."""
    study = load_study(manifest(BASIC, repetitions=len(records)))
    folder.mkdir()
    with Store(folder, write=True) as store:
        store.begin(study)
        store.add(
            RunRecord(spec.run_id, status, evaluations=spent, runtime_s=1.0, traces=traces, scores=scores)
            for spec, (status, spent, traces, scores) in zip(study.specs(), records, strict=True)
        )
    return nfbench.Results(folder)


def trace(*rows):
    """A trace of (evaluations, value)."""
    evaluations, values = np.array(rows, dtype=float).T
    return (Trace(evaluations.astype(int), evaluations / 100, values, np.zeros((len(rows), 2))),)


def test_failed_runs_hit_nothing_and_are_kept(manifest, tmp_path):
    results = written(
        manifest,
        tmp_path / "out",
        [
            (Status.OK, 40, trace((1, 5.0), (40, 1.0)), {"rmse_m": 0.5}),
            (Status.FAILED, 30, trace((1, 0.1), (30, 1e-9)), {}),
            (Status.TIMEOUT, 0, (), {}),
        ],
    )
    frame = find_hits(results, [Target("gap", 1e9), Target("error", 1.0)]).frame
    assert frame["hit"].tolist() == [True, True, False, False, False, False]
    assert frame["spent"].tolist() == [40, 40, 30, 30, 40, 40]  # a killed run may have spent all
    assert (frame["cap"] == 40).all()
    progress = find_progress(results, "gap").frame
    assert progress["value"].tolist() == [4.0, 0.0, np.inf, np.inf]
    assert progress["evaluations"].tolist() == [1, 40, 30, 40]


def test_an_error_that_gets_worse_is_reached_only_when_it_stays(monkeypatch, manifest, tmp_path):
    results = written(
        manifest, tmp_path / "out", [(Status.OK, 30, trace((1, 3.0), (10, 2.0), (30, 1.0)), {"rmse_m": 0.4})]
    )
    errors = np.array([0.3, 0.9, 0.4])
    monkeypatch.setattr(curves.Redrawing, "errors", lambda *_: (errors, ""))
    frame = find_hits(results, [Target("error", 0.5), Target("error", 1.0), Target("error", 0.35)], cached=False).frame
    assert frame["evaluations"].tolist() == [30, 1, np.inf]
    assert frame["seconds"].tolist() == [0.3, 0.01, np.inf]


def test_gradients_count_in_evaluation_equivalents(manifest, tmp_path):
    results = written(
        manifest, tmp_path / "out", [(Status.OK, 40, trace((1, 3.0), (20, 0.0)), {"rmse_m": 0.4, "gradients": 10.0})]
    )
    (row,) = find_hits(results, [Target("gap", 1e-3)], gradient_cost=2.0).frame.to_dict("records")
    assert (row["evaluations"], row["evaluation_equivalents"]) == (20, 20 * (1 + 2 * 10 / 40))


def test_scenes_without_a_bound_are_left_out_of_targets_in_bounds(manifest, tmp_path):
    scores = [{"rmse_m": 1.0, "crb_m": 0.5}, {"rmse_m": 1.0, "crb_m": np.inf}, {}]
    records = [(Status.OK if s else Status.FAILED, 10, (), s) for s in scores]
    found = find_hits(written(manifest, tmp_path / "out", records), [Target("error_in_bounds", 2)])
    assert found.frame[["scene", "hit"]].to_numpy().tolist() == [[0, True], [2, False]]
    assert "1 of 3 runs are of scenes without a finite bound" in found.notes[0]


def test_a_study_without_truth_has_no_error_targets(manifest, tmp_path):
    records = [(Status.OK, 10, trace((1, 1.0)), {})]
    found = find_hits(written(manifest, tmp_path / "out", records), [Target("error", 2), Target("gap", 1)])
    assert found.frame["target"].tolist() == ["gap ≤ 1e+00"]
    assert "error ≤ 2: no run has the score rmse_m" in found.notes[0]


# --- the study's own targets ------------------------------------------------------------------------------------------


def test_targets_come_from_the_manifest_or_the_defaults(functions, near_field, tmp_path):
    assert [t.label for t in targets_of(functions)] == ["gap ≤ 1e-02", "gap ≤ 1e-04", "gap ≤ 1e-06"]
    assert [t.label for t in targets_of(near_field)] == ["error ≤ 10 bounds", "error ≤ 3 bounds"]
    own = studied(tmp_path, FUNCTIONS + "[targets]\ngap = [1e-3]\nerror = [0.5]\n")
    assert [t.label for t in targets_of(own)] == ["gap ≤ 1e-03", "error ≤ 0.5"]


# --- progress ---------------------------------------------------------------------------------------------------------


def test_progress_of_the_error_ends_at_the_stored_error(near_field):
    progress = find_progress(near_field, "error", methods=["neef + de", "nemo + de"])
    assert set(progress.frame["method"]) == {"neef + de", "nemo + de"}
    last = progress.frame.groupby("run_id")["value"].last()
    errors = near_field.runs.set_index("run_id")["rmse_m"]
    np.testing.assert_array_equal(last, errors.reindex(last.index))
    nemo = progress.frame[progress.frame["method"] == "nemo + de"]
    assert len(nemo) == 3
    assert nemo["at_end"].all()
    assert not progress.frame["at_end"][progress.frame["method"] == "neef + de"].any()
    areas = aocc_table(progress.frame, -4, 1).set_index("method")["aocc"]
    assert np.isnan(areas["nemo + de"])
    assert 0 < areas["neef + de"] < 1
    medians = fixed_budget_table(progress.frame, [100, 600]).set_index(["method", "evaluations"])["median"]
    assert np.isnan(medians["nemo + de", 100])
    assert medians["nemo + de", 600] == nemo["value"].median()
    assert np.isfinite(medians["neef + de", 100])
    with pytest.raises(ValueError, match="measure: expected 'gap' or 'error', got 'rmse_m'"):
        find_progress(near_field, "rmse_m")


def test_a_study_without_finished_runs_has_empty_tables(manifest, tmp_path):
    (tmp_path / "out").mkdir()
    with Store(tmp_path / "out", write=True) as store:
        store.begin(load_study(manifest(BASIC)))
    results = nfbench.Results(tmp_path / "out")
    found = find_hits(results).frame
    assert len(found) == len(target_table(found)) == len(runtime_distribution(found)) == 0
    for measure in ("gap", "error"):
        progress = find_progress(results, measure).frame
        assert len(progress) == len(fixed_budget_table(progress, [1])) == 0
    assert len(find_hits(results, []).frame) == 0


def test_runs_csv_and_the_summary_state_gaps_and_errors_in_bounds(manifest, tmp_path):
    values = (2.0, 5.0, 3.0)
    records = [(Status.OK, 40, trace((1, 9.0), (40, v)), {"rmse_m": v, "crb_m": 0.5}) for v in values]
    results = written(manifest, tmp_path / "out", records)
    results.write_tables()
    runs = pd.read_csv(results.folder / "runs.csv")
    assert runs["error_in_bounds"].tolist() == [4.0, 10.0, 6.0]
    assert runs["gap"].tolist() == [0.0, 0.0, 0.0]  # three scenes, each with the only run as its reference
    (row,) = pd.read_csv(results.folder / "summary.csv").to_dict("records")
    assert (row["median_error_in_bounds"], row["median_gap"]) == (6.0, 0.0)
