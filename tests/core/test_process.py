"""Processes end with their parent, together with what they started, and their end is described."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from nfbench.core import cause_of_end

PARENT = """
import os, subprocess, sys, time
from multiprocessing import Pipe, Process
from nfbench.core import die_with_parent, end_group_at_eof

def spin(alive, held, parent, how):
    os.setsid()
    if how != "die_with_parent":
        os.close(held)
        end_group_at_eof(os.dup(alive))
        os.close(alive)
    if how != "end_group_at_eof":
        die_with_parent(parent)
    program = subprocess.Popen(["sleep", "60"])
    print(os.getpid(), program.pid, flush=True)
    while True:
        pass

if __name__ == "__main__":
    alive, held = os.pipe()
    Process(target=spin, args=(alive, held, os.getpid(), sys.argv[1])).start()
    os.close(alive)
    time.sleep(60)
"""


def ended(pid, within=10.0):
    """Whether a process ends within some seconds; a zombie has ended."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("how", ["die_with_parent", "end_group_at_eof", "both"])
def test_a_busy_process_ends_when_its_parent_is_killed(how, tmp_path):
    file = tmp_path / "parent.py"
    file.write_text(textwrap.dedent(PARENT))
    with subprocess.Popen([sys.executable, file, how], stdout=subprocess.PIPE, text=True) as parent:
        busy, program = map(int, parent.stdout.readline().split())
        parent.kill()
        try:
            assert ended(busy)
            assert ended(program) == (how != "die_with_parent")
        finally:
            for pid in (busy, program):
                if Path(f"/proc/{pid}").exists():
                    os.kill(pid, signal.SIGKILL)


def test_a_process_whose_parent_has_ended_already_ends_at_once():
    code = "from nfbench.core import die_with_parent; die_with_parent(1 << 22); print('alive')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (1, "")


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0, "exit code 0"),
        (3, "exit code 3"),
        (None, "an unknown cause"),
        (-9, "signal 9 (SIGKILL)"),
        (-11, "signal 11 (SIGSEGV)"),
        (-40, f"signal 40 (SIGRTMIN+{40 - getattr(signal, 'SIGRTMIN', 0)})"),
        (-120, "signal 120 (unknown signal)"),
    ],
)
def test_every_exit_code_is_described(code, text):
    assert cause_of_end(code) == text


@pytest.mark.skipif(sys.platform != "linux", reason="signal numbers")
@pytest.mark.parametrize("number", sorted(map(int, signal.valid_signals())))
def test_every_signal_has_a_description(number):
    assert cause_of_end(-number).startswith(f"signal {number} (SIG")
