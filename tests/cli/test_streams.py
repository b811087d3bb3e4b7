"""Tests that the command line prints to any standard output, and that a study survives one that fails."""

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from conftest import BASIC

TITLE = 'title = "λ/4 ≤ κ – [/] [red]"\n'


def command(*arguments, **environment):
    return [sys.executable, "-m", "nfbench", *map(str, arguments)], {**os.environ, "COLUMNS": "120", **environment}


def titled(manifest, **options):
    path = manifest(BASIC, repetitions=6, **options)
    path.write_text(TITLE + path.read_text())
    return path


@pytest.mark.parametrize(
    "encoding",
    [
        "cp1252",
        "utf-8",
        "ascii:strict",
        *(pytest.param(e, marks=pytest.mark.slow) for e in ("ascii", "latin-1", "cp437")),
    ],
)
def test_any_encoding_of_standard_output_will_do(manifest, tmp_path, encoding):
    path = titled(manifest)
    for arguments in (("run", path, "--out", "out", "--jobs", 0), ("report", "out"), ("list",), ("status", "out")):
        line, environment = command(*arguments, PYTHONIOENCODING=encoding)
        done = subprocess.run(line, cwd=tmp_path, capture_output=True, env=environment, timeout=120, check=False)
        assert done.returncode == 0 and b"Traceback" not in done.stderr, (arguments, done.stderr)
        assert done.stdout.decode(encoding.partition(":")[0])
    assert "λ/4" not in pd.read_csv(tmp_path / "out" / "runs.csv").to_csv()


def test_a_full_disk_behind_standard_output_is_reported_and_costs_no_row(manifest, tmp_path):
    line, environment = command("run", titled(manifest), "--out", "out", "--jobs", 1)
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(line, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, env=environment, check=False)
    errors = done.stderr.decode()
    assert "standard output could not be written: No space left on device" in errors and "Traceback" not in errors
    assert len(pd.read_csv(tmp_path / "out" / "runs.csv")) == 6


def test_a_reader_that_closes_the_pipe_does_not_stop_the_study(manifest, tmp_path):
    line, environment = command("run", titled(manifest), "--out", "out", "--jobs", 1)
    with subprocess.Popen(
        line, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        process.stdout.close()
        errors = process.stderr.read().decode()
        assert process.wait(60) == 0
    assert not errors and len(pd.read_csv(tmp_path / "out" / "runs.csv")) == 6


def test_closed_standard_streams_do_not_stop_the_study(manifest, tmp_path):
    line, environment = command("run", titled(manifest), "--out", "out", "--jobs", 1)
    done = subprocess.run(["sh", "-c", 'exec "$@" >&- 2>&-', "sh", *line], cwd=tmp_path, env=environment, check=False)
    assert done.returncode == 0 and len(pd.read_csv(tmp_path / "out" / "runs.csv")) == 6


def test_control_characters_of_a_message_do_not_reach_the_terminal(manifest, tmp_path):
    (tmp_path / "loud.py").write_text(
        "from dataclasses import dataclass\nfrom nfbench import Solver\n\n@dataclass(frozen=True)\n"
        "class Loud(Solver):\n    def minimize(self, problem, rng):\n"
        "        raise ValueError('\\x1b[2J\\rgone [/] [bold]')\n"
    )
    path = manifest(BASIC + '[[solver]]\nkind = "loud"\n', repetitions=2, plugins=["loud.py"])
    for arguments in (("run", path, "--out", "out", "--jobs", 1), ("status", "out"), ("report", "out")):
        line, environment = command(*arguments)
        done = subprocess.run(line, cwd=tmp_path, capture_output=True, env=environment, timeout=120, check=False)
        assert b"\x1b" not in done.stdout + done.stderr and b"\r" not in done.stdout + done.stderr
        assert rb"\x1b[2J gone [/] [bold]" in done.stdout
    assert b"\x1b" not in (tmp_path / "out" / "study.log").read_bytes()
