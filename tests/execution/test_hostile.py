"""No hostile solver, killed worker or killed parent process damages a study."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from conftest import BASIC

import nfbench
from nfbench import NfbenchError, Status, StoreError, load_study
from nfbench.execution import process_pool as isolation
from nfbench.execution.process_pool import ProcessPool

TIMES = ["runtime_s", "cpu_s", "evaluation_s"]
HOSTILE = {
    "sleeps": ("timeout", "stopped after run_timeout_s = 1.5 s"),
    "spins": ("timeout", "stopped after run_timeout_s = 1.5 s"),
    "stubborn": ("timeout", "stopped after run_timeout_s = 1.5 s"),
    "segfaults": ("crashed", "its process died: signal 11 (SIGSEGV): Fatal Python error: Segmentation fault"),
    "crashes": ("crashed", "its process died: exit code 3"),
    "exits": ("failed", "SystemExit: 3"),
    "raises": ("failed", "RuntimeError: out of luck"),
    "asks-for-na-n": ("invalid", "x[0]: expected a number within [-1.0, 1.0], got nan"),
    "hoards": ("crashed", "ran out of memory: MemoryError"),
    "shouts": ("ok", ""),
}


def run(path, out, **options):
    return nfbench.run(load_study(path), out=out, **{"jobs": 2, **options})


def table(results):
    return results.runs.drop(columns=TIMES)


def assert_same(one, two):
    pd.testing.assert_frame_equal(table(one), table(two), check_exact=True)


def assert_whole(results, rows):
    """Check that no row is missing or duplicated, and that the file is intact."""
    runs = results.runs
    assert len(runs) == runs.run_id.nunique() == rows and "open" not in results.counts
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def stat(pid):
    """State and parent of a process, or None if there is none."""
    try:
        state, parent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:2]
    except (FileNotFoundError, ProcessLookupError):
        return None
    return state, int(parent)


def alive(pid):
    """Whether the process runs (a zombie does not)."""
    found = stat(pid)
    return found is not None and found[0] != "Z"


def children(pid):
    pids = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
    return [child for child in pids if (found := stat(child)) and found[1] == pid]


def is_worker(pid):
    try:
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_every_hostile_solver_costs_only_its_own_rows(manifest, tmp_path):
    good = run(manifest(BASIC), tmp_path / "good")
    solvers = "".join(f'[[solver]]\nkind = "{name}"\n' for name in HOSTILE)
    path = manifest(BASIC + "run_timeout_s = 1.5\nrun_memory_mb = 300\n" + solvers, repetitions=2)
    start = time.monotonic()
    results = run(path, tmp_path / "out")
    runs = table(results)
    for name, (status, message) in HOSTILE.items():
        rows = runs[runs.solver == name]
        assert list(rows.status) == [status] * 2, name
        assert all(text.startswith(message) for text in rows.message), list(rows.message)
    kept = runs[runs.solver == "sampler"].reset_index(drop=True)
    expected = table(good)
    pd.testing.assert_frame_equal(kept, expected[expected.repetition < 2], check_exact=True)
    assert not [pid for pid in results.origins.worker.unique() if pid != os.getpid() and alive(pid)]
    assert time.monotonic() - start < 60


def test_a_worker_that_grows_is_replaced_and_no_run_is_lost(manifest, tmp_path, monkeypatch):
    monkeypatch.setattr(isolation, "GROWTH_MB", 100.0)
    path = manifest(BASIC.replace('"sampler"', '"keeps"'), repetitions=12)
    results = run(path, tmp_path / "out", jobs=1)  # 32 MiB per run: the first is not counted, the fifth is the last
    assert set(results.runs.status) == {"ok"} and len(results.runs) == 12
    assert results.origins.groupby("worker").size().tolist() == [5, 5, 2]
    monkeypatch.setattr(isolation, "GROWTH_MB", 1000.0)
    assert run(path, tmp_path / "other", jobs=1).origins.worker.nunique() == 1


def test_the_last_output_of_a_dead_worker_is_in_the_message(manifest, tmp_path):
    results = run(manifest(BASIC.replace('"sampler"', '"segfaults"'), repetitions=1), tmp_path / "out")
    (message,) = results.runs.message
    assert "toy.py" in message and "minimize" in message and len(message) < 600


def test_a_run_is_stopped_within_a_second_of_its_timeout(manifest, tmp_path):
    path = manifest(BASIC.replace('"sampler"', '"spins"') + "run_timeout_s = 1.0\n", repetitions=3)
    origins = run(path, tmp_path / "out", jobs=1).origins
    gaps = origins.finished.diff().dt.total_seconds().dropna()
    # each run takes one second, less than one more until it is dead, and the start of a new worker
    assert (gaps > 1.0).all() and (gaps < 5.0).all()


SLOWISH = """
[[formulation]]
kind = "once"
[[solver]]
kind = "dawdles"
[budget]
evaluations = 40
"""


@pytest.fixture
def dawdling(manifest, tmp_path):
    """A study of runs that take a while, and its results when nothing disturbs it."""
    (tmp_path / "dawdler.py").write_text(
        "import time\nfrom dataclasses import dataclass\nfrom nfbench import Solver\n\n"
        "@dataclass(frozen=True)\nclass Dawdles(Solver):\n    def minimize(self, problem, rng):\n"
        "        while True:\n            time.sleep(0.0005)\n"
        "            problem(rng.uniform(problem.lower, problem.upper))\n"
    )
    path = manifest(SLOWISH, repetitions=80, plugins=["dawdler.py"])
    return path, run(path, tmp_path / "undisturbed")


def start(path, out):
    command = [sys.executable, "-m", "nfbench", "run", str(path), "--out", str(out), "--jobs", "2", "--quiet"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def killed_at_random(dawdling, out, times, seed):
    path, undisturbed = dawdling
    rng = random.Random(seed)
    for _ in range(times):
        process = start(path, out)
        time.sleep(rng.uniform(0.3, 2.5))
        workers = children(process.pid)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        deadline = time.monotonic() + 10
        while any(map(alive, workers)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not [pid for pid in workers if alive(pid)]
    results = run(path, out)
    assert_whole(results, 80)
    assert_same(results, undisturbed)


def test_killing_the_parent_loses_nothing(dawdling, tmp_path):
    killed_at_random(dawdling, tmp_path / "out", times=3, seed=1)


@pytest.mark.slow
def test_killing_the_parent_at_20_random_moments_loses_nothing(dawdling, tmp_path):
    for seed in range(20):
        killed_at_random(dawdling, tmp_path / f"out-{seed}", times=1, seed=seed)


def workers_killed(dawdling, out, times, seed):
    path, undisturbed = dawdling
    rng = random.Random(seed)
    process = start(path, out)
    while process.poll() is None and times:
        time.sleep(rng.uniform(0.2, 0.8))
        workers = list(filter(is_worker, children(process.pid)))
        if workers:
            os.kill(rng.choice(workers), signal.SIGKILL)
            times -= 1
    _, errors = process.communicate(timeout=120)
    assert "Traceback" not in errors, errors
    runs = nfbench.Results(out).runs
    assert set(runs.status) <= {"ok", "crashed"} and len(runs) == 80
    assert all("signal 9 (SIGKILL)" in text for text in runs.message[runs.status == "crashed"])
    results = run(path, out, retry=[Status.CRASHED])
    assert_whole(results, 80)
    assert_same(results, undisturbed)


def test_killing_workers_costs_only_their_runs(dawdling, tmp_path):
    workers_killed(dawdling, tmp_path / "out", times=3, seed=5)


@pytest.mark.slow
def test_killing_20_random_workers_costs_only_their_runs(dawdling, tmp_path):
    for seed in range(5):
        workers_killed(dawdling, tmp_path / f"out-{seed}", times=4, seed=seed)


def test_a_second_writer_is_refused_and_does_not_disturb_the_first(dawdling, tmp_path):
    path, undisturbed = dawdling
    out = tmp_path / "out"
    first = start(path, out)
    while not (out / "runs.sqlite").is_file():
        time.sleep(0.02)
    second = start(path, out)
    _, errors = second.communicate(timeout=60)
    assert second.returncode == 2 and "another nfbench process is writing to this folder" in errors
    first.communicate(timeout=120)
    assert first.returncode == 0
    assert_same(nfbench.Results(out), undisturbed)


def finished(folder):
    """Number of runs that are ok so far; 0 if the folder is still being created."""
    try:
        return nfbench.Results(folder).counts.get("ok", 0)
    except StoreError:
        return 0


def test_sigterm_finishes_the_current_runs_and_the_study_resumes(dawdling, tmp_path):
    path, undisturbed = dawdling
    process = start(path, tmp_path / "out")
    while not finished(tmp_path / "out"):
        time.sleep(0.05)
        assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert process.returncode == 130
    counts = nfbench.Results(tmp_path / "out").counts
    assert 0 < counts["ok"] < 80 and set(counts) == {"ok", "open"}
    assert_same(run(path, tmp_path / "out"), undisturbed)


@pytest.mark.parametrize("jobs", [1, 4])
def test_any_number_of_workers_gives_the_same_table(dawdling, tmp_path, jobs):
    path, undisturbed = dawdling
    assert_same(run(path, tmp_path / "out", jobs=jobs), undisturbed)


def test_a_script_without_a_main_guard_is_an_error_and_loses_no_run(dawdling, tmp_path):
    path, _ = dawdling
    script = tmp_path / "script.py"
    script.write_text(f"import nfbench\nnfbench.run(nfbench.load_study({str(path)!r}), out='out', jobs=2)\n")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert 'below `if __name__ == "__main__":`' in done.stderr.splitlines()[-1]
    assert nfbench.Results(tmp_path / "out").counts == {"open": 80}


def test_if_no_process_can_start_every_run_fails_even_those_in_flight(manifest, monkeypatch):
    study = load_study(manifest(BASIC.replace('"sampler"', '"sleeps"')))
    first, second, third = study.specs()
    with ProcessPool(study.plugins, jobs=2) as workers:
        running = workers.submit(first)
        while not running.running():
            time.sleep(0.02)

        def refuse(**options):
            raise OSError("no more processes")

        monkeypatch.setattr(workers._spawn, "Process", refuse)
        for future in (workers.submit(second), running, workers.submit(third)):
            with pytest.raises(NfbenchError, match="the engine failed: OSError"):
                future.result(timeout=20)
