"""cocopp, iohinspector and pandas read our exports back, and find the running times of ``targets.csv`` in them."""

import importlib.util
import json
import shutil
import sys
import warnings

import numpy as np
import pandas as pd
import pytest
from traced_studies import FUNCTIONS, changed, studied

import nfbench
from nfbench import MissingExtra, load_study
from nfbench.core.budget import Budget
from nfbench.core.meter import MeteredProblem
from nfbench.core.status import Status
from nfbench.results.export_as_coco import export_coco
from nfbench.results.export_as_ioh import export_ioh
from nfbench.results.export_as_parquet import export_parquet
from nfbench.results.store import Store
from nfbench.study.records import RunRecord

BBOB = """
name = "race"
scenes = 2
seed = 3
[scenario]
kind = "bbob"
[sweep]
function = [1, 3]
instance_id = [1, 2]
[[formulation]]
kind = "direct"
[[solver]]
kind = "random-search"
[budget]
evaluations = 200
"""
FAILED = "UPDATE results SET status = 'failed', scores = '{}' WHERE run_id = ?"


@pytest.fixture(scope="module")
def race(tmp_path_factory):
    """Two runs per scene of two methods; four runs have failed, three of them one after the other."""
    text = FUNCTIONS.replace("scenes = 4", "scenes = 4\nruns_per_scene = 2")
    results = studied(tmp_path_factory.mktemp("race"), text)
    searches = results.runs.query("solver == 'random-search' and `scenario.dimension` == 2")
    ids = searches["run_id"].tolist()[1:3] + results.runs["run_id"].tolist()[:2]
    return changed(results, *((FAILED, (run_id,)) for run_id in ids))


def expected_times(results):
    """The running times of ``targets.csv`` by method, dimension and target, and the shares of runs that succeed."""
    table = results.target_table()
    keys = zip(
        table["method"], table["scenario.dimension"], table["target"].str.split().str[-1].astype(float), strict=True
    )
    return dict(zip(keys, zip(table["ert"], table["hits"], strict=True), strict=True))


def loaded(folder):
    """The functions that come with exported data."""
    spec = importlib.util.spec_from_file_location("postprocess", folder / "postprocess.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read_by_cocopp(folder):
    """The data sets of all methods in a folder that export_coco has written."""
    pytest.importorskip("cocopp", reason="pip install 'nfbench[coco]'")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cocopp = loaded(folder).declare(folder)
        cocopp.testbedsettings.reset_current_testbed()
        about = json.loads((folder / "suite.json").read_text())
        return {
            name: list(cocopp.pproc.DataSetList([str(folder / path)])) for name, path in about["algorithms"].items()
        }


def test_the_race_has_failures_and_targets_that_some_runs_miss(race):
    times = expected_times(race)
    assert (race.runs["status"] == "failed").sum() == 4
    assert len(times) == 12 and any(np.isinf(ert) for ert, _ in times.values())
    assert len({hits for _, hits in times.values()}) > 3


def test_cocopp_finds_the_running_times_of_the_table(race, tmp_path):
    exported = export_coco(race, tmp_path / "coco")
    assert (exported.runs, exported.total, exported.misses) == (32, 32, 4)
    expected = expected_times(race)
    found = {}
    for method, sets in read_by_cocopp(tmp_path / "coco").items():
        for data in sets:
            assert data.instancenumbers == [1, 1, 2, 2, 3, 3, 4, 4]
            targets = sorted({target for *_, target in expected}, reverse=True)
            for target, ert, hits in zip(targets, data.detERT(targets), data.detSuccesses(targets), strict=True):
                found[method, data.dim, target] = (ert, hits)
    assert found.keys() == expected.keys()
    for key, (ert, hits) in expected.items():
        assert found[key] == (pytest.approx(ert, rel=1e-12), hits), key


def test_iohinspector_finds_the_running_times_of_the_table(race, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        iohinspector = pytest.importorskip("iohinspector", reason="pip install 'nfbench[checks]'")
        from iohinspector.metrics import aggregate_running_time

        export_ioh(race, tmp_path / "ioh")
        manager = iohinspector.DataManager()
        manager.add_folder(str(tmp_path / "ioh"))
        data = manager.load(monotonic=True, include_meta_data=True)
        expected, found = expected_times(race), {}
        for target in {target for *_, target in expected}:
            table = aggregate_running_time(
                data, free_vars=["algorithm_name", "dimension"], f_min=target, f_max=target, eval_max=400
            )
            for _, row in table.iterrows():
                found[row["algorithm_name"], row["dimension"], target] = (row["ERT"], row["success_count"])
    assert data["data_id"].n_unique() == 32 and found.keys() == expected.keys()
    # iohinspector charges a run without a hit the largest number of evaluations, also one that has failed before; here
    # the failed ones have spent 400, too
    for key, (ert, hits) in expected.items():
        assert found[key] == (pytest.approx(ert, rel=1e-12), hits), key


@pytest.mark.slow
def test_cocopp_processes_the_data_with_one_command(race, tmp_path):
    pytest.importorskip("cocopp", reason="pip install 'nfbench[coco]'")
    export_coco(race, tmp_path / "coco")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded(tmp_path / "coco").main(["-o", str(tmp_path / "pages")])
    pages = {path.name for path in (tmp_path / "pages").glob("**/*.html")}
    assert {"index.html", "pprldmany.html", "ppfigs.html", "pptables.html"} <= pages


def observed(cocoex, folder, monkeypatch):
    """Random search on BBOB as COCO's own observer writes it; returns the points by function and instance."""
    monkeypatch.chdir(folder)
    suite = cocoex.Suite("bbob", "instances: 1-2", "dimensions: 2 function_indices: 1,3")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        observer = cocoex.Observer("bbob", "result_folder: theirs")
    points = {}
    for problem in suite:
        problem.observe_with(observer)
        key = problem.id_function, problem.id_instance
        points[key] = np.random.default_rng(key).uniform(-5, 5, (200, 2))
        for x in points[key]:
            problem(x)
        problem.free()
    return points


def test_a_study_of_bbob_has_the_data_of_cocos_own_logger(tmp_path, monkeypatch):
    cocoex = pytest.importorskip("cocoex", reason="pip install 'nfbench[coco]'")
    pytest.importorskip("cocopp", reason="pip install 'nfbench[coco]'")
    from nfbench.problems.bbob import BBOBProblem

    points = observed(cocoex, tmp_path, monkeypatch)
    (tmp_path / "study.toml").write_text(BBOB.replace("scenes = 2", "scenes = 1"))
    study = load_study(tmp_path / "study.toml")
    (tmp_path / "out").mkdir()
    shutil.copy(tmp_path / "study.toml", tmp_path / "out" / "manifest.toml")
    with Store(tmp_path / "out", write=True) as store:
        store.begin(study)
        for spec in study.specs():
            key = spec.point.swept["function"], spec.point.swept["instance_id"]
            problem = BBOBProblem("coco", key[0], 2, key[1])
            meter = MeteredProblem(problem, Budget(evaluations=200))
            for x in points[key]:
                meter(x)
            scores = {"instance_id": float(key[1]), "optimum": problem.f_opt, "gap": 0.0}
            store.add([RunRecord(spec.run_id, Status.OK, scores=scores, evaluations=200, traces=(meter.trace,))])
    export_coco(nfbench.Results(tmp_path / "out"), tmp_path / "ours")
    (ours,) = read_by_cocopp(tmp_path / "ours").values()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = list(sys.modules["cocopp"].pproc.DataSetList([str(tmp_path / "exdata" / "theirs")]))
    assert [(data.funcId, data.dim, data.suite) for data in ours] == [(1, 2, "bbob"), (3, 2, "bbob")]
    for our, their in zip(ours, sorted(theirs, key=lambda data: data.funcId), strict=True):
        assert (our.funcId, our.dim, our.suite) == (their.funcId, their.dim, their.suite)
        assert our.instancenumbers == their.instancenumbers == [1, 2]
        assert our.maxevals.tolist() == their.maxevals.tolist() == [200, 200]
        np.testing.assert_array_equal(our.evals[:, 1:], their.evals[:, 1:])
        np.testing.assert_allclose(our.evals[:, 0], their.evals[:, 0], rtol=1e-9)
        np.testing.assert_allclose(our.finalfunvals, their.finalfunvals, rtol=1e-8)


@pytest.mark.parametrize(("module", "backend"), [("cocoex", "coco"), ("ioh", "ioh")])
def test_scenes_of_bbob_have_cocos_numbers_in_tables_and_exports(tmp_path, module, backend):
    pytest.importorskip(module, reason=f"pip install 'nfbench[{backend}]'")
    text = BBOB.replace('"bbob"\n', f'"bbob"\nbackend = "{backend}"\n').replace("instance_id = [1, 2]\n", "")
    results = studied(tmp_path, text)
    runs = results.runs
    assert runs["instance_id"].between(1, 1000).all() and runs.groupby("scene")["instance_id"].nunique().eq(1).all()
    numbers = runs.query("`scenario.function` == 3")["instance_id"].astype(int).tolist()
    assert len(set(numbers)) == 2
    changed(results, (FAILED, (runs["run_id"].iloc[0],)))
    assert export_coco(results, tmp_path / "coco").misses == 1
    text = (tmp_path / "coco" / "direct_+_random-search" / "bbobexp_f1.info").read_text()
    assert text.startswith(
        "suite = 'bbob', funcId = 1, DIM = 2, Precision = 1.000e-08, algId = 'direct + random-search'"
    )
    assert [int(run.split(":")[0]) for run in text.splitlines()[2].split(", ")[1:]] == numbers  # the failed one, too
    export_ioh(results, tmp_path / "ioh")
    heads = [json.loads(path.read_text()) for path in sorted((tmp_path / "ioh").glob("*/*.json"))]
    assert [(head["suite"], head["function_id"]) for head in heads] == [("bbob", 1), ("bbob", 3)]
    assert [run["instance"] for run in heads[1]["scenarios"][0]["runs"]] == numbers


def test_parquet_files_have_the_tables(race, tmp_path):
    pytest.importorskip("pyarrow", reason="pip install 'nfbench[parquet]'")
    assert export_parquet(race, tmp_path / "tables").runs == 32
    read = {path.stem: pd.read_parquet(path) for path in (tmp_path / "tables").iterdir()}
    expected = {"runs": race.runs, "hits": race.hits(), "targets": race.target_table()}
    for name, frame in expected.items():
        pd.testing.assert_frame_equal(read[name], frame, check_dtype=False, rtol=0, atol=0)
    traces, stored = read["traces"], race.traces
    columns = ["run_id", "problem", "evaluations", "seconds", "value"]
    pd.testing.assert_frame_equal(traces[columns], stored[columns], check_dtype=False, rtol=0, atol=0)
    points = np.vstack([np.append(x, [np.nan] * (3 - len(x))) for x in traces["x"]])
    np.testing.assert_array_equal(points, stored[["x_0", "x_1", "x_2"]])
    ok = traces["status"] == "ok"
    np.testing.assert_array_equal(traces["gap"][ok], traces["value"][ok])  # the sphere's minimum is 0
    assert traces["gap"][~ok].isna().all() and (~ok).any()


def test_parquet_without_its_library_says_what_to_install(race, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingExtra, match=r"Parquet needs pyarrow.*pip install 'nfbench\[parquet\]'"):
        export_parquet(race, tmp_path / "tables")
    assert not (tmp_path / "tables").exists()


def test_text_in_labels_does_not_break_cocos_header_lines(tmp_path):
    label = "a', DIM = 7, b = '\\\\"  # in TOML; a backslash at the end
    text = FUNCTIONS.replace('kind = "de"', f'kind = "de"\nlabel = "{label}"').replace("scenes = 4", "scenes = 1")
    export_coco(studied(tmp_path, text), tmp_path / "coco")
    found = [(data.funcId, data.dim) for sets in read_by_cocopp(tmp_path / "coco").values() for data in sets]
    assert sorted(found) == [(1, 2), (1, 2), (2, 3), (2, 3)]
