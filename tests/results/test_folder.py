"""``--fresh`` moves only results folders aside, and what a killed process leaves is removed by the next one."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import command
from conftest import BASIC
from filelock import FileLock

import nfbench
from nfbench import StoreError, load_study
from nfbench.results import locked, prepare
from nfbench.results.folder import whole_folder

DEAD = 2**22 + 7  # above the largest process number of Linux


@pytest.fixture
def out(manifest, tmp_path):
    nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)
    return tmp_path / "out"


@pytest.mark.parametrize("place", [".", "/", "~", "..", "../..", "notes", "mixed", "photos"])
def test_fresh_moves_nothing_but_results(place, manifest, tmp_path, monkeypatch, capfd):
    path = manifest(BASIC)
    here = tmp_path / "home" / "here"
    for folder, name in (("notes", "todo.txt"), ("mixed", "thesis.tex"), ("photos", "cat.png")):
        (here / folder).mkdir(parents=True)
        (here / folder / name).write_text("mine")
    (here / "mixed" / "runs.sqlite").write_text("")
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    place = place.replace("~", str(tmp_path / "home"))
    before = sorted(tmp_path.rglob("*"))
    code, text = command(monkeypatch, capfd, "run", path, "--fresh", "--out", place, "--jobs", "0")
    assert code == 2 and text.startswith("nfbench: --fresh: ") and "--out" in text, text
    assert sorted(tmp_path.rglob("*")) == before


def test_fresh_moves_a_results_folder_whatever_is_damaged_in_it(out, manifest, tmp_path):
    for number, name in enumerate(("runs.sqlite", "runs.csv", "study.log")):
        (out / name).unlink()
        (out / name).mkdir()
        (out / "error.svg").write_text("")
        nfbench.run(load_study(manifest(BASIC)), out=out, jobs=0, fresh=True)
        assert nfbench.Results(out).counts == {"ok": 3}
        assert len(list(tmp_path.glob("out.2*"))) == number + 1


def test_fresh_folders_of_one_second_keep_distinct_names(tmp_path):
    for _ in range(4):
        prepare(tmp_path / "new", fresh=True)
        (tmp_path / "new" / "runs.csv").write_text("")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) == 4 and all(re.fullmatch(r"new(\.\d{8}-\d{6}(-\d)?)?", name) for name in names)


def test_leftovers_of_dead_processes_are_removed_and_nothing_else(out, manifest):
    dead = [f".runs.csv.{DEAD}", f".summary.csv.{DEAD}", f".manifest.toml.{DEAD}", f".error.svg.{DEAD}", ".lock"]
    kept = [f".runs.csv.{os.getppid()}", f".mine.{DEAD}", "error.svg", ".runs.csv", ".runs.csv.x"]
    for name in dead + kept:
        (out / name).write_text("left")
    (out / f".export-ioh.{DEAD}" / "algorithm").mkdir(parents=True)
    nfbench.run(load_study(manifest(BASIC)), out=out, jobs=0)
    names = {path.name for path in out.iterdir()}
    assert names >= set(kept) and not names & {*dead, f".export-ioh.{DEAD}"}


def test_what_a_killed_study_leaves_is_gone_after_the_next(manifest, tmp_path):
    path = manifest(BASIC + '[[solver]]\nkind = "sleeps"\n')
    command_ = [sys.executable, "-m", "nfbench", "run", str(path), "--out", "out", "--jobs", "1"]
    process = subprocess.Popen(command_, cwd=tmp_path, start_new_session=True, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (tmp_path / "out" / "runs.sqlite-wal").exists():
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert (tmp_path / "out" / ".lock").exists()
    (tmp_path / "out" / f".runs.csv.{process.pid}").write_text("half a table")
    nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "runs.sqlite", "runs.csv", "summary.csv", "targets.csv", "ranking.csv", "hits.npz", "manifest.toml",
        "environment.json", "study.log",
    }  # fmt: skip


def test_only_one_holds_the_lock_although_its_file_is_removed(tmp_path):
    first = locked(tmp_path)
    with pytest.raises(StoreError, match="another nfbench process is writing to this folder"):
        locked(tmp_path)
    first.release()
    assert not (tmp_path / ".lock").exists()
    second = locked(tmp_path)
    (tmp_path / ".lock").unlink()  # as a process would that held the lock before
    third = locked(tmp_path)
    second.release()
    assert (tmp_path / ".lock").exists()  # that of the third
    with pytest.raises(StoreError):
        locked(tmp_path)
    third.release()


def test_a_lock_on_a_file_that_was_removed_meanwhile_is_taken_again(tmp_path, monkeypatch):
    real, taken = FileLock.acquire, []

    def acquire(lock, *arguments, **options):
        found = real(lock, *arguments, **options)
        taken.append(lock)
        if len(taken) == 1:
            (tmp_path / ".lock").unlink()  # by the holder before, between our opening and locking the file
        return found

    monkeypatch.setattr(FileLock, "acquire", acquire)
    first = locked(tmp_path)
    assert len(taken) == 2 and (tmp_path / ".lock").exists()
    with pytest.raises(StoreError, match="another nfbench process"):
        locked(tmp_path)
    first.release()


@pytest.mark.parametrize("name", ["manifest.toml", "environment.json", "study.log"])
def test_a_pipe_or_folder_in_place_of_a_file_is_named(name, manifest, tmp_path):
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out" / name)
    with pytest.raises(StoreError, match=rf"{name}: expected a file, found a device or named pipe; move it away"):
        nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)
    (tmp_path / "out" / name).unlink()
    (tmp_path / "out" / name).mkdir()
    with pytest.raises(StoreError, match=rf"{name}: expected a file, found a folder"):
        nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)


def test_a_folder_that_is_not_finished_leaves_nothing(tmp_path):
    (tmp_path / f".new.{os.getpid()}").mkdir()  # of a killed process with our number
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / "new") as draft:
        (draft / "file").write_text("")
        raise KeyboardInterrupt
    with pytest.raises(ZeroDivisionError), whole_folder(tmp_path / "a" / "b" / "new"):
        raise ZeroDivisionError
    assert list(Path(tmp_path).iterdir()) == []
    with whole_folder(tmp_path / "a" / "b" / "new") as draft:
        (draft / "file").write_text("")
    assert (tmp_path / "a" / "b" / "new" / "file").exists()
