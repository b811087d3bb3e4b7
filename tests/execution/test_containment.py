"""Tests that what a plugin does costs its own rows and no others, and leaves nothing behind."""

import fcntl
import os
import shutil
import sqlite3
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pandas as pd
import pytest
from conftest import BASIC, PLUGINS, nfbench

import nfbench as library
from nfbench import load_study
from nfbench.execution import scratch
from nfbench.execution.scratch import PREFIX, ScratchFolder, _remove_abandoned
from nfbench.plugins.containment import Containment

HOSTILE = PLUGINS / "hostile.py"


@pytest.fixture(autouse=True)
def toy_is_importable(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(PLUGINS))
    monkeypatch.syspath_prepend(str(PLUGINS))


def solver(kind, **options):
    lines = "".join(f'{name} = "{value}"\n' for name, value in options.items())
    return f'[[solver]]\nkind = "{kind}"\n{lines}'


def processes_in(marker):
    """Processes whose environment holds a marker."""
    found = []
    for path in Path("/proc").iterdir():
        try:
            if path.name.isdigit() and marker.encode() in (path / "environ").read_bytes():
                found.append(int(path.name))
        except OSError:
            continue
    ours = [pid for pid in found if pid != os.getpid()]
    return [pid for pid in ours if b"resource_tracker" not in Path(f"/proc/{pid}/cmdline").read_bytes()]


SOLVERS = {
    ("raises-what", "what", "surrogate"): ("failed", "ValueError: lone ? surrogate"),
    ("raises-what", "what", "control"): ("failed", r"ValueError: \x1b[31mred\x1b[0m over written\x00\u202e"),
    ("raises-what", "what", "long"): ("failed", "ValueError: λλλ"),
    ("raises-what", "what", "unreadable"): ("failed", "Unreadable: (its message cannot be read)"),
    ("raises-what", "what", "interrupt"): ("failed", "KeyboardInterrupt"),
    ("raises-what", "what", "generator-exit"): ("failed", "GeneratorExit"),
    ("raises-what", "what", "exit"): ("failed", "SystemExit: 0"),
    ("raises-what", "what", "budget"): ("skipped", "(its message cannot be read)"),
    ("dies", "how", "segfault"): ("crashed", "its process died: signal 11 (SIGSEGV)"),
    ("dies", "how", "kill"): ("crashed", "its process died: signal 9 (SIGKILL)"),
    ("dies", "how", "real-time"): ("crashed", "its process died: signal 40 (SIGRTMIN+6)"),
    ("dies", "how", "exit-0"): ("crashed", "its process died: exit code 0"),
    ("dies", "how", "abort"): ("crashed", "its process died: signal 6 (SIGABRT)"),
    ("dies", "how", "hup"): ("crashed", "its process died: signal 1 (SIGHUP)"),
    ("forks", "then", "both"): ("ok", ""),
    ("forks", "then", "sleeper"): ("ok", ""),
    ("forks", "then", "sleeper-and-segfault"): ("crashed", "its process died: signal 11 (SIGSEGV)"),
    ("forks", "then", "double"): ("ok", ""),
    **{
        ("changes", "what", what): ("ok", "")
        for what in (
            *("stdout", "stderr", "low-descriptors", "directory", "files-limit", "size-limit", "numpy", "math"),
            *("signals", "subprocess", "terminates-itself", "interrupts-itself"),
        )
    },
    ("cheats", "what", "limit"): ("invalid", "expected at most 40 evaluations, got "),
    ("cheats", "what", "best-value"): ("invalid", "expected the best value "),
    ("cheats", "what", "public-best-value"): ("failed", "AttributeError"),
    ("cheats", "what", "count"): ("invalid", "expected at least 1 evaluations, got 0"),
    ("cheats", "what", "public-count"): ("failed", "AttributeError"),
    ("warm-up-raises",): ("failed", "RuntimeError: cold"),
    ("warm-up-exits",): ("failed", "SystemExit: 3"),
    ("validate-raises",): ("failed", "solver validate-raises cannot be made: RuntimeError: never valid"),
    ("parallel",): ("ok", ""),
}


@pytest.mark.parametrize("scenes", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_each_hostile_solver_costs_its_own_rows_and_leaves_no_process(manifest, tmp_path, monkeypatch, scenes):
    marker = f"NFBENCH_TEST={tmp_path}"
    monkeypatch.setenv("NFBENCH_TEST", str(tmp_path))
    good = library.run(load_study(manifest(BASIC, repetitions=scenes)), out=tmp_path / "good", jobs=1)
    tables = [solver(kind, **({option[0]: option[1]} if option else {})) for kind, *option in SOLVERS]
    path = manifest(BASIC + "".join(tables), repetitions=scenes, plugins=[HOSTILE])
    start = time.monotonic()
    results = library.run(load_study(path), out=tmp_path / "out", jobs=1)  # in turn with the good ones, in one worker
    assert time.monotonic() - start < 240
    runs = results.runs
    assert len(runs) == scenes * (len(SOLVERS) + 1) and "open" not in results.counts
    for (kind, *option), (status, message) in SOLVERS.items():
        rows = runs[runs.solver.str.startswith(kind)]
        if option:
            rows = rows[rows.solver == f"{kind}({option[0]}={option[1]})"]
        rows = rows if len(rows) else runs[runs.solver == kind]  # the default option has no label of its own
        assert list(rows.status) == [status] * scenes, (kind, option, list(rows.status), list(rows.message))
        assert all(text.startswith(message) for text in rows.message), (kind, option, list(rows.message))
    assert runs.message.str.encode("utf-8").str.len().max() <= 4096
    assert not runs.message.str.contains("[\x00-\x1f\x7f]", regex=True).any()
    assert (runs.evaluations[runs.status == "ok"] == 40).all()
    kept = runs[runs.solver == "sampler"].drop(columns=["runtime_s", "cpu_s", "evaluation_s"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(
        kept, good.runs.drop(columns=["runtime_s", "cpu_s", "evaluation_s"]), check_exact=True
    )
    assert pd.read_csv(results.folder / "runs.csv").shape[0] == len(runs)
    assert not processes_in(marker), [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in processes_in(marker)]


FORMULATIONS = {
    "complex": "estimate: expected an array of real numbers, got one of type complex128",
    "text": "estimate: expected an array of real numbers, got one of type <U1",
    "ragged": "estimate: expected an array of real numbers, got list: ",
    "object": "estimate: expected an array of real numbers, got one of type object",
    "huge": "estimate: expected at most 100,000 numbers, got 1,000,000",
    "none": "estimate: expected an array of real numbers, got one of type object",
    "nan": "rmse_m of the estimate is NaN",
    "array-raises": "estimate: expected an array of real numbers, got Raises: no array",
    "dates": "estimate: expected an array of real numbers, got one of type datetime64[D]",
}


@pytest.mark.parametrize("jobs", [0, 1])
def test_an_estimate_that_cannot_be_stored_is_that_runs_fault(manifest, tmp_path, jobs):
    tables = "".join(
        f'[[formulation]]\nkind = "returns"\nlabel = "returns {what}"\nwhat = "{what}"\n' for what in FORMULATIONS
    )
    path = manifest(BASIC + tables, repetitions=1, plugins=[HOSTILE])
    results = library.run(load_study(path), out=tmp_path / "out", jobs=jobs)
    runs = results.runs.set_index("formulation")
    for what, message in FORMULATIONS.items():
        row = runs.loc[f"returns {what}"]
        assert row.status == "invalid" and row.message.startswith(message), row.message
    assert runs.status["once"] == "ok"
    assert library.run(load_study(path), out=tmp_path / "out", jobs=jobs).counts == results.counts  # nothing is open


SCORES = {
    "complex": "score: expected a real number for 'x', got complex",
    "text": "score: expected a real number for 'x', got str",
    "name": "score: expected column names of 1 to 64 printable characters, got 3",
    "long-name": "score: expected column names of 1 to 64 printable characters, got 'xxx",
    "surrogate-name": "score: expected column names of 1 to 64 printable characters, got '\\ud800'",
    "column": "score: 'status' is the name of another column",
    "swept-column": "score: 'scenario.noise' is the name of another column",
    "vector": "score: expected a real number for 'x', got ndarray",
    "many": "score: expected at most 10,000 columns, got 20,001",
    "none": "score: expected a dict of numbers by column name, got NoneType",
    "list": "score: expected a dict of numbers by column name, got list",
}


def test_scores_that_cannot_be_stored_are_that_runs_fault(manifest, tmp_path):
    text = f"[[formulation]]\nkind = 'centre'\n[sweep]\nwhat = {[*SCORES, 'big']}\n"
    path = manifest(text, repetitions=1, plugins=[HOSTILE])
    path.write_text(path.read_text().replace('kind = "toy"', 'kind = "odd"'))
    runs = library.run(load_study(path), out=tmp_path / "out", jobs=1).runs.set_index("scenario.what")
    for what, message in SCORES.items():
        assert runs.status[what] == "invalid" and runs.message[what].startswith(message), runs.message[what]
    assert runs.status["big"] == "ok" and runs.x["big"] == float("inf") and runs.z["big"] == 0.5 and runs.t["big"] == 1


def test_a_formulation_without_accepts_fails_its_own_rows(manifest, tmp_path):
    path = manifest(BASIC + '[[formulation]]\nkind = "no-accepts"\n', repetitions=2, plugins=[HOSTILE])
    runs = library.run(load_study(path), out=tmp_path / "out", jobs=1).runs
    assert list(runs.status[runs.formulation == "once"]) == ["ok"] * 2
    failed = runs[runs.formulation == "no-accepts"]
    assert list(failed.status) == ["failed"] * 2 and "expected the class variable `accepts`" in failed.message.iloc[0]


IMPORTS = {
    "import os\nos._exit(0)\n": "ended the process with exit code 0 while it was imported",
    "import os\nos.kill(os.getpid(), 9)\n": "ended the process by signal 9 (SIGKILL) while it was imported",
    "import os\nos.kill(os.getpid(), 40)\n": "ended the process by signal 40 (SIGRTMIN+6) while it was imported",
    "raise KeyboardInterrupt\n": "KeyboardInterrupt",
    "raise GeneratorExit\n": "GeneratorExit",
    "raise SystemExit('no')\n": "SystemExit: no",
    "raise ValueError('\\ud800\\x1b[1m')\n": "ValueError: ?\\x1b[1m",
    "def f():\n    f()\nf()\n": "RecursionError",
    "x = [\n": "SyntaxError",
}


@pytest.mark.parametrize("source", [pytest.param(s, marks=[pytest.mark.slow] * (i % 2)) for i, s in enumerate(IMPORTS)])
def test_a_plugin_that_fails_in_any_way_while_imported_is_left_out_and_the_rest_runs(manifest, tmp_path, source):
    bad = tmp_path / "bad.py"
    bad.write_text(source)
    path = manifest(BASIC, repetitions=1, plugins=[bad])
    done = nfbench("run", path, "--out", "out", "--jobs", 1, cwd=tmp_path)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert IMPORTS[source] in done.stderr and "1 of 1 runs" in done.stdout


def test_a_plugin_may_not_change_the_working_directory_while_imported(manifest, tmp_path):
    (tmp_path / "moves.py").write_text(
        "import os\nfrom dataclasses import dataclass\nfrom nfbench import Solver\nos.chdir('/')\n"
        "@dataclass(frozen=True)\nclass Moves(Solver):\n    def minimize(self, problem, rng):\n"
        "        problem(problem.lower)\n"
    )
    path = manifest(BASIC + solver("moves"), repetitions=1, plugins=["moves.py"])
    done = nfbench("run", path, "--out", "out", "--jobs", 1, cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "out" / "runs.csv").is_file(), done.stderr


@pytest.mark.parametrize(
    ("name", "value"), [("run_timeout_s", 1e7), ("run_timeout_s", 1e300), ("run_memory_mb", 2**43)]
)
def test_limits_larger_than_the_platform_takes_are_no_limits(manifest, tmp_path, name, value):
    study = load_study(manifest(BASIC, repetitions=1))
    method = study.methods[0]
    object.__setattr__(method, name, value)
    assert library.run(study, out=tmp_path / "out", jobs=1).counts == {"ok": 1}


def test_what_a_killed_process_left_in_the_temporary_folder_is_removed(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code = f"import tempfile, os; tempfile.tempdir = {str(tmp_path)!r}\n"
    code += "from nfbench.execution.scratch import ScratchFolder; ScratchFolder(); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code], check=False)
    (abandoned,) = tmp_path.glob(f"{PREFIX}*")
    mine = ScratchFolder()
    assert not abandoned.exists() and mine.path.is_dir()
    _remove_abandoned(tmp_path)
    assert mine.path.is_dir()
    mine.cleanup()
    assert not list(tmp_path.iterdir())


def test_two_pools_that_start_at_once_do_not_disturb_each_other(tmp_path, monkeypatch):
    """Between creating a folder and locking it, another process may lock it as abandoned and remove it."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    acquire, tries = scratch.FileLock.acquire, []

    def late(lock):
        tries.append(Path(lock.lock_file))
        if len(tries) == 1:  # the other process holds the lock
            with tries[0].open("w") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                return acquire(lock)
        if len(tries) == 2:  # it has removed the folder
            shutil.rmtree(tries[1].parent)
        return acquire(lock)

    monkeypatch.setattr(scratch.FileLock, "acquire", late)
    mine = ScratchFolder()
    assert mine.path.is_dir() and len(tries) >= 2
    monkeypatch.undo()
    with pytest.raises(scratch.Timeout), scratch.FileLock(mine.path / scratch.LOCK, timeout=0):
        pass  # it is locked
    mine.cleanup()


def test_containment_names_what_has_changed(monkeypatch, tmp_path):
    import numpy as np

    state = Containment([])
    assert state.changed() is None
    with monkeypatch.context() as patch:
        patch.setattr(np.random, "default_rng", None)
        assert state.changed() == "module numpy.random" and state.changed(thorough=False) is None
    monkeypatch.setattr(np, "a_late_import", 1, raising=False)
    assert state.changed() is None
    with monkeypatch.context() as patch:
        patch.chdir(tmp_path)
        assert state.changed() == "the working directory"
    with np.errstate(all="raise"):
        assert state.changed() == "NumPy's error handling"
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "another text")
        assert state.changed() == "a setting of the interpreter"
    with monkeypatch.context() as patch:
        patch.delenv("PATH")
        assert state.changed() == "environment variables"
    assert state.changed() is None


def test_the_store_holds_text_and_numbers_only(manifest, tmp_path):
    tables = solver("raises-what", what="surrogate") + solver("cheats", what="best-value")
    path = manifest(BASIC + tables, repetitions=2, plugins=[HOSTILE])
    library.run(load_study(path), out=tmp_path / "out", jobs=2)
    with sqlite3.connect(tmp_path / "out" / "runs.sqlite") as db:
        types = (
            "SELECT DISTINCT typeof(objective), typeof(evaluations), typeof(runtime_s), typeof(message) FROM results"
        )
        found = set(db.execute(types))
    assert found <= {("real", "integer", "real", "text"), ("null", "integer", "real", "text")}, found
