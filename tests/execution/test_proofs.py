"""Optima are proven once per scene and formulation, isolated like runs, and survive kills, shards and old folders."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from conftest import PLUGINS

import nfbench
from nfbench import ManifestError, Status, load_study
from nfbench.results import merge

TIMES = ["runtime_s", "cpu_s", "evaluation_s"]
HEAD = """
name = "proofs"
scenes = {scenes}
seed = 3
plugins = ["{plugin}"]
[scenario]
kind = "bowls"
[[solver]]
kind = "random-search"
batch = 10
[[solver]]
kind = "random-search"
batch = 20
[budget]
evaluations = 60
{limits}
[targets]
gap = [0.01]
"""
PROOF = "[reference]\ncertificate = true\n"
SWEEP = '[sweep]\nlift = [0.0, 1.0]\n"budget.evaluations" = [40, 80]\n'


@pytest.fixture
def study(tmp_path):
    """A function that writes a manifest with these formulations, and returns the study."""

    def write(*hows, scenes=3, extra=PROOF, limits=""):
        text = HEAD.format(scenes=scenes, plugin=PLUGINS / "proving.py", limits=limits)
        for how in hows:
            text += '[[formulation]]\nkind = "silent"\n' if how == "silent" else _table(how)
        path = tmp_path / "proofs.toml"
        path.write_text((text if "evaluations" not in extra else text.replace("evaluations = 60\n", "")) + extra)
        return load_study(path)

    return write


def _table(how):
    return f'[[formulation]]\nkind = "proving"\nhow = "{how}"\n'


@pytest.fixture
def calls(tmp_path, monkeypatch):
    """A function that returns how the proofs were called so far."""
    log = tmp_path / "proofs.log"
    monkeypatch.setenv("PROOF_LOG", str(log))
    return lambda: log.read_text().split() if log.exists() else []


def run(study, out, **options):
    return nfbench.run(study, out=out, **{"jobs": 0, **options})


def table(results):
    return results.references.drop(columns="seconds")


def test_each_optimum_is_proven_once_and_not_once_per_method_or_budget(study, tmp_path, calls):
    results = run(study("right", "silent", extra=SWEEP + PROOF), tmp_path / "out")
    found = results.references
    assert len(calls()) == len(found) == 3 * 2
    assert list(found.columns) == [
        *(
            "reference_id",
            "scenario.lift",
            "scene",
            "instance_seed",
            "formulation",
            "status",
            "message",
            "value",
            "gap",
        ),
        *("certified", "step", "seconds", "cuts", "x_0", "x_1"),
    ]
    assert set(found["formulation"]) == {"proving"} and found["certified"].all() and (found["cuts"] == 3).all()
    assert (found["gap"] == 0).all() and (found["step"] == 0).all() and (found["seconds"] >= 0).all()
    for row in found.itertuples():
        rng = np.random.default_rng(row.instance_seed)
        np.testing.assert_array_equal([row.x_0, row.x_1], rng.uniform(-0.9, 0.9, 2))
        assert row.value == rng.uniform(1.0, 2.0) + row._2
    runs = results.runs
    assert len(runs) == 3 * 2 * 2 * 2 * 2 and "optimum" not in runs
    assert results.meta["reference"] == '["proving"]'


def test_the_runs_are_the_same_with_and_without_proofs(study, tmp_path):
    plain, proven = (run(study("right", extra=extra), tmp_path / extra[:3]).runs for extra in ("", PROOF))
    pd.testing.assert_frame_equal(plain.drop(columns=TIMES), proven.drop(columns=TIMES), check_exact=True)


def test_a_study_that_has_been_run_without_proofs_only_adds_them(study, tmp_path, calls):
    before = run(study("right", extra=""), tmp_path / "out")
    runs = before.runs
    assert before.references.empty and not (tmp_path / "out" / "references.csv").exists() and not calls()
    after = run(study("right"), tmp_path / "out")
    pd.testing.assert_frame_equal(after.runs, runs, check_exact=True)  # with equal times: nothing was run again
    assert len(calls()) == 3 and len(pd.read_csv(tmp_path / "out" / "references.csv")) == 3
    run(study("right"), tmp_path / "out")
    assert len(calls()) == 3
    assert run(study("right", extra=""), tmp_path / "out").references.empty
    assert len(run(study("right", scenes=2), tmp_path / "out").references) == 2
    run(study("right", scenes=4), tmp_path / "out")
    assert len(calls()) == 4


def test_workers_give_the_same_table(study, tmp_path):
    here, there = (run(study("right", "open", extra=SWEEP + PROOF), tmp_path / str(jobs), jobs=jobs) for jobs in (0, 2))
    pd.testing.assert_frame_equal(table(here), table(there), check_exact=True)
    pd.testing.assert_frame_equal(here.runs.drop(columns=TIMES), there.runs.drop(columns=TIMES), check_exact=True)


def test_a_cluster_gives_the_same_table(study, tmp_path):
    pytest.importorskip("distributed")
    here = run(study("right", scenes=2), tmp_path / "here")
    there = run(study("right", scenes=2), tmp_path / "there", cluster="local:1")
    pd.testing.assert_frame_equal(table(here), table(there), check_exact=True)


def test_a_proof_that_crashes_or_hangs_costs_only_itself(study, tmp_path):
    hows = ("right", "crashes", "hangs", "raises", "none", "negative", "text")
    results = run(study(*hows, scenes=1, limits="run_timeout_s = 3.0"), tmp_path / "out", jobs=2)
    assert results.counts == {"ok": 14}
    found = results.references.set_index("formulation")
    expected = {
        "right": ("ok", ""),
        "crashes": ("crashed", "its process died: exit code 3"),
        "hangs": ("timeout", "stopped after run_timeout_s = 3 s"),
        "raises": ("failed", "RuntimeError: no proof today"),
        "none": ("skipped", "the formulation has no proof for this scene"),
        "negative": ("invalid", "reference: expected a gap >= 0, finite if it is certified, got -1.0"),
        "text": ("invalid", "reference: expected a Reference or None, got str"),
    }
    assert len(found) == len(expected)
    for how, (status, message) in expected.items():
        row = found.loc[f"proving(how={how})"]
        assert row["status"] == status and row["message"].startswith(message), how
        assert row["certified"] == (how == "right") and np.isnan(row["value"]) == (how != "right")
        assert row["gap"] == (0 if how == "right" else np.inf)
    failures = {label: status for status, label, _, _ in results.reference_failures}
    assert failures["proving(how=hangs)"] == "timeout" and len(failures) == 6
    assert "crashed: optimum of proving(how=crashes)" in (tmp_path / "out" / "study.log").read_text()


def test_failed_proofs_are_repeated_only_on_request(study, tmp_path, calls):
    run(study("raises"), tmp_path / "out")
    run(study("raises"), tmp_path / "out")
    assert len(calls()) == 3
    run(study("raises"), tmp_path / "out", retry=[Status.FAILED])
    assert len(calls()) == 6


def test_an_interrupted_study_keeps_its_proofs_and_makes_the_others(study, tmp_path, calls):
    class Stop:
        seen = 0

        def begin(self, total, done):
            assert (total, done) == (9, 0)

        def stopping(self): ...

        def finished(self, spec, record):
            self.seen += spec.asks == "reference"
            if self.seen == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(study("right"), tmp_path / "out", listener=Stop())
    results = nfbench.Results(tmp_path / "out")
    assert results.reference_counts == {"ok": 2, "open": 1} and results.counts == {"ok": 2, "open": 4}
    assert len(run(study("right"), tmp_path / "out").references) == 3 and len(calls()) == 3
    run(study("right"), tmp_path / "out", fresh=True)
    assert len(calls()) == 6


def test_a_killed_study_does_not_prove_again(study, tmp_path, calls):
    study("right", "hangs", scenes=1)
    command = [sys.executable, "-m", "nfbench", "run", "proofs.toml", "--out", "out", "--jobs", "1", "--quiet"]
    process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, env=os.environ)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and calls() != ["right", "hangs"]:
        time.sleep(0.05)
    time.sleep(0.3)  # the first proof is stored within milliseconds after its end
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    results = run(study("right", scenes=1), tmp_path / "out")
    assert calls() == ["right", "hangs"] and results.references["certified"].all()


def test_shards_share_the_proofs_and_are_merged(study, tmp_path, calls):
    whole = run(study("right", scenes=8), tmp_path / "whole")
    parts = [run(study("right", scenes=8), tmp_path / f"{k}", shard=(k, 2)) for k in (1, 2)]
    assert len(calls()) == 16 and sum(len(part.references) for part in parts) == 8
    assert set(parts[0].references["reference_id"]).isdisjoint(parts[1].references["reference_id"])
    merged = merge([part.folder for part in parts], tmp_path / "merged")
    pd.testing.assert_frame_equal(table(merged), table(whole), check_exact=True)
    assert (tmp_path / "merged" / "references.csv").exists()
    with sqlite3.connect(tmp_path / "whole" / "runs.sqlite") as db:
        db.execute("UPDATE reference_optima SET value = value - 1")
    with pytest.raises(nfbench.StoreError, match=r"its proven optimum \w+ \(ok, value .*\) differs"):
        merge([whole.folder, merged.folder], tmp_path / "both")


def test_the_table_of_the_manifest_is_strict(study):
    with pytest.raises(ManifestError, match=r"reference\.certificat: .*certificate"):
        study("right", extra="[reference]\ncertificat = true\n")
    with pytest.raises(ManifestError, match=r"reference\.certificate: "):
        study("right", extra='[reference]\ncertificate = "yes"\n')
    assert study("right", extra="[reference]\ncertificate = false\n").references == 0
    assert study("right", "silent").warnings == ("silent has no proof of its optimum, so its gaps are not certified",)


def test_the_command_reports_proofs_and_their_failures(study, tmp_path):
    study("right", scenes=2)
    command = [sys.executable, "-m", "nfbench", "run", "proofs.toml", "--out", "out", "--jobs", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "runs and proofs to do: 6" in done.stdout, done.stderr
    assert "Proven optima: 2 of 2." in done.stdout and "references.csv" in done.stdout
    study("raises", scenes=2)
    done = subprocess.run([*command, "--fresh"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert "failed × 2: optimum of proving: RuntimeError: no proof today" in done.stdout
    assert json.loads((tmp_path / "out" / "environment.json").read_text())["jobs"] == 1
