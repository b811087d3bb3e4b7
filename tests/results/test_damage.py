"""Whatever is wrong with a results folder, every command ends with a message that names the file and what to do.

Readable rows can be rescued from every damaged database, and no file of a folder is executed.
"""

import itertools
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
import time

import damage_kinds
import numpy as np
import pandas as pd
import pytest
from commands import command
from damage_kinds import KINDS, edited, flip, pickled, sql

import nfbench
from nfbench import StoreError, load_study
from nfbench.results import Store, merge
from nfbench.results.damage import Damaged

FLIPS = 1000
STUDY = """
[[formulation]]
kind = "once"
[[solver]]
kind = "sampler"
[[solver]]
kind = "raises"
[budget]
evaluations = 40
[sweep]
noise = [0.0, 0.5]
"""
REMEDIES = (
    "nfbench merge|nfbench run|--fresh|--out|--plugin|update nfbench|run the command again|fix that|report this|"
    "nothing to draw|no run has finished yet|no finished run can be exported|different studies"
)


@pytest.fixture(scope="module")
def made(tmp_path_factory, request):
    """The manifest and results folder of a small study, which no test changes."""
    folder = tmp_path_factory.mktemp("made")
    toy = request.config.rootpath / "tests" / "toy_plugins" / "toy.py"
    text = f'name = "toy"\nrepetitions = 8\nseed = 1\nplugins = ["{toy}"]\n[scenario]\nkind = "toy"\n{STUDY}'
    (folder / "toy.toml").write_text(text)
    nfbench.run(load_study(folder / "toy.toml"), out=folder / "good", jobs=0)
    return folder


@pytest.fixture
def damaged(made, tmp_path):
    """A function that copies the folder, damages it and returns the copy."""
    numbers = itertools.count()

    def copy(damage=lambda folder: None):
        folder = tmp_path / f"bad{next(numbers)}"
        shutil.copytree(made / "good", folder)
        damage(folder)
        return folder

    return copy


def commands(folder, made, out):
    """Every command that reads a results folder, by name."""
    return {
        "status": ("status", folder),
        "report": ("report", folder),
        "figure": ("figure", folder, "--out", out / "figures", "--format", "svg", "--traces"),
        "ioh": ("export", folder, "--to", "ioh", "--out", out / "ioh"),
        "csv": ("export", folder, "--to", "csv", "--out", out / "traces.csv"),
        "compare": ("compare", folder, made / "good"),
        "compared": ("compare", made / "good", folder),
        "merge": ("merge", folder, "--out", out / "merged"),
        "run": ("run", made / "toy.toml", "--out", folder, "--jobs", "0"),
    }


def check(code, text, folder):
    """The rules for the end of any command."""
    assert code in (0, 1, 2, 130), text
    assert "Traceback" not in text and "Warning" not in text, text
    if code == 2:
        assert str(folder) in text, text
        assert re.search(REMEDIES, text), text


def test_there_are_many_kinds_of_damage():
    assert len(KINDS) >= 45


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_command_ends_well_in_a_damaged_folder(kind, made, damaged, tmp_path, monkeypatch, capfd):
    for name in commands("", made, tmp_path):
        folder = damaged(KINDS[kind])
        arguments = commands(folder, made, tmp_path / f"out-{name}")[name]
        code, text = command(monkeypatch, capfd, *arguments)
        check(code, text, folder)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_every_command_ends_well_after_a_flipped_bit(part, made, damaged, tmp_path, monkeypatch, capfd):
    rng = np.random.default_rng(2026 + part)
    for number in range(FLIPS // 10):
        folder = damaged(lambda folder: flip(folder / "runs.sqlite", rng))
        out = tmp_path / f"out{number}"
        for name in ("status", "report", "ioh", "csv", "compare", "merge"):
            check(*command(monkeypatch, capfd, *commands(folder, made, out)[name]), folder)
        shutil.rmtree(folder)
        shutil.rmtree(out, ignore_errors=True)


SAID = {  # kind of damage → what the report says
    "text file": "runs.sqlite is damaged (file is not a database); `nfbench merge",
    "database is a pipe": "found a device or pipe of that name; move it away",
    "meta lacks error": "the table meta lacks error; `nfbench run STUDY.toml --out",
    "newer schema": "expected schema 4, found 99; a newer nfbench wrote it: update nfbench",
    "schema is a word": "expected a number as the schema, found 'two'",
    "endless view": "expected tables only, found the view 'plan'",
    "a score is a word": "column scores: could not convert string to float: 'good'",
    "scores are a list": "column scores: expected the scores as a table, found '[1, 2]'",
    "text that is not UTF-8": "Could not decode to UTF-8",
    "unknown status": "column status: 'fine' is not a valid Status",
    "swept is nested deeply": "the table plan has changed since it was written; `nfbench run STUDY.toml --out",
    "a score is a huge integer": "OverflowError",
    "plan emptied": "the table plan has changed since it was written",
    "a repetition twice": "the table plan has changed since it was written",
    "results.message is a blob": "column message: expected text, found b'\\x00\\xff'",
}


@pytest.mark.parametrize("kind", SAID)
def test_the_message_names_the_file_the_damage_and_the_remedy(kind, made, damaged, tmp_path, monkeypatch, capfd):
    folder = damaged(KINDS[kind])
    code, text = command(monkeypatch, capfd, "report", folder)
    check(code, text, folder)
    assert code == 2 and SAID[kind] in text, text
    assert "cannot be processed" not in text  # which would mean that no check has foreseen it


@pytest.mark.parametrize(
    "kind", [kind for kind in KINDS if kind.startswith("traces")]
)  # of which reports and statuses read nothing
def test_damaged_traces_are_told_when_they_are_read(kind, made, damaged, tmp_path, monkeypatch, capfd):
    folder = damaged(KINDS[kind])
    assert command(monkeypatch, capfd, "report", folder)[0] == 0
    for name in ("csv", "ioh"):
        code, text = command(monkeypatch, capfd, *commands(folder, made, tmp_path)[name])
        check(code, text, folder)
        assert code == 2 and "column traces: " in text and "`nfbench merge" in text
    assert not (tmp_path / "traces.csv").exists() and not (tmp_path / "ioh").exists()


def test_no_traces_are_unpickled(damaged, tmp_path):
    proof = tmp_path / "executed"
    folder = damaged(pickled(f"open({str(proof)!r}, 'w').close()"))
    with pytest.raises(Damaged, match="pickle"):
        nfbench.Results(folder).traces  # noqa: B018
    merge([folder], tmp_path / "merged")
    assert not proof.exists()


# --- rescue ----------------------------------------------------------------------------------------------------------

TIMES = ["runtime_s", "cpu_s", "evaluation_s"]


def rescued(folder, out):
    """What merge says of a damaged folder, and the runs that it keeps."""
    said = []
    return said, merge([folder], out, said.append).runs


@pytest.mark.parametrize(
    "kind", ["header zeroed", "first page overwritten", "log is garbage", "trigger", "endless view"]
)
def test_every_run_is_rescued_if_no_page_with_rows_is_damaged(kind, made, damaged, tmp_path):
    _, runs = rescued(damaged(KINDS[kind]), tmp_path / "new")
    pd.testing.assert_frame_equal(runs, nfbench.Results(made / "good").runs)
    traces = nfbench.Results(tmp_path / "new").traces
    pd.testing.assert_frame_equal(traces, nfbench.Results(made / "good").traces)


def test_a_damaged_page_costs_its_rows_only_and_run_repeats_them(made, damaged, tmp_path):
    good = nfbench.Results(made / "good")
    pages = (made / "good" / "runs.sqlite").stat().st_size // 4096
    root = 5  # of the results, where most other pages hang
    for page in (root, pages):
        folder = damaged(damage_kinds.overwritten((page - 1) * 4096))
        said, runs = rescued(folder, tmp_path / f"new{page}")
        assert len(said) == 1 and f"{folder}/runs.sqlite is damaged" in said[0]
        assert 16 < len(runs) <= 32 and f"{len(runs)} results were read and are kept" in said[0]
        lost = 32 - len(runs)
        assert (f"{lost} or more are lost" in said[0]) == bool(lost)
        assert set(runs.run_id) <= set(good.runs.run_id)
        again = nfbench.run(load_study(made / "toy.toml"), out=tmp_path / f"new{page}", jobs=0)
        pd.testing.assert_frame_equal(again.runs.drop(columns=TIMES), good.runs.drop(columns=TIMES))


@pytest.mark.parametrize("part", range(3))
def test_after_a_flipped_bit_few_runs_are_lost(part, made, damaged, tmp_path):
    rng = np.random.default_rng(part)
    good = nfbench.Results(made / "good").runs.set_index("run_id")
    for number in range(20):
        folder = damaged(lambda folder: flip(folder / "runs.sqlite", rng))
        merge([folder], tmp_path / f"new{number}")
        with Store(tmp_path / f"new{number}") as store:
            kept = {row[0]: row for row in store.result_rows()}
        assert len(set(kept) & set(good.index)) >= 26  # of 32; a page of the table holds about six


def test_lost_and_blanked_rows_are_counted(made, damaged, tmp_path):
    folder = damaged(
        sql(
            "UPDATE results SET scores = '[' WHERE run_id IN (SELECT run_id FROM plan WHERE ordinal IN (3, 4))",
            "UPDATE results SET traces = x'00' WHERE run_id IN (SELECT run_id FROM plan WHERE ordinal < 3)",
        )
    )
    said, runs = rescued(folder, tmp_path / "new")
    assert "30 results were read and are kept, 2 or more are lost, 3 lack their message, times or traces" in said[0]
    good = nfbench.Results(made / "good").runs
    left = good.drop(index=[3, 4]).reset_index(drop=True)
    pd.testing.assert_frame_equal(runs.drop(columns="message"), left.drop(columns="message"))


def test_of_two_results_of_a_run_the_last_is_rescued(made, damaged, tmp_path):
    folder = damaged()
    first = nfbench.Results(folder).runs.run_id[0]
    with sqlite3.connect(folder / "runs.sqlite") as db:  # leaves the old row in a free page, or is checked in place
        db.execute("UPDATE results SET objective = 77, finished = finished + 100 WHERE run_id = ?", [first])
    edited(lambda content: content.__setitem__(slice(0, 100), bytes(100)))(folder)
    _, runs = rescued(folder, tmp_path / "new")
    assert runs.set_index("run_id").objective[first] == 77


def test_rows_of_the_log_are_rescued_too(made, tmp_path):
    """A process that is killed leaves its last rows in the write-ahead log."""
    folder = tmp_path / "killed"
    code = (
        "import os, sys, nfbench\n"
        "from nfbench.results import Store\n"
        "from pathlib import Path\n"
        f"study = nfbench.load_study({str(made / 'toy.toml')!r})\n"
        f"folder = Path({str(folder)!r}); folder.mkdir()\n"
        "store = Store(folder, write=True); store.begin(study)\n"
        "from nfbench.study import RunRecord\n"
        "store.add(RunRecord(s.run_id, nfbench.Status.OK, scores={'rmse_m': 1.0}) for s in study.specs())\n"
        "os._exit(9)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    assert (folder / "runs.sqlite-wal").stat().st_size > 0
    damage_kinds.overwritten(0, 10**6)(folder)
    damage_kinds.edited(lambda log: log.__setitem__(32 + 24 + 200, log[256] ^ 1), "runs.sqlite-wal")(folder)
    with pytest.raises(Damaged):  # SQLite does without a log in which the first checksum is wrong
        nfbench.Results(folder).runs  # noqa: B018
    _, runs = rescued(folder, tmp_path / "new")
    assert len(runs) == 32 and (runs.rmse_m == 1.0).all()


def test_what_cannot_be_read_at_all_is_refused_and_nothing_is_written(damaged, tmp_path, monkeypatch, capfd):
    folder = damaged(KINDS["text file"])
    code, text = command(monkeypatch, capfd, "merge", folder, "--out", tmp_path / "deep" / "new")
    assert code == 2 and "no run can be read; `nfbench run STUDY.toml --fresh` moves the folder aside" in text
    assert not (tmp_path / "deep").exists()


def test_the_command_rescues_with_exit_code_1(made, damaged, tmp_path, monkeypatch, capfd):
    folder = damaged(KINDS["header zeroed"])
    code, text = command(monkeypatch, capfd, "merge", folder, "--out", tmp_path / "new")
    assert code == 1 and f"{tmp_path}/new: 32 of 32 runs done, merged from 1 folder" in text
    assert "32 results were read and are kept, none is known to be lost" in text


def test_a_plan_that_was_changed_is_written_again_by_run(made, damaged):
    good = nfbench.Results(made / "good").runs
    for damage in (
        "UPDATE plan SET method = 'x' WHERE ordinal = 1",
        "UPDATE plan SET ordinal = 10000 WHERE ordinal = 31",
        "DELETE FROM plan WHERE ordinal = 7",
    ):
        folder = damaged(sql(damage))
        with pytest.raises(StoreError, match="the table plan has changed"):
            nfbench.Results(folder).runs  # noqa: B018
        again = nfbench.run(load_study(made / "toy.toml"), out=folder, jobs=0)
        pd.testing.assert_frame_equal(again.runs, good)


# --- locks -----------------------------------------------------------------------------------------------------------


def held(folder):
    """Lock the database as another program would."""
    db = sqlite3.connect(folder / "runs.sqlite", isolation_level=None)
    db.execute("BEGIN EXCLUSIVE")
    return db


def test_a_reader_waits_for_a_locked_file_says_so_and_gives_up(damaged, monkeypatch, capfd, caplog):
    folder = damaged()
    other = held(folder)
    start = time.monotonic()
    code, text = command(monkeypatch, capfd, "status", folder)
    assert code == 2 and "has been locked by another program for" in text and "close that program" in text
    assert 5 < time.monotonic() - start < 10
    assert f"{folder}/runs.sqlite is locked by another program; waiting for at most 6 s" in caplog.text
    other.execute("ROLLBACK")
    assert command(monkeypatch, capfd, "status", folder)[0] == 0


def test_a_study_waits_longer_than_a_reader_and_goes_on(made, damaged, monkeypatch, caplog):
    folder = damaged(sql("DELETE FROM results"))
    monkeypatch.setattr("nfbench.results.damage.TOLD_AFTER_S", 0.1)
    monkeypatch.setattr("nfbench.results.store._ATTEMPT_S", 0.1)
    other = sqlite3.connect(folder / "runs.sqlite", isolation_level=None, check_same_thread=False)
    other.execute("BEGIN EXCLUSIVE")
    threading.Timer(1.5, other.execute, ["ROLLBACK"]).start()
    results = nfbench.run(load_study(made / "toy.toml"), out=folder, jobs=0)
    assert results.counts == {"ok": 16, "failed": 16}
    assert "waiting for at most 600 s" in caplog.text


def test_the_wait_of_a_study_ends_and_its_rows_are_kept(made, damaged, monkeypatch):
    folder = damaged()
    monkeypatch.setattr("nfbench.results.store.WRITE_WAIT_S", 0.5)
    monkeypatch.setattr("nfbench.results.store._ATTEMPT_S", 0.1)
    with Store(folder, write=True) as store:
        other = sqlite3.connect(folder / "runs.sqlite", isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreError, match=r"runs\.sqlite has been locked .* rows written earlier are kept"):
            store.forget(["ok"])
        other.execute("ROLLBACK")
        store.forget(["failed"])
        assert store.counts() == {"ok": 16, "open": 16}
