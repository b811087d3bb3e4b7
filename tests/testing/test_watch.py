"""The process of the checks: it ends with ``nfbench check``, however that ends, and any end of it is reported."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from nfbench.testing import check_jobs, watched_checks

SOLVER = '''
"""A solver that misbehaves."""
import os, signal, subprocess, sys, time
from dataclasses import dataclass
from pathlib import Path
from nfbench import Solver, SolverInfo

@dataclass(frozen=True)
class Bad(Solver):
    """A bad solver."""

    info = SolverInfo()

    def minimize(self, problem, rng):
        {action}
'''
BUSY = """program = subprocess.Popen(["sleep", "60"])
        part = Path(__file__).with_name("part")
        part.write_text(f"{os.getpid()} {program.pid}")
        part.rename(part.with_name("pids"))
        while True:
            pass"""


def plugin(folder, action):
    file = folder / "bad.py"
    file.write_text(textwrap.dedent(SOLVER).replace("{action}", action))
    return file


def pids(folder):
    deadline = time.monotonic() + 60.0
    while not (folder / "pids").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return [int(pid) for pid in (folder / "pids").read_text().split()]


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def all_end(numbers, within=10.0):
    deadline = time.monotonic() + within
    while any(map(running, numbers)) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not any(map(running, numbers))


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_busy_check_ends_with_the_command(number, tmp_path):
    file = plugin(tmp_path, BUSY)
    command = [sys.executable, "-m", "nfbench", "check", "solver", file]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=tmp_path) as parent:
        numbers = pids(tmp_path)
        parent.send_signal(number)
        try:
            assert all_end(numbers)
        finally:
            for pid in filter(running, [*numbers, parent.pid]):
                os.kill(pid, signal.SIGKILL)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_check_that_takes_too_long_is_killed_with_everything_it_started(tmp_path):
    (job,) = check_jobs("solver", str(plugin(tmp_path, BUSY)))
    results = watched_checks(job, timeout_s=2.0)
    assert next(results).passed  # described
    assert next(results).message.startswith("expected the check to end within 2 s, got no result. Call problem.")
    assert all_end(pids(tmp_path))
    results.close()


@pytest.mark.parametrize(
    ("action", "cause"),
    [
        ("os.kill(os.getpid(), 40)", "signal 40 (SIGRTMIN+6)"),
        ("os.kill(os.getpid(), signal.SIGRTMAX)", "signal 64 (SIGRTMAX)"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", "signal 11 (SIGSEGV)"),
        ("os._exit(0)", "exit code 0"),
        ("os._exit(77)", "exit code 77"),
        ("os.closerange(3, 4096); os._exit(5)", "exit code 5"),
    ],
)
def test_any_end_of_the_process_fails_the_check_and_not_the_others(action, cause, tmp_path):
    (job,) = check_jobs("solver", str(plugin(tmp_path, action)))
    results = watched_checks(job, timeout_s=60.0)
    described, budget, seconds = (next(results) for _ in range(3))
    results.close()
    assert described.passed
    for result, name in ((budget, "budget"), (seconds, "budget-in-seconds")):
        assert (result.name, result.passed) == (name, False)
        assert f"expected the process of the check to stay alive, got its end by {cause}. Remove any" in result.message
