"""Tests that an interruption from outside is no result: the runs that it ended are made again."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import nfbench
from nfbench import StoreError

SLOW = """
[[formulation]]
kind = "once"
[[solver]]
kind = "dawdles"
[budget]
evaluations = 40
"""


@pytest.fixture
def slow_study(manifest, tmp_path):
    (tmp_path / "dawdler.py").write_text(
        "import time\nfrom dataclasses import dataclass\nfrom nfbench import Solver\n\n"
        "@dataclass(frozen=True)\nclass Dawdles(Solver):\n    def minimize(self, problem, rng):\n"
        "        while True:\n            time.sleep(0.01)\n"
        "            problem(rng.uniform(problem.lower, problem.upper))\n"
    )
    return manifest(SLOW, repetitions=30, plugins=["dawdler.py"])


def started(path, out, **options):
    """The study in a process group of its own, as a shell or batch system starts it."""
    command = [sys.executable, "-m", "nfbench", "run", str(path), "--out", str(out), "--jobs", "2"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, start_new_session=True, **pipes, **options)


def ok_runs(folder):
    try:
        return nfbench.Results(folder).counts.get("ok", 0)
    except StoreError:
        return 0


def wait_for_a_run(process, folder):
    while not ok_runs(folder):
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


def workers_of(pid):
    """All processes below this one, also in sessions of their own."""
    parents = {}
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            try:
                parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
    below, found = {pid}, set()
    while below:
        below = {child for child, parent in parents.items() if parent in below} - found
        found |= below
    return found


@pytest.mark.parametrize(
    ("number", "everybody"),
    [
        (signal.SIGTERM, True),
        (signal.SIGINT, False),
        pytest.param(signal.SIGTERM, False, marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, True, marks=pytest.mark.slow),
    ],
)
def test_a_signal_to_all_processes_leaves_rows_open_and_not_crashed(slow_study, tmp_path, number, everybody):
    out = tmp_path / "out"
    process = started(slow_study, out)
    wait_for_a_run(process, out)
    targets = [*workers_of(process.pid), process.pid] if everybody else []  # as some batch systems do
    for pid in targets:
        os.kill(pid, number)
    if not everybody:
        os.killpg(process.pid, number)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in output + errors, errors
    counts = nfbench.Results(out).counts
    assert set(counts) <= {"ok", "open"} and counts["open"] > 0 and counts["ok"] > 0
    done = subprocess.run(
        [sys.executable, "-m", "nfbench", "run", str(slow_study), "--out", str(out), "--jobs", "2", "--quiet"],
        check=False,
    )
    assert done.returncode == 0 and nfbench.Results(out).counts == {"ok": 30}


@pytest.mark.parametrize(
    "delay",
    [0.0, 0.3, 0.6, 1.0, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.1, 0.2, 0.4, 0.5, 0.8, 1.3))],
)
def test_ctrl_c_while_workers_start_shows_no_traceback(slow_study, tmp_path, delay):
    out = tmp_path / "out"
    process = started(slow_study, out)
    deadline = time.monotonic() + 30
    while not (out / "runs.sqlite").is_file() and time.monotonic() < deadline:  # before that, Python itself starts
        time.sleep(0.005)
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert process.returncode in (0, 130) and "Traceback" not in output + errors, errors
    try:
        counts = nfbench.Results(out).counts
    except StoreError:  # interrupted before there was a plan
        counts = {}
    assert set(counts) <= {"ok", "open"}


def test_a_second_ctrl_c_stops_at_once_and_leaves_no_worker(slow_study, tmp_path):
    out = tmp_path / "out"
    slow_study.write_text(slow_study.read_text().replace("evaluations = 40", "evaluations = 4000"))
    process = started(slow_study, out)
    deadline = time.monotonic() + 30
    while len(workers_of(process.pid)) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(2.0)
    workers = workers_of(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=20)
    assert process.returncode == 130 and "Traceback" not in output + errors, errors
    assert nfbench.Results(out).counts == {"open": 30}
    deadline = time.monotonic() + 5  # for a helper of Python's multiprocessing, which ends after its parent
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]
