"""Merged shards give the whole table; contradicting folders are refused; the comparison finds differences."""

import json
import shutil
import sqlite3

import numpy as np
import pandas as pd
import pytest
from commands import command
from conftest import BASIC

import nfbench
from nfbench import StoreError, load_study
from nfbench.results.comparison import compare
from nfbench.results.merging import merge

SWEPT = BASIC + '[[formulation]]\nkind = "oracle"\n[sweep]\ndimension = [2, 3]\n'
TIMES = ["runtime_s", "cpu_s", "evaluation_s"]


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
            merge([tmp_path / "a", tmp_path / other], tmp_path / "new" / f"out-{other}")
        assert not (tmp_path / "new").exists()


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


def test_compare_notices_a_significant_change_of_an_error(manifest, tmp_path):
    one = run(manifest(BASIC, repetitions=8), tmp_path / "a")
    other = run(manifest(BASIC.replace("= 40", "= 4000"), repetitions=8), tmp_path / "b")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert found.matters and list(found.methods.changed) == [True]
    assert found.methods.rmse_m_first[0] == one.summary().median_m[0] > other.summary().median_m[0]
    assert found.methods.p[0] == 2 ** (1 - 8) and found.methods.high[0] < 1


def test_two_of_three_shards_leave_the_runs_of_the_third_open(manifest, tmp_path, monkeypatch, capfd):
    path = manifest(SWEPT, repetitions=10)
    whole = run(path, tmp_path / "whole").runs
    parts = {k: run(path, tmp_path / f"{k}", shard=(k, 3)).runs for k in (1, 2, 3)}
    done = len(parts[1]) + len(parts[3])
    arguments = ("merge", tmp_path / "1", tmp_path / "3", "--out", tmp_path / "merged")
    code, text = command(monkeypatch, capfd, *arguments)
    assert code == 0 and f"merged: {done} of 40 runs done, merged from 2 folders\nmissing shards: 2/3\n" in text
    merged = nfbench.Results(tmp_path / "merged")
    assert merged.counts["open"] == len(parts[2]) and sum(merged.counts.values()) == 40
    assert f"Unfinished study: {done} of 40 runs are done" in command(monkeypatch, capfd, "report", merged.folder)[1]
    assert f"{done} of 40 runs done" in command(monkeypatch, capfd, "status", merged.folder)[1]
    command(monkeypatch, capfd, "merge", tmp_path / "2", "--out", merged.folder)
    pd.testing.assert_frame_equal(merged.runs.drop(columns=TIMES), whole.drop(columns=TIMES))
    assert "open" not in merged.counts


def test_a_merged_part_is_completed_by_run(manifest, tmp_path):
    path = manifest(SWEPT, repetitions=4)
    whole = run(path, tmp_path / "whole").runs
    run(path, tmp_path / "1", shard=(1, 3))
    merge([tmp_path / "1"], tmp_path / "merged")
    completed = run(path, tmp_path / "merged")
    pd.testing.assert_frame_equal(completed.runs.drop(columns=TIMES), whole.drop(columns=TIMES))
    assert "open" not in completed.counts


def test_a_shard_counts_only_its_own_runs(manifest, tmp_path):
    results = run(manifest(SWEPT, repetitions=4), tmp_path / "1", shard=(1, 3))
    assert "open" not in results.counts and sum(results.counts.values()) < 16


def test_a_refused_merge_changes_nothing(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "a")
    run(manifest(BASIC, seed=2), tmp_path / "other")
    (tmp_path / "file").write_text("")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("")

    def content(path):
        if path.suffix != ".sqlite":
            return path.read_bytes()
        with sqlite3.connect(path) as db:
            return list(db.iterdump())

    def everything():
        return {path: content(path) for path in tmp_path.rglob("*") if path.is_file()}

    before = everything()
    for folders, out, text in (
        (["a", "other"], "new", "its seed is '2'"),
        (["other"], "a", "its seed is '2'"),
        (["a", "nowhere"], "deep/new", "nowhere: expected a results folder"),
        (["a"], "mine", "expected a new folder or one with results of the same study, found a folder with notes.txt"),
        (["a"], "file", "Not a directory"),
        (["a"], "file/new", "Not a directory"),
    ):
        with pytest.raises(StoreError, match=text):
            merge([tmp_path / folder for folder in folders], tmp_path / out)
        assert everything() == before and not (tmp_path / "new").exists() and not (tmp_path / "deep").exists()
    merge([tmp_path / "a"], tmp_path / "a")  # itself
    assert nfbench.Results(tmp_path / "a").counts == {"ok": 3}


def test_side_files_that_cannot_be_read_stop_no_merge(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "a")
    (tmp_path / "a" / "environment.json").write_bytes(b"\xff")
    (tmp_path / "a" / "manifest.toml").write_bytes(b"\xff")
    merge([tmp_path / "a"], tmp_path / "new")
    found = json.loads((tmp_path / "new" / "environment.json").read_text())
    assert found == {"merged": [{"unreadable": "environment.json: UnicodeDecodeError"}]}
    assert (tmp_path / "new" / "manifest.toml").read_bytes() == b"\xff"


def test_different_studies_are_not_compared(manifest, tmp_path):
    run(manifest(BASIC), tmp_path / "a")
    run(manifest(BASIC, name="other"), tmp_path / "name")
    run(manifest(BASIC, seed=2), tmp_path / "seed")
    run(manifest(BASIC + "[sweep]\nnoise = [0.0, 0.5]\n"), tmp_path / "sweep")
    for other, text in (
        ("name", "different studies: name 'toy' and 'other'"),
        ("seed", "different studies: seed '1' and '2'"),
        ("sweep", "only the second sweeps scenario.noise"),
    ):
        with pytest.raises(StoreError, match=text):
            compare(tmp_path / "a", tmp_path / other)
    with pytest.raises(StoreError, match=r"only the first sweeps scenario\.noise"):
        compare(tmp_path / "sweep", tmp_path / "a")


def test_compare_notes_another_manifest_and_other_scenes(manifest, tmp_path):
    run(manifest(BASIC, repetitions=8), tmp_path / "a")
    run(manifest(BASIC.replace("= 40", "= 41"), repetitions=8), tmp_path / "budget")
    run(manifest(BASIC, repetitions=8, scenario="noise = 0.5"), tmp_path / "scene")
    assert compare(tmp_path / "a", tmp_path / "a").notes == ()
    planned = "The folders plan different runs: their manifests or the versions of plugins differ."
    assert compare(tmp_path / "a", tmp_path / "budget").notes == (planned,)
    scenes = "The scenes differ: an option of the scenario has changed."
    assert compare(tmp_path / "a", tmp_path / "scene").notes == (planned, scenes)


def test_compare_says_when_it_cannot_judge(manifest, tmp_path, monkeypatch, capfd):
    run(manifest(BASIC, repetitions=5), tmp_path / "a")  # too few for a test
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    code, text = command(monkeypatch, capfd, "compare", tmp_path / "a", tmp_path / "b")
    assert code == 0 and "The folders agree." in text
    change(tmp_path / "b", "UPDATE results SET objective = objective * 2")
    code, text = command(monkeypatch, capfd, "compare", tmp_path / "a", tmp_path / "b")
    assert code == 0 and "does not matter" in text  # the errors are equal, which needs no interval
    change(tmp_path / "b", """UPDATE results SET scores = '{"rmse_m": "0.5"}'""")
    code, text = command(monkeypatch, capfd, "compare", tmp_path / "a", tmp_path / "b")
    assert code == 1 and "does not matter" not in text
    assert (
        "cannot be judged: at least 6 scenes with errors of at least 0 are needed, and there are fewer for once + "
        in text
    )
    change(tmp_path / "b", "DELETE FROM results")
    change(tmp_path / "a", "DELETE FROM results")
    code, text = command(monkeypatch, capfd, "compare", tmp_path / "a", tmp_path / "b")
    assert code == 1 and "No run is in both folders, so nothing can be judged." in text


def test_numbers_and_text_of_one_key_are_compared(manifest, tmp_path):
    path = manifest(BASIC + "[sweep]\nnoise = [0.0, 0.5]\n")
    run(path, tmp_path / "a"), run(path, tmp_path / "b")
    change(tmp_path / "b", 'UPDATE plan SET swept = \'{"noise": "much"}\' WHERE swept = \'{"noise": 0.5}\'')
    change(tmp_path / "b", "DELETE FROM meta WHERE key = 'plan_rows'")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert (found.equal, found.only_first, found.only_second) == (3, 3, 3)


def test_errors_below_0_are_kept_and_said_not_to_be_ranked(manifest, tmp_path, monkeypatch, capfd):
    """A score in decibels, for example, has no ratios; the runs and their summary are written all the same."""
    for name in "ab":
        results = run(manifest(BASIC, repetitions=8), tmp_path / name)
        factor = {"a": "-1.0", "b": "-2.0"}[name]
        change(tmp_path / name, f"""UPDATE results SET scores = '{{"rmse_m": "{factor}"}}'""")
        results.write_tables()
    assert results.ranking().frame.empty and (results.runs["rmse_m"] == -2.0).all()
    code, text = command(monkeypatch, capfd, "report", tmp_path / "b")
    assert code == 0 and "Methods are not ranked: rmse_m must be at least 0" in text and "once + sampler" in text
    code, text = command(monkeypatch, capfd, "compare", tmp_path / "a", tmp_path / "b")
    assert code == 1 and "cannot be judged: at least 6 scenes with errors of at least 0 are needed" in text
