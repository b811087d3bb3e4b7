"""A package that registers a solver by entry point can be installed, found by name, checked and run."""

import os
import subprocess
import sys

import pandas as pd
import pytest
from conftest import PROJECT

STUDY = """
name = "compass"
repetitions = 2
seed = 1
[scenario]
kind = "functions"
function = "sphere"
[[formulation]]
kind = "direct"
[[solver]]
kind = "compass"
step = 0.1
[budget]
evaluations = 2000
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A function that runs nfbench in its own folder, with the package installed. It needs no network."""
    folder = tmp_path_factory.mktemp("package")
    source, site = folder / "source", folder / "site"
    source.mkdir()
    for name in ("pyproject.toml", "nfbench_compass.py"):
        (source / name).write_bytes((PROJECT / "tests" / "example_package" / name).read_bytes())
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    done = subprocess.run([*pip, "--target", str(site), str(source)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

    def nfbench(*arguments):
        environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": "200", "NO_COLOR": "1"}
        command = [sys.executable, "-m", "nfbench", *arguments]
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)

    nfbench.folder = folder
    return nfbench


def test_its_solver_is_listed_and_shown_with_its_origin(run):
    assert "Kolda, Lewis & Torczon 2003" in run("list", "solvers").stdout
    assert "solver compass (nfbench-compass 1.2.3)" in run("show", "solver", "compass").stdout


def test_its_solver_meets_the_contract(run):
    done = run("check", "solver", "compass")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAIL" not in done.stdout and "ok   finds-minimum" in done.stdout


def test_its_solver_runs_in_a_study_in_worker_processes(run):
    (run.folder / "study.toml").write_text(STUDY)
    done = run("run", "study.toml", "--jobs", "1")
    assert done.returncode == 0, done.stdout + done.stderr
    runs = pd.read_csv(run.folder / "results" / "compass" / "runs.csv")
    assert list(runs.solver) == ["compass"] * 2 and (runs.gap < 1e-8).all()
