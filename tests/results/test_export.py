"""Exports for IOHprofiler and as CSV match the traces they are made from, and the files that ioh itself writes."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import BASIC

import nfbench
import nfbench.results.pages
import nfbench.results.store
from nfbench import StoreError, load_study
from nfbench.cli import main
from nfbench.core.budget import Budget
from nfbench.core.errors import NfbenchError
from nfbench.core.meter import MeteredProblem
from nfbench.core.problem import Problem
from nfbench.core.status import Status
from nfbench.core.trace import Trace
from nfbench.results.export_as_csv import export_csv
from nfbench.results.export_as_ioh import export_ioh
from nfbench.results.store import Store
from nfbench.study.records import RunRecord

SEVERAL = """
[[formulation]]
kind = "once"
[[formulation]]
kind = "twice"
[[solver]]
kind = "sampler"
[[solver]]
kind = "raises"
[[method]]
formulation = "oracle"
[budget]
evaluations = 40
[sweep]
dimension = [1, 2]
noise = [0.0, 0.5]
"""


@pytest.fixture
def several(manifest, tmp_path):
    """A study with two problems per run of ``twice``, two dimensions, a failing solver, and a method without one."""
    return nfbench.run(load_study(manifest(SEVERAL, repetitions=2)), out=tmp_path / "out", jobs=0)


def written(manifest, folder, records, extra=BASIC, **options):
    """The results of a folder whose first runs have these records, given as (status, traces)."""
    study = load_study(manifest(extra, **options))
    folder.mkdir()
    with Store(folder, write=True) as store:
        store.begin(study)
        store.add(
            RunRecord(spec.run_id, status, traces=traces)
            for spec, (status, traces) in zip(study.specs(), records, strict=False)
        )
    return nfbench.Results(folder)


def trace(*rows):
    """A trace in one dimension: rows of (evaluations, value, point)."""
    evaluations, values, points = (np.array(column) for column in zip(*rows, strict=True))
    return Trace(evaluations, np.arange(len(rows)) / 4, values.astype(float), points.astype(float)[:, None])


def read_ioh(folder):
    """Every row of a folder in IOHprofiler's format. As in its readers, a run begins at evaluation 1."""
    rows = []
    for path in sorted(folder.glob("**/*.json")):
        head = json.loads(path.read_text())
        about = {"method": head["algorithm"]["name"], "function": head["function_id"]}
        for attribute in head["experiment_attributes"]:
            about |= attribute
        for scenario in head["scenarios"]:
            runs = iter(scenario["runs"])
            for line in (path.parent / scenario["path"]).read_text().splitlines():
                if line == "evaluations raw_y":
                    continue
                evaluations, value = line.split(" ")
                if evaluations == "1":
                    run = next(runs)
                where = {"instance": run["instance"], "dimension": scenario["dimension"]}
                rows.append(about | where | {"evaluations": int(evaluations), "value": float(value), "best": run})
            assert next(runs, None) is None
    return pd.DataFrame(rows)


def test_the_files_have_the_structure_of_those_of_ioh(manifest, tmp_path):
    # the structure of examples/SO_Data/HC in github.com/IOHprofiler/IOHinspector
    first = trace((1, 3.5, 0.25), (4, 1.25, -0.5), (9, 1.25, -0.5))
    second = trace((1, -2.0, 1.0))
    results = written(manifest, tmp_path / "out", [(Status.OK, (first,)), (Status.OK, (second,))], repetitions=2)
    text = str(export_ioh(results))
    assert text == f"{tmp_path}/out/export-ioh: 2 of 2 runs"
    folder = tmp_path / "out" / "export-ioh" / "once_+_sampler"
    data = folder / "data_f1_once" / "IOHprofiler_f1_DIM1.dat"
    assert data.read_text() == "evaluations raw_y\n1 2.25\n4 0.0\n9 0.0\nevaluations raw_y\n1 0.0\n"
    assert {path for path in folder.glob("**/*") if path.is_file()} == {data, folder / "IOHprofiler_f1_once.json"}
    assert json.loads((folder / "IOHprofiler_f1_once.json").read_text()) == {
        "version": "0.3.22",
        "suite": "nfbench toy",
        "function_id": 1,
        "function_name": "once",
        "maximization": False,
        "algorithm": {"name": "once + sampler", "info": "formulation once, solver sampler"},
        "experiment_attributes": [{"formulation": "once"}, {"solver": "sampler"}],
        "attributes": ["evaluations", "raw_y"],
        "scenarios": [
            {
                "dimension": 1,
                "path": "data_f1_once/IOHprofiler_f1_DIM1.dat",
                "runs": [
                    {"instance": 1, "evals": 9, "best": {"evals": 4, "y": 0.0, "x": [-0.5]}},
                    {"instance": 2, "evals": 1, "best": {"evals": 1, "y": 0.0, "x": [1.0]}},
                ],
            }
        ],
    }


class Sphere(Problem):
    def __init__(self):
        self.lower, self.upper = np.full(2, -5.0), np.full(2, 5.0)

    def evaluate(self, X):
        return (X**2).sum(axis=1)


def test_iohs_own_logger_writes_the_same_for_the_same_evaluations(manifest, tmp_path):
    ioh = pytest.importorskip("ioh")
    logger = ioh.logger.Analyzer(root=str(tmp_path), folder_name="theirs", algorithm_name="once + sampler")
    logger.add_experiment_attribute("problem", "0")
    theirs = ioh.wrap_problem(lambda x: float(np.square(x).sum()), "sphere", dimension=2, lb=-5, ub=5)
    theirs.attach_logger(logger)
    records = []
    for seed in range(2):
        meter = MeteredProblem(Sphere(), Budget(evaluations=30))
        for x in np.random.default_rng(seed).uniform(-5, 5, (30, 2)):
            theirs(x), meter(x)
        theirs.reset()
        records.append((Status.OK, (meter.trace,)))
    logger.close()
    export_ioh(written(manifest, tmp_path / "out", records, repetitions=2), tmp_path / "ours")

    (path,), (their_path,) = ((tmp_path / which).glob("**/*.json") for which in ("ours", "theirs"))
    ours, their = json.loads(path.read_text()), json.loads(their_path.read_text())
    assert list(ours) == list(their)
    (scenario,), (their_scenario,) = ours["scenarios"], their["scenarios"]
    assert list(scenario) == list(their_scenario) and scenario["dimension"] == their_scenario["dimension"] == 2
    assert list(ours["algorithm"]) == list(their["algorithm"]) and ours["attributes"] == their["attributes"]
    for run, their_run in zip(scenario["runs"], their_scenario["runs"], strict=True):
        assert run["best"] == their_run["best"] | {"y": 0.0} and run["evals"] == their_run["evals"] == 30
        assert list(run) == list(their_run) and list(run["best"]) == list(their_run["best"])
    lines = (path.parent / scenario["path"]).read_text().split("\n")
    their_lines = (their_path.parent / their_scenario["path"]).read_text().split("\n")
    assert path.parent.parent.parent == their_path.parent.parent == tmp_path
    assert lines[0] == their_lines[0] and len(lines) == len(their_lines) and lines[-1] == their_lines[-1] == ""
    optima = iter(run["best"]["y"] for run in their_scenario["runs"])  # of each scene, as there is one method
    for line, their_line in zip(lines[:-1], their_lines[:-1], strict=True):
        assert line.split(" ")[0] == their_line.split(" ")[0]
        if line.startswith("e"):
            optimum = next(optima)
        elif not line.startswith("30 "):  # ioh writes the last evaluation's own value, we write the best so far
            value = float(their_line.split(" ")[1]) - optimum
            assert float(line.split(" ")[1]) == pytest.approx(value, abs=1e-10)


def test_every_run_of_a_solver_is_exported_with_the_gap_of_its_first_problem(several):
    text = str(export_ioh(several))
    assert text.endswith("export-ioh: 32 of 40 runs, of which 16 are not ok; left out: 4 skipped, 4 without a trace")
    found = read_ioh(several.folder / "export-ioh")
    assert (found["dimension"] == found["scenario.dimension"].astype(int)).all()
    found = found.assign(**{name: found[name].astype(float) for name in ("scenario.dimension", "scenario.noise")})
    traces = several.traces.join(several.runs.set_index("run_id").drop(columns="evaluations"), on="run_id")
    traces = traces.query("status == 'ok' and problem == 0").assign(instance=traces["scene"] + 1)
    problem = ["formulation", "scenario.dimension", "scenario.noise", "scene"]
    assert "optimum" not in traces and traces.groupby(problem)["method"].nunique().max() == 1
    traces["gap"] = traces["value"] - traces.groupby(problem)["value"].transform("min")
    keys = ["method", "scenario.dimension", "scenario.noise", "instance", "evaluations"]
    hits = found[~found["method"].str.contains("raises")]
    ours = hits.sort_values(keys)[[*keys, "value"]].reset_index(drop=True)
    theirs = traces.sort_values(keys)[[*keys, "gap"]].rename(columns={"gap": "value"}).reset_index(drop=True)
    pd.testing.assert_frame_equal(ours, theirs, check_dtype=False, rtol=0, atol=1e-15)
    assert {run["best"]["y"] for run in hits["best"]} == {0.0}
    what = found.groupby("function")[["formulation", "scenario.dimension", "scenario.noise"]].nunique()
    assert len(what) == 8 and (what == 1).all(axis=None)  # 4 scenario points, two formulations


def test_gaps_are_measured_from_the_best_value_that_any_run_has_found_for_the_problem(manifest, tmp_path):
    methods = "[[formulation]]\nkind = 'once'\n" + "".join(
        f"[[solver]]\nkind = 'sampler'\nbatch = {i}\n" for i in (1, 2)
    )
    rows = [((1, 5.0, 0.0), (3, 2.0, 0.1)), ((1, -1.0, 0.0),), ((1, 4.0, 0.0), (2, 1.5, 0.1)), ((1, -1.0, 0.0),)]
    extra = methods + "[budget]\nevaluations = 10\n"
    results = written(
        manifest, tmp_path / "out", [(Status.OK, (trace(*row),)) for row in rows], extra=extra, repetitions=2
    )
    expected = {}
    for (_, run), row in zip(results.runs.iterrows(), rows, strict=True):
        same = [
            other[-1][1] for (_, o), other in zip(results.runs.iterrows(), rows, strict=True) if o.scene == run.scene
        ]
        expected[run.method, run.scene + 1] = [value - min(same) for _, value, _ in row]
    assert sorted(map(tuple, expected.values())) != [(0.0,)] * 4
    export_ioh(results)
    found = read_ioh(tmp_path / "out" / "export-ioh")
    assert {key: group.value.tolist() for key, group in found.groupby(["method", "instance"])} == expected


def test_runs_that_are_not_ok_have_spent_their_evaluations_and_reached_nothing(manifest, tmp_path):
    fine, late = trace((1, 2.0, 0.0), (5, 1.0, 0.5)), trace((1, np.inf, 0.0), (3, 1.0, 0.5))
    records = [(Status.OK, (fine,)), (Status.OK, (late, fine)), (Status.TIMEOUT, (fine,)), (Status.FAILED, ())]
    results = written(manifest, tmp_path / "out", [*records, (Status.OK, ())], repetitions=8)
    text = str(export_ioh(results)).partition(": ")[2]
    assert text == "4 of 8 runs, of which 2 are not ok; left out: 1 without a trace, 3 open"
    found = read_ioh(tmp_path / "out" / "export-ioh")
    assert found.groupby("instance").value.apply(list).tolist()[:2] == [[1.0, 0.0], [3e21, 0.0]]
    misses = found[found.instance > 2]
    assert (misses.value >= 3e21).all() and misses.instance.unique().tolist() == [3, 4]
    assert misses.groupby("instance").evaluations.max().tolist() == [40, 1]  # a killed run may have spent its budget
    text = str(export_csv(results)).partition(": ")[2]
    assert text == "3 of 8 runs; left out: 1 failed, 1 without a trace, 3 open"
    table = pd.read_csv(tmp_path / "out" / "traces.csv")
    assert table.value.tolist() == [2.0, 1.0, np.inf, 1.0, 2.0, 1.0, 2.0, 1.0]
    assert table.status.tolist() == ["ok"] * 6 + ["timeout"] * 2
    np.testing.assert_array_equal(table.gap, [1.0, 0.0, np.inf, 0.0, *[np.nan] * 4])


def test_a_swept_budget_is_part_of_the_algorithm_because_it_changes_no_problem(manifest, tmp_path):
    extra = BASIC.replace("[budget]\nevaluations = 40\n", "") + '[sweep]\n"budget.evaluations" = [5, 9]\n'
    results = nfbench.run(load_study(manifest(extra, repetitions=2)), out=tmp_path / "out", jobs=0)
    export_ioh(results)
    found = read_ioh(tmp_path / "out" / "export-ioh")
    assert found.function.unique().tolist() == [1]
    labels = {f"once + sampler, budget.evaluations = {n}": n for n in (5, 9)}
    assert found.groupby("method").evaluations.max().to_dict() == labels
    best = found.groupby("instance").value.min()
    assert (best == 0.0).all()


def test_labels_that_differ_only_in_invalid_file_name_characters_stay_distinct(manifest, tmp_path):
    labels = ["a/b: β", "a b", "A\\B", "a..b", "β", "x" * 200]
    extra = "[budget]\nevaluations = 10\n" + "".join(
        f"[[method]]\nformulation = 'once'\nsolver = {{ kind = 'sampler', batch = {i + 1} }}\nlabel = '{label}'\n"
        for i, label in enumerate(labels)
    )
    results = nfbench.run(load_study(manifest(extra, repetitions=1)), out=tmp_path / "out", jobs=0)
    export_ioh(results)
    found = {
        folder.name: json.loads(next(folder.glob("*.json")).read_text())["algorithm"]["name"]
        for folder in (tmp_path / "out" / "export-ioh").iterdir()
    }
    names = ["a_b", "a_b-2", "A_B-3", "a_b-4", "_", "x" * 80]
    assert found == dict(zip(names, labels, strict=True))


def test_the_table_has_the_traces_with_the_keys_of_their_runs(several, monkeypatch):
    export_csv(several)
    whole = (several.folder / "traces.csv").read_bytes()
    table = pd.read_csv(several.folder / "traces.csv")
    added = ["method", "repetition", "scenario.dimension", "scenario.noise", "status"]
    assert list(table) == [
        "run_id",
        *added[:-1],
        "status",
        "problem",
        "evaluations",
        "seconds",
        "value",
        "gap",
        "x_0",
        "x_1",
    ]
    assert {line.count(b",") for line in whole.splitlines()} == {len(table.columns) - 1}  # not ragged
    pd.testing.assert_frame_equal(
        table.drop(columns=[*added, "gap"]), several.traces, check_dtype=False, rtol=0, atol=0
    )
    runs = several.runs.set_index("run_id")[added]
    pd.testing.assert_frame_equal(table[added], runs.loc[table.run_id].reset_index(drop=True), check_dtype=False)
    monkeypatch.setattr(nfbench.results.pages, "PAGE", 3)
    export_csv(several, several.folder / "by threes" / "again.csv")
    assert (several.folder / "by threes" / "again.csv").read_bytes() == whole


def test_traces_are_unpacked_one_run_at_a_time(several, monkeypatch):
    unpacked = []
    monkeypatch.setattr(nfbench.results.store, "unpacked", lambda blob: unpacked.append(blob) or ())
    with Store(several.folder) as store:
        runs = store.traced_runs()
        next(runs), next(runs)
        assert len(unpacked) == 2


def test_chosen_runs_are_read_in_the_wanted_order(several, monkeypatch):
    ids = several.runs["run_id"].tolist()
    wanted = [ids[4], "unknown", ids[1], ids[3], ids[0]]
    monkeypatch.setattr(nfbench.results.pages, "PAGE", 2)
    whole = {run.run_id: run for run in several.traced_runs()}
    found = list(several.traced_runs(only=wanted))
    assert [run.run_id for run in found] == [ids[4], ids[1], ids[3], ids[0]]
    for run in found:
        assert run.method == whole[run.run_id].method
        for trace, other in zip(run.traces, whole[run.run_id].traces, strict=True):
            np.testing.assert_array_equal(trace.points, other.points)


def test_swept_text_and_lists_are_kept(manifest, tmp_path):
    extra = BASIC + '[sweep]\nnames = [["a,b", "c"], ["10"]]\n'
    results = nfbench.run(load_study(manifest(extra, repetitions=1)), out=tmp_path / "out", jobs=0)
    export_csv(results), export_ioh(results)
    swept = ['["a,b", "c"]', '["10"]']
    assert pd.read_csv(tmp_path / "out" / "traces.csv")["scenario.names"].unique().tolist() == swept
    found = read_ioh(tmp_path / "out" / "export-ioh")["scenario.names"].unique()
    assert [eval(text) for text in found] == swept  # iohinspector evaluates them, too


def test_exports_work_while_another_process_writes_the_study(several, manifest):
    with Store(several.folder, write=True) as store:
        exported = export_csv(several)
        store.forget([Status.FAILED])
        assert export_ioh(several).left_out == {"skipped": 4, "without a trace": 4, "open": 16}
    assert exported.runs == 32


def test_nothing_is_overwritten_or_left_incomplete(several, monkeypatch):
    before = sorted(several.folder.iterdir())

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("nfbench.results.export.Exported.close", stop)
    for export in (export_ioh, export_csv):
        with pytest.raises(KeyboardInterrupt):
            export(several)
    assert sorted(several.folder.iterdir()) == before
    for export, name in ((export_ioh, "export-ioh"), (export_csv, "traces.csv")):
        (several.folder / name).write_text("mine")
        with pytest.raises(NfbenchError, match=f"{name} already exists; remove it, or choose another path with --out"):
            export(several)
        assert (several.folder / name).read_text() == "mine"
        with pytest.raises(StoreError, match=r"mine/\w+: Not a directory|mine: Not a directory"):
            export(several, several.folder / name / "mine" / "below")


def test_a_folder_without_results_is_an_error(manifest, tmp_path):
    for export in (export_ioh, export_csv):
        with pytest.raises(StoreError, match="expected a results folder with"):
            export(nfbench.Results(tmp_path))
    results = written(manifest, tmp_path / "new", [])
    failed = written(manifest, tmp_path / "failed", [(Status.CRASHED, ())])
    for export in (export_ioh, export_csv):
        with pytest.raises(NfbenchError, match="no run has finished yet; nothing was written"):
            export(results)
        with pytest.raises(NfbenchError, match=r"no finished run can be exported; .* left out: 1 crashed, 2 open"):
            export(failed)
    assert not [path for path in tmp_path.glob("*/*") if path.name not in ("runs.sqlite", ".lock")]


def test_the_command_prints_what_it_wrote(several, monkeypatch, capsys):
    def nfbench_export(*arguments):
        monkeypatch.setattr(sys, "argv", ["nfbench", "export", str(several.folder), *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capsys.readouterr()

    out = several.folder.parent / "x" / "y"
    text = f"{out}: 32 of 40 runs, of which 16 are not ok; left out: 4 skipped, 4 without a trace\n"
    assert nfbench_export("--to", "ioh", "--out", str(out)) == (0, text, "")
    assert len(list(out.glob("*/*.json"))) == 16
    code, _, errors = nfbench_export("--to", "ioh", "--out", str(out))
    assert code == 2 and "y already exists; remove it, or choose another path with --out" in errors
    code, _, errors = nfbench_export("--to", "arff")
    assert code == 2 and all(name in errors for name in ("'arff'", "'ioh'", "'coco'", "'csv'", "'parquet'"))
