"""The command line, run in its own process as by a user."""

import os
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
from conftest import BASIC, COMMAND_ENVIRONMENT, nfbench


def test_run_prints_a_table_a_verdict_and_the_paths(manifest, tmp_path):
    done = nfbench("run", manifest(BASIC, repetitions=8), "--jobs", 1, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "8 of 8 runs" in done.stdout
    assert "once + sampler is the only method; on 8 scenes 8 of 8 runs hit error ≤ 1" in done.stdout
    assert "Written to results/toy/: runs.csv, summary.csv" in done.stdout
    assert len(pd.read_csv(tmp_path / "results" / "toy" / "runs.csv")) == 8
    assert "8 of 8 runs done" in nfbench("status", "results/toy", cwd=tmp_path).stdout
    assert "once + sampler is the only method" in nfbench("report", "results/toy", cwd=tmp_path).stdout
    quiet = nfbench("run", manifest(BASIC, repetitions=8), "--quiet", cwd=tmp_path)
    assert (quiet.returncode, quiet.stdout, quiet.stderr) == (0, "", "")


def test_failed_runs_are_reported_with_exit_code_1(manifest, tmp_path):
    done = nfbench("run", manifest(BASIC + '[[solver]]\nkind = "raises"\n'), "--jobs", 1, cwd=tmp_path)
    assert done.returncode == 1
    assert "failed × 3: once + raises: RuntimeError: out of luck" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


BROKEN = [
    "",
    "name = ",
    'name = "a"',
    BASIC.replace("once", "onec"),
    BASIC.replace("= 40", "= 0"),
    BASIC.replace("[budget]", "[bugdet]"),
    BASIC + "[sweep]\ndimension = []\n",
    BASIC + '[[solver]]\nkind = "sampler"\n',
    BASIC.replace('"sampler"', '"sampler"\nbatch = "many"'),
    BASIC + '[[method]]\nformulation = "oracle"\nsolver = "sampler"\n',
]


@pytest.mark.parametrize("number", range(len(BROKEN)))
def test_a_broken_manifest_is_exit_code_2_with_no_folder_and_no_traceback(number, manifest, tmp_path):
    path = manifest(BROKEN[number]) if number > 2 else tmp_path / "broken.toml"
    if number <= 2:
        path.write_text(BROKEN[number])
    before = set(tmp_path.iterdir())
    done = nfbench("run", path, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith(f"nfbench: {path}:\n  ") and "Traceback" not in done.stderr
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "arguments", [["run"], ["run", "no.toml"], ["lst"], ["show", "solver", "dee"], ["status", "no"]]
)
def test_wrong_usage_is_exit_code_2(arguments, tmp_path):
    done = nfbench(*arguments, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr and "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_list_and_show_print_the_registered_plugins(tmp_path, toy_plugin):
    listed = nfbench("list", cwd=tmp_path).stdout
    assert all(name in listed for name in ("near-field", "functions", "nemo", "neef", "de", "Storn"))
    assert "near-field" not in nfbench("list", "solvers", cwd=tmp_path).stdout
    shown = nfbench("show", "solver", "sampler", "--plugin", toy_plugin, cwd=tmp_path).stdout
    assert "Evaluates uniform random samples in batches." in shown and "int >= 1" in shown


def test_a_plugin_that_fails_is_listed_with_its_error(tmp_path):
    (tmp_path / "bad.py").write_text("def broken(:")
    listed = nfbench("list", "solvers", "--plugin", "bad.py", cwd=tmp_path)
    assert "bad.py could not be imported: SyntaxError" in listed.stdout and listed.returncode == 0


def test_ctrl_c_is_exit_code_130_and_the_folder_resumes(manifest, tmp_path):
    slow = manifest(BASIC + '[[solver]]\nkind = "sleeps"\n', repetitions=1)
    command = [sys.executable, "-m", "nfbench", "run", str(slow), "--jobs", "1"]
    process = subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=COMMAND_ENVIRONMENT,
        start_new_session=True,
    )
    rows = tmp_path / "results" / "toy" / "runs.sqlite"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and "ok 1" not in nfbench("status", "results/toy", cwd=tmp_path).stdout:
        time.sleep(0.2)
    os.killpg(process.pid, signal.SIGINT)
    time.sleep(1)
    assert process.poll() is None  # the current run continues
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert (
        "press Ctrl-C again to stop at once" in output
        and "Interrupted: 1 of 2 runs are done. Run the same command to resume." in output
        and "Traceback" not in errors
    )
    assert rows.is_file()
    again = nfbench("run", manifest(BASIC, repetitions=1), cwd=tmp_path)
    assert again.returncode == 0
