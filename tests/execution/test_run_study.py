"""A study runs, resumes, and gives the same table with any number of workers, even if plugins misbehave."""

import json
import sqlite3
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import BASIC

import nfbench
from nfbench import Status, StoreError, load_study

TIMES = ["runtime_s", "cpu_s", "evaluation_s"]
SWEPT = BASIC + '[[formulation]]\nkind = "twice"\n[[formulation]]\nkind = "oracle"\n[sweep]\ndimension = [2, 3]\n'


def run(path, out, **options):
    return nfbench.run(load_study(path), out=out, **{"jobs": 0, **options})


def table(results):
    return results.runs.drop(columns=TIMES)


def test_the_log_keeps_the_warnings_of_the_study(manifest, tmp_path):
    study = replace(load_study(manifest(BASIC)), warnings=("scenario: data: element 5 receives nothing",))
    nfbench.run(study, out=tmp_path / "out", jobs=0)
    assert "WARNING scenario: data: element 5 receives nothing" in (tmp_path / "out" / "study.log").read_text()


def test_every_run_is_a_row_with_the_public_columns(manifest, tmp_path):
    results = run(manifest(SWEPT), tmp_path / "out")
    runs = pd.read_csv(tmp_path / "out" / "runs.csv")
    assert list(runs.columns) == [
        *("run_id", "study", "scenario", "formulation", "solver", "repetition", "scene", "run", "scenario.dimension"),
        *("status", "message", "rmse_m", "objective", "evaluations", "runtime_s", "cpu_s"),
        *("instance_seed", "solver_seed", "method", "batched", "batches", "error_1_m", "evaluation_s", "gap"),
    ]
    assert len(runs) == 3 * 2 * 3 == results.counts["ok"] + results.counts["skipped"]
    once = runs[runs.formulation == "once"]
    np.testing.assert_allclose(once.objective, once.rmse_m**2)
    assert (once.evaluations == 40).all()
    assert (runs[runs.formulation == "twice"].evaluations == 80).all()
    skipped = runs[runs.status == "skipped"]
    assert set(skipped.message) == {"works in 2 dimensions, not in 3"} and len(skipped) == 3
    assert (runs.study == "toy").all() and (runs.scenario == "toy").all()


def test_two_runs_of_one_study_are_identical_except_for_times(manifest, tmp_path):
    first, second = (run(manifest(SWEPT), tmp_path / name) for name in "ab")
    pd.testing.assert_frame_equal(table(first), table(second), check_exact=True)
    pd.testing.assert_frame_equal(
        first.traces.drop(columns="seconds"), second.traces.drop(columns="seconds"), check_exact=True
    )
    assert (tmp_path / "a" / "manifest.toml").read_bytes() == manifest(SWEPT).read_bytes()


def test_worker_processes_give_the_same_table(manifest, tmp_path):
    first, second = run(manifest(SWEPT), tmp_path / "a"), run(manifest(SWEPT), tmp_path / "b", jobs=2)
    pd.testing.assert_frame_equal(table(first), table(second), check_exact=True)


def test_adding_a_solver_leaves_the_others_rows_identical(manifest, tmp_path):
    before = table(run(manifest(BASIC), tmp_path / "a")).set_index("run_id")
    more = table(run(manifest(BASIC + '[[solver]]\nkind = "lazy"\n'), tmp_path / "b")).set_index("run_id")
    pd.testing.assert_frame_equal(before, more.loc[before.index], check_exact=True)


def test_running_again_resumes_and_computes_only_what_is_missing(manifest, tmp_path):
    first = run(manifest(BASIC), tmp_path / "out").runs
    again = run(manifest(BASIC), tmp_path / "out").runs
    pd.testing.assert_frame_equal(first, again, check_exact=True)  # times are equal, too: nothing was run
    extended = run(manifest(BASIC, repetitions=5), tmp_path / "out").runs
    assert len(extended) == 5
    pd.testing.assert_frame_equal(extended.head(3), first, check_exact=True)
    shrunk = run(manifest(BASIC, repetitions=2), tmp_path / "out").runs
    pd.testing.assert_frame_equal(shrunk, first.head(2), check_exact=True)


def test_a_table_that_was_deleted_is_written_again(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "out")
    tables = [tmp_path / "out" / name for name in ("runs.csv", "summary.csv")]
    before = [path.read_text() for path in tables]
    for path in tables:
        path.unlink()
        run(manifest(BASIC), tmp_path / "out")
        assert [path.read_text() for path in tables] == before


def test_an_interrupted_study_keeps_its_rows_and_resumes(manifest, tmp_path):
    class Stop:
        def begin(self, total, done): ...

        def stopping(self): ...

        def finished(self, spec, record):
            raise KeyboardInterrupt

    whole = run(manifest(BASIC), tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(manifest(BASIC), tmp_path / "out", listener=Stop())
    assert len(pd.read_csv(tmp_path / "out" / "runs.csv")) == 1
    assert nfbench.Results(tmp_path / "out").counts == {"ok": 1, "open": 2}
    pd.testing.assert_frame_equal(table(run(manifest(BASIC), tmp_path / "out")), table(whole), check_exact=True)


BAD = """
[[solver]]
kind = "raises"
[[solver]]
kind = "lazy"
[[solver]]
kind = "mutates"
[[solver]]
kind = "outside"
[[solver]]
kind = "exits"
[[solver]]
kind = "missing"
[[formulation]]
kind = "wrong-shape"
[[formulation]]
kind = "not-a-number"
"""


def test_every_failure_is_a_row_and_the_other_runs_finish(manifest, tmp_path):
    good = table(run(manifest(BASIC), tmp_path / "good"))
    (tmp_path / "bad.py").write_text("def broken(:")
    results = run(manifest(BASIC + BAD, plugins=["bad.py"]), tmp_path / "out")
    runs = table(results).set_index("method")
    expected = {
        "once + sampler": ("ok", ""),
        "once + raises": ("failed", "RuntimeError: out of luck (toy.py:"),
        "once + lazy": ("failed", "Lazy returned without evaluating a point"),
        "once + mutates": ("failed", "ValueError: assignment destination is read-only"),
        "once + outside": ("invalid", "x[0]: expected a number within [-1.0, 1.0], got 2.0"),
        "once + exits": ("failed", "SystemExit: 3"),
        "once + missing": ("failed", "unknown solver 'missing'"),
        "wrong-shape": ("invalid", "estimate: expected (2,), got (7,)"),
        "not-a-number": ("invalid", "rmse_m of the estimate is NaN"),
    }
    assert set(runs.index) == set(expected)
    for method, (status, message) in expected.items():
        assert set(runs.loc[method, "status"]) == {status}
        assert all(text.startswith(message) for text in runs.loc[method, "message"]), method
    kept = runs.loc[["once + sampler"]].reset_index()[good.columns]
    pd.testing.assert_frame_equal(kept, good, check_exact=True)
    assert (runs.loc["once + raises", "evaluations"] == 1).all()


def test_a_crash_and_a_hang_cost_only_their_own_rows(manifest, tmp_path):
    good = table(run(manifest(BASIC), tmp_path / "good"))
    path = manifest(BASIC + 'run_timeout_s = 1.0\n[[solver]]\nkind = "crashes"\n[[solver]]\nkind = "sleeps"\n')
    runs = table(run(path, tmp_path / "out", jobs=2))
    assert runs.groupby("solver").status.unique().map(list).to_dict() == {
        "crashes": ["crashed"],
        "sleeps": ["timeout"],
        "sampler": ["ok"],
    }
    assert set(runs[runs.solver == "crashes"].message) == {"its process died: exit code 3"}
    kept = runs[runs.solver == "sampler"].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, good, check_exact=True)


def test_failed_runs_are_repeated_only_on_request(manifest, tmp_path):
    path = manifest(BASIC + '[[solver]]\nkind = "raises"\n')
    first = run(path, tmp_path / "out").runs
    pd.testing.assert_frame_equal(run(path, tmp_path / "out").runs, first, check_exact=True)
    again = run(path, tmp_path / "out", retry=[Status.FAILED]).runs
    pd.testing.assert_frame_equal(again.drop(columns=TIMES), first.drop(columns=TIMES), check_exact=True)
    assert (again.runtime_s == first.runtime_s).tolist() == [solver == "sampler" for solver in first.solver]


def test_a_folder_of_another_study_is_refused_and_fresh_moves_it_aside(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "out")
    with pytest.raises(StoreError, match="expected seed = '2', found '1'"):
        run(manifest(BASIC, seed=2), tmp_path / "out")
    run(manifest(BASIC, seed=2), tmp_path / "out", fresh=True)
    (old,) = tmp_path.glob("out.2*")
    assert nfbench.Results(old).meta["seed"] == "1"


def test_the_environment_describes_how_the_results_were_computed(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "out")
    environment = json.loads((tmp_path / "out" / "environment.json").read_text())
    assert environment["versions"]["numpy"] == np.__version__
    assert environment["threads"]["in runs"] == 1
    assert environment["started"] <= environment["ended"] and environment["earlier"] == []
    (plugin,) = environment["plugins"].values()
    assert len(plugin) == 64
    run(manifest(BASIC, repetitions=4), tmp_path / "out")
    again = json.loads((tmp_path / "out" / "environment.json").read_text())
    assert again["earlier"] == [{key: value for key, value in environment.items() if key != "earlier"}]


def test_a_folder_without_results_or_with_an_invalid_file_is_an_error(tmp_path, manifest):
    with pytest.raises(StoreError, match=r"expected a results folder with runs\.sqlite, found none"):
        nfbench.Results(tmp_path).runs  # noqa: B018
    (tmp_path / "runs.sqlite").write_bytes(b"no database at all, but long enough to be looked at" * 100)
    with pytest.raises(StoreError, match="not a database"):
        run(manifest(BASIC), tmp_path)


def test_a_folder_that_cannot_be_created_is_an_error(manifest, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"file/out: Not a directory"):
        run(manifest(BASIC), tmp_path / "file" / "out")


def test_a_disk_that_fills_up_loses_no_finished_row(manifest, tmp_path, monkeypatch):
    from nfbench.results import rows

    real, calls = rows.packed, []

    def full(traces):
        calls.append(1)
        if len(calls) == 3:
            raise sqlite3.OperationalError("database or disk is full")
        return real(traces)

    monkeypatch.setattr(rows, "packed", full)
    with pytest.raises((StoreError, sqlite3.OperationalError), match="disk is full"):
        run(manifest(BASIC), tmp_path / "out")
    monkeypatch.undo()
    assert nfbench.Results(tmp_path / "out").counts == {"ok": 2, "open": 1}


def test_traces_are_kept_with_points_and_under_a_thousand_rows(manifest, tmp_path):
    results = run(manifest(SWEPT), tmp_path / "out")
    traces, runs = results.traces, results.runs.set_index("run_id")
    assert traces.groupby("run_id").size().max() < 1000
    last = traces.groupby(["run_id", "problem"]).last()
    assert (last.evaluations == 40).all()
    final = last.value.groupby("run_id").last()
    np.testing.assert_array_equal(final, runs.objective[final.index])
    assert {"x_0", "x_1", "x_2"} <= set(traces.columns)
