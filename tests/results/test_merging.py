"""Merged shards give the whole table; contradicting folders are refused; the comparison finds differences."""

import shutil
import sqlite3

import numpy as np
import pandas as pd
import pytest
from conftest import BASIC

import nfbench
from nfbench import StoreError, load_study
from nfbench.results.comparison import compare
from nfbench.results.merging import merge

SWEPT = BASIC + '[[formulation]]\nkind = "oracle"\n[sweep]\ndimension = [2, 3]\n'
TIMES = ["runtime_s", "cpu_s"]


def run(path, out, **options):
    return nfbench.run(load_study(path), out=out, jobs=0, **options)


def change(folder, sql):
    with sqlite3.connect(folder / "runs.sqlite") as db:
        db.execute(sql)


def test_three_shards_merged_equal_the_whole(manifest, tmp_path):
    path = manifest(SWEPT, repetitions=10)
    whole = run(path, tmp_path / "whole").runs
    parts = [run(path, tmp_path / f"{k}", shard=(k, 3)).runs for k in (1, 2, 3)]
    assert sum(map(len, parts)) == len(whole) == 40 and all(5 < len(part) < 25 for part in parts)
    merged = merge([tmp_path / f"{k}" for k in (1, 2, 3)], tmp_path / "merged")
    pd.testing.assert_frame_equal(merged.runs.drop(columns=TIMES), whole.drop(columns=TIMES), check_exact=True)
    assert (tmp_path / "merged" / "manifest.toml").read_text() == path.read_text()
    again = merge([tmp_path / "2"], tmp_path / "merged")  # merging a folder again changes nothing
    pd.testing.assert_frame_equal(again.runs, merged.runs, check_exact=True)


def test_a_shard_keeps_its_runs_when_a_study_grows(manifest, tmp_path):
    before = run(manifest(BASIC, repetitions=20), tmp_path / "a", shard=(2, 4)).runs
    after = run(manifest(SWEPT.replace("[2, 3]", "[2, 4]"), repetitions=30), tmp_path / "b", shard=(2, 4)).runs
    assert set(before.run_id) <= set(after.run_id)


def test_a_folder_of_another_shard_is_refused(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "out", shard=(1, 2))
    with pytest.raises(StoreError, match="expected shard = '2/2', found '1/2'"):
        run(manifest(BASIC), tmp_path / "out", shard=(2, 2))


def test_contradicting_folders_are_not_merged(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "a")
    run(manifest(BASIC, seed=2), tmp_path / "seed")
    run(manifest(BASIC.replace("= 40", "= 41")), tmp_path / "budget")
    shutil.copytree(tmp_path / "a", tmp_path / "changed")
    change(tmp_path / "changed", "UPDATE results SET objective = objective + 1")
    for other, text in (
        ("seed", "its seed is '2', but that of the previous folders is '1'"),
        ("budget", "its manifest or a plugin version differs from that of the previous folders"),
        ("changed", "its result of run .* differs from that in the previous folders"),
    ):
        with pytest.raises(StoreError, match=text):
            merge([tmp_path / "a", tmp_path / other], tmp_path / f"out-{other}")
        assert nfbench.Results(tmp_path / f"out-{other}").counts == {"ok": 3}


def test_compare_counts_equal_runs_and_shows_the_others(manifest, tmp_path):
    run(manifest(BASIC, repetitions=8), tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    same = compare(tmp_path / "a", tmp_path / "b")
    assert (same.equal, same.rounding, len(same.rows), same.matters) == (8, 0, 0, False)
    ids = nfbench.Results(tmp_path / "a").runs.run_id
    change(tmp_path / "b", f"UPDATE results SET objective = objective * (1 + 1e-12) WHERE run_id = '{ids[0]}'")
    change(tmp_path / "b", f"UPDATE results SET objective = objective * 1.5 WHERE run_id = '{ids[1]}'")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert (found.equal, found.rounding, len(found.rows)) == (6, 1, 1)
    assert found.rows.change.iloc[0] == pytest.approx(1 / 3) and found.rows.repetition.iloc[0] == 1
    assert not found.matters  # the error is unchanged
    change(tmp_path / "b", f"UPDATE results SET status = 'failed' WHERE run_id = '{ids[2]}'")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert found.matters and np.isinf(found.rows.change.max())
    change(tmp_path / "b", f"DELETE FROM results WHERE run_id = '{ids[3]}'")
    assert compare(tmp_path / "a", tmp_path / "b").only_first == 1


def test_compare_notices_an_error_outside_its_interval(manifest, tmp_path):
    one = run(manifest(BASIC, repetitions=8), tmp_path / "a")
    other = run(manifest(BASIC.replace("= 40", "= 4000"), repetitions=8), tmp_path / "b")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert found.matters and list(found.methods.outside) == [True]
    assert found.methods.rmse_m_first[0] == one.summary().rmse_m[0] > other.summary().rmse_m[0]
