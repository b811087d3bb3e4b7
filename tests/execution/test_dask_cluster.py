"""A study on a cluster gives the same table as in this process, even if workers die."""

import importlib.util
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pandas as pd
import pytest
from conftest import BASIC
from typer.testing import CliRunner

import nfbench
from nfbench import NfbenchError, load_study
from nfbench.cli.entry import app as cli
from nfbench.execution import dask_cluster as cluster

TIMES = ["runtime_s", "cpu_s", "evaluation_s"]
PATIENCE = 60.0  # seconds until a test gives up waiting for a process
LONGER = BASIC.replace("40", "8000")  # runs that last some tenths of a second


def until(condition):
    """Wait until the result of ``condition()`` is true, and return it."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return found


def parent(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def alive(pid):
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


class Dask:
    """A scheduler and workers on the loopback interface, started by the commands that a user would type."""

    def __init__(self, folder):
        self.folder = folder
        self.processes = []

    def start(self, *arguments):
        command = [sys.executable, "-m", "dask", *arguments, "--host", "127.0.0.1", "--no-dashboard"]
        # dask gives up a task after two lost workers instead of four, so that tests do not wait
        environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
        with (self.folder / "log").open("ab") as log:
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=log, env=environment, cwd=self.folder))
        return self.processes[-1]

    def scheduler(self):
        self.start("scheduler", "--port", "0")
        listens = re.compile(r"Scheduler at: +(tcp://\S+)")
        self.address = until(lambda: listens.search((self.folder / "log").read_text()))[1]

    def worker(self):
        return self.start("worker", self.address, "--nthreads", "1", "--local-directory", str(self.folder))

    def end(self):
        for process in reversed(self.processes):  # the scheduler last, because workers that lose it end slowly
            process.terminate()
            process.wait(PATIENCE)


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    """A scheduler and two workers with nannies, shared by the tests of this file."""
    dask = Dask(tmp_path_factory.mktemp("dask"))
    try:
        dask.scheduler()
        dask.worker()
        dask.worker()
        yield dask
    finally:
        dask.end()


class Watch:
    """A listener that calls ``act(record)`` once, at the n-th finished run."""

    def __init__(self, act, at=1):
        self.act, self.left = act, at

    def begin(self, total, done): ...

    def stopping(self): ...

    def finished(self, spec, record):
        self.left -= 1
        if self.left == 0:
            self.act(record)


def run(path, out, where, **options):
    return nfbench.run(load_study(path), out=out, cluster=where, **options)


def run_locally(path, out, jobs=0):
    return nfbench.run(load_study(path), out=out, jobs=jobs)


def assert_same(one, two):
    one, two = (results.runs.drop(columns=TIMES) for results in (one, two))
    assert one.run_id.is_unique
    pd.testing.assert_frame_equal(one, two, check_exact=True)


def test_the_table_is_the_same_as_in_this_process(dask, manifest, tmp_path):
    path = manifest(BASIC + '[[formulation]]\nkind = "twice"\n[sweep]\ndimension = [2, 3]\n', repetitions=40)
    results = run(path, tmp_path / "there", dask.address)
    assert_same(results, run_locally(path, tmp_path / "here"))
    assert results.origins.worker.nunique() == 2


def test_a_worker_that_is_killed_costs_no_row(dask, manifest, tmp_path):
    path = manifest(LONGER, repetitions=40)
    killed = []

    def kill(record):
        killed.append(record.worker)
        os.kill(parent(record.worker), signal.SIGKILL)

    results = run(path, tmp_path / "there", dask.address, listener=Watch(kill, at=5))
    assert_same(results, run_locally(path, tmp_path / "here"))
    assert not alive(killed[0]) and results.origins.worker.nunique() >= 2


BAD = """
run_timeout_s = 3.0
run_memory_mb = 200
[[solver]]
kind = "sleeps"
[[solver]]
kind = "stubborn"
[[solver]]
kind = "segfaults"
[[solver]]
kind = "crashes"
[[solver]]
kind = "hoards"
[[solver]]
kind = "exits"
[[solver]]
kind = "raises"
"""


def test_hangs_and_crashes_are_reported_as_in_local_workers(dask, manifest, tmp_path):
    path = manifest(BASIC + BAD, repetitions=1)
    there, local = (results.runs.drop(columns=TIMES) for results in (
        run(path, tmp_path / "there", dask.address), run_locally(path, tmp_path / "here", jobs=2)
    ))  # fmt: skip
    for runs in (there, local):  # the plugin file has another path on a worker, and Python's traceback names it
        runs["message"] = runs.message.str.replace(r'File ".*?toy\.py".*', "", regex=True)
    pd.testing.assert_frame_equal(there, local, check_exact=True)
    assert there.status.value_counts().to_dict() == {"ok": 1, "timeout": 2, "crashed": 3, "failed": 2}


FATAL = """
import os, signal, time
from dataclasses import dataclass
from nfbench import Solver

@dataclass(frozen=True)
class Fatal(Solver):
    def minimize(self, problem, rng):
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(60)
"""


def test_a_run_that_kills_every_worker_is_given_up(dask, manifest, tmp_path):
    (tmp_path / "fatal.py").write_text(FATAL)
    path = manifest(BASIC + '[[solver]]\nkind = "fatal"\n', plugins=["fatal.py"], repetitions=1)
    runs = run(path, tmp_path / "there", dask.address).runs.set_index("solver")
    assert runs.status.to_dict() == {"sampler": "ok", "fatal": "crashed"}
    assert runs.message["fatal"].startswith("the cluster lost 4 workers that held this run, the last of them tcp://")


REPORTS_PATH = """
from dataclasses import dataclass
from nfbench import Solver

@dataclass(frozen=True)
class ReportsPath(Solver):
    def minimize(self, problem, rng):
        raise RuntimeError(__file__)
"""


def test_a_plugin_file_need_not_exist_on_the_workers(dask, manifest, tmp_path):
    (tmp_path / "same").mkdir()
    for file, name in (("plugin.py", "ReportsPath"), ("same/plugin.py", "ReportsPathToo")):
        (tmp_path / file).write_text(REPORTS_PATH.replace("ReportsPath", name))
    solvers = '[[solver]]\nkind = "reports-path"\n[[solver]]\nkind = "reports-path-too"\n'
    path = manifest(BASIC + solvers, plugins=["plugin.py", "same/plugin.py"], repetitions=1)
    runs = run(path, tmp_path / "there", dask.address).runs
    failed = runs[runs.solver != "sampler"]
    assert set(failed.status) == {"failed"}
    for message in failed.message:
        file = message.split()[1]
        assert file.endswith("/plugin.py") and file.startswith(str(dask.folder))
        until(lambda file=file: not Path(file).exists())  # the file is removed afterwards


def test_an_interrupted_study_can_be_resumed(dask, manifest, tmp_path):
    path = manifest(LONGER, repetitions=60)
    with pytest.raises(KeyboardInterrupt):
        run(path, tmp_path / "out", dask.address, listener=Watch(lambda _: os.kill(os.getpid(), signal.SIGINT)))
    counts = nfbench.Results(tmp_path / "out").counts
    assert counts["ok"] >= 1 and counts["open"] >= 10 and set(counts) == {"ok", "open"}
    assert_same(run(path, tmp_path / "out", dask.address), run_locally(path, tmp_path / "here"))


def test_no_run_is_started_after_a_request_to_stop(dask, manifest):
    study = load_study(manifest(BASIC, repetitions=5000))
    specs, stop = study.specs(), threading.Event()
    for _ in cluster.run_on_cluster(specs, study.plugins, dask.address, stop.is_set):
        stop.set()
    assert len(list(specs)) > 4000


def test_a_closed_engine_leaves_nothing_running(dask, manifest):
    study = load_study(manifest(BASIC + 'run_timeout_s = 600\n[[solver]]\nkind = "sleeps"\n', repetitions=20))
    batches = cluster.run_on_cluster(study.specs(), study.plugins, dask.address, lambda: False)
    ((_, record), *_) = next(batches)
    batches.close()
    until(lambda: not alive(record.worker))


def test_a_lost_scheduler_is_an_error_and_finished_rows_are_kept(manifest, tmp_path):
    dask = Dask(tmp_path)
    try:
        dask.scheduler()
        dask.worker()
        with pytest.raises(
            NfbenchError,
            match=r"lost the dask scheduler at tcp://.*finished rows are kept, run the same command to resume",
        ):
            kill = Watch(lambda _: dask.processes[0].kill())
            run(manifest(LONGER, repetitions=200), tmp_path / "out", dask.address, listener=kill)
        assert nfbench.Results(tmp_path / "out").counts["ok"] >= 1
    finally:
        dask.end()


def test_an_address_where_no_scheduler_answers_is_an_error(manifest, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense", "ftp://127.0.0.1:21"):
        with pytest.raises(NfbenchError, match=f"no dask scheduler answered at '{address}'.*expected an address such"):
            run(manifest(BASIC), tmp_path / "out", address)
    for address in ("local:", "local:two", "local:0", "local:-1"):
        with pytest.raises(NfbenchError, match=f"expected local:N with N >= 1 .* got '{address}'"):
            run(manifest(BASIC), tmp_path / "out", address)


def test_another_version_on_the_cluster_is_refused(dask, manifest, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "VERSION", "99.0")
    with pytest.raises(
        NfbenchError, match=r"the scheduler has nfbench \d.*but the study was started with 99\.0; install the same"
    ):
        run(manifest(BASIC), tmp_path / "out", dask.address)
    monkeypatch.setattr(cluster, "_refuse_other_versions", lambda client: None)  # as with a worker that joins later
    with pytest.raises(
        NfbenchError, match=r"worker tcp://\S+ has nfbench \d.*but the study was started with 99\.0; install the same"
    ):
        run(manifest(BASIC), tmp_path / "out", dask.address)


def test_a_machine_that_cannot_execute_runs_is_named(dask, manifest, tmp_path):
    dies = (  # passes the first import, which is a trial in a child process, and ends the worker at the second
        "import os\nfrom pathlib import Path\nseen = Path(__file__).with_suffix('.seen')\nif 'dask' in __file__:\n"
        "    if seen.exists():\n        seen.unlink()\n        os._exit(3)\n    seen.touch()\n" + REPORTS_PATH
    )
    (tmp_path / "dies.py").write_text(dies)
    with pytest.raises(
        NfbenchError, match=r"worker tcp://\S+ on \S+ cannot execute runs: worker processes cannot start"
    ):
        run(manifest(BASIC, plugins=["dies.py"]), tmp_path / "out", dask.address)


def test_without_dask_the_error_names_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    spec = importlib.util.spec_from_file_location("nfbench.execution.cluster_without_dask", cluster.__file__)
    with pytest.raises(NfbenchError, match=r"pip install 'nfbench\[dask\]'"):
        spec.loader.exec_module(importlib.util.module_from_spec(spec))


def test_the_command_line_starts_its_own_cluster_and_prints_nothing(manifest, tmp_path):
    path = manifest(BASIC, repetitions=20)
    command = [sys.executable, "-m", "nfbench", "run", str(path), "--out", str(tmp_path / "there"), "--quiet"]
    done = subprocess.run([*command, "--cluster", "local:2"], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert_same(nfbench.Results(tmp_path / "there"), run_locally(path, tmp_path / "here"))


@pytest.mark.parametrize(
    "options",
    [
        ["--cluster", "local:2", "--jobs", "2"],
        ["--cluster", "local:2", "--scheduler", "tcp://127.0.0.1:1"],
        ["--scheduler", "tcp://127.0.0.1:1", "--jobs", "2"],
        ["--cluster", "tcp://127.0.0.1:1"],
        ["--scheduler", "local:2"],
    ],
)
def test_contradicting_options_are_a_usage_error(manifest, tmp_path, options):
    done = CliRunner().invoke(cli, ["run", str(manifest(BASIC)), "--out", str(tmp_path / "out"), *options])
    assert done.exit_code == 2 and not (tmp_path / "out").exists()
