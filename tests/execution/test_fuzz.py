"""Fuzzes the engine with solvers and plugin files made of hostile acts (slow). Run it with ``pytest -m slow``."""

import random
import time

import pandas as pd
import pytest
from conftest import BASIC, nfbench
from test_containment import processes_in

import nfbench as library
from nfbench import load_study

SOLVERS, IMPORTS, OPTIONS = 60, 25, 40
ACTS = [
    "raise {error}",
    "os._exit({number})",
    "os.kill(os.getpid(), {signal})",
    "os.kill(0, {signal}) if {signal} in (2, 15) else None",
    "os.fork()",
    "os.fork() or time.sleep(3600)",
    "subprocess.Popen(['sleep', '3600'])",
    "subprocess.Popen(['sleep', '3600'], start_new_session=False, close_fds=False)",
    "os.close({descriptor})",
    "os.closerange({descriptor}, {descriptor} + 50)",
    "os.dup2(0, {descriptor})",
    "os.chdir('/')",
    "os.environ.clear()",
    "resource.setrlimit(resource.{limit}, (1000, resource.getrlimit(resource.{limit})[1]))",
    "sys.stdout.close()",
    "sys.stdout = sys.stderr = None",
    "sys.modules.clear()",
    "sys.setrecursionlimit(60)",
    "gc.disable(); gc.set_threshold(1)",
    "setattr({module}, {attribute!r}, None)",
    "delattr({module}, {attribute!r})",
    "signal.signal({signal}, signal.SIG_IGN) if {signal} != 9 else None",
    "signal.setitimer(signal.ITIMER_REAL, 0.01)",
    "signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 32))",
    "threading.Thread(target=time.sleep, args=(3600,), daemon={daemon}).start()",
    "threading.Thread(target=problem.evaluate, args=(np.zeros((3, 2)),)).start()",
    "print('x' * 10**6, flush=True)",
    "os.write(2, b'\\x1b[2J' * 10**5)",
    "problem._limit = {number}",
    "problem._evaluations = -{number}",
    "problem._best_value = {value}",
    "problem._recorder.rows.append(({number}, 'a', {value}, None))",
    "problem.lower = problem.upper",
    "problem.lower[0] = np.nan",
    "problem.keep_population({value}, {value})",
    "problem(np.full(2, {value}))",
    "problem.evaluate(np.full(({number}, 2), 0.5))",
    "ctypes.memset(0, 0, 8)",
    "bytearray(2**40)",
    "[].sort(key=lambda x: x); (lambda f: f(f))(lambda f: f(f))",
    "time.sleep(3600)",
    "while True: pass",
    "tempfile.tempdir = '/nowhere'",
    "random.seed(0); np.random.seed(0); np.seterr(all='raise')",
    "warnings.simplefilter('error')",
    "logging.disable(); logging.shutdown()",
    "atexit.register(time.sleep, 3600)",
    "faulthandler.dump_traceback_later(0.01, exit=True)",
    "tracemalloc.start(50)",
]
ERRORS = ["ValueError('\\ud800')", "KeyboardInterrupt", "GeneratorExit", "SystemExit(0)", "BaseException('\\x00')",
          "MemoryError", "RecursionError", "StopIteration", "Warning", "Exception('x' * 10**7)", "OSError(2, 'no')",
          "type('E', (Exception,), {'__str__': lambda self: 1 / 0})()"]  # fmt: skip
HEAD = """
import atexit, ctypes, faulthandler, gc, json, logging, math, os, random, resource, signal, subprocess, sys, tempfile
import threading, time, tracemalloc, warnings
from dataclasses import dataclass
import numpy as np
from nfbench import Solver
"""


def act(rng):
    return rng.choice(ACTS).format(
        error=rng.choice(ERRORS),
        number=rng.choice([0, 1, 3, 255, 10**6]),
        signal=rng.choice([1, 2, 6, 9, 11, 13, 15, 31, 34, 40, 64]),
        descriptor=rng.choice([0, 1, 2, 3, 4, 5, 7, 9]),
        limit=rng.choice(
            ["RLIMIT_NOFILE", "RLIMIT_FSIZE", "RLIMIT_NPROC", "RLIMIT_STACK", "RLIMIT_CORE", "RLIMIT_DATA"]
        ),
        module=rng.choice(["np", "np.random", "math", "os", "json", "time", "sys", "threading"]),
        attribute=rng.choice(["asarray", "default_rng", "sqrt", "getpid", "dumps", "perf_counter", "Lock", "exit"]),
        daemon=rng.choice([True, False]),
        value=rng.choice(["None", "'abc'", "float('nan')", "-1e308", "np.zeros(3)", "1j", "0.5"]),
    )


def body(rng, indent):
    return "".join(f"{indent}{act(rng)}\n" for _ in range(rng.randint(1, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_random_hostile_solvers_cost_their_own_rows_only(manifest, tmp_path, monkeypatch, seed):
    monkeypatch.setenv("NFBENCH_TEST", str(tmp_path))
    rng = random.Random(seed)
    source = HEAD
    for number in range(SOLVERS):
        source += f"\n@dataclass(frozen=True)\nclass Hostile{number}(Solver):\n    def minimize(self, problem, rng):\n"
        source += "        problem(problem.lower.copy())\n" + body(rng, " " * 8)
        source += "        while True:\n            problem(problem.from_unit(rng.random(2)))\n"
    (tmp_path / "hostile.py").write_text(source)
    good = library.run(load_study(manifest(BASIC, repetitions=2)), out=tmp_path / "good", jobs=1)
    tables = "".join(f'[[solver]]\nkind = "hostile{number}"\n' for number in range(SOLVERS))
    path = manifest(f"{BASIC}run_timeout_s = 3\nrun_memory_mb = 2000\n{tables}", repetitions=2, plugins=["hostile.py"])
    start = time.monotonic()
    done = nfbench("run", path, "--out", "out", "--jobs", 2, cwd=tmp_path, timeout=1200)
    seconds = time.monotonic() - start
    assert done.returncode in (0, 1) and "Traceback" not in done.stdout + done.stderr, done.stderr[-3000:]
    results = library.Results(tmp_path / "out")
    runs = results.runs
    assert len(runs) == 2 * (SOLVERS + 1) and "open" not in results.counts
    kept = runs[runs.solver == "sampler"].drop(columns=["runtime_s", "cpu_s", "evaluation_s"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(
        kept, good.runs.drop(columns=["runtime_s", "cpu_s", "evaluation_s"]), check_exact=True
    )
    assert runs.evaluations.max() <= 40 or (runs.status[runs.evaluations > 40] == "invalid").all()
    assert not processes_in(f"NFBENCH_TEST={tmp_path}")
    print(f"{SOLVERS} solvers: {results.counts}, {seconds:.0f} s")


@pytest.mark.slow
def test_random_hostile_imports_are_left_out(manifest, tmp_path, monkeypatch):
    monkeypatch.setenv("NFBENCH_TEST", str(tmp_path))
    rng = random.Random(3)
    left_out = 0
    for number in range(IMPORTS):
        lines = body(rng, "").splitlines()
        slow = ("problem", "fork() or time.sleep", "while True", "time.sleep(3600)")  # the limit has its own test
        lines = [line for line in lines if not any(text in line for text in slow)] or ["raise KeyError"]
        acts = "\n".join(lines)
        file = tmp_path / f"bad{number}.py"
        file.write_text(f"{HEAD}\n{acts}\n")
        path = manifest(BASIC, repetitions=1, plugins=[file], name=f"n{number}", file=f"{number}.toml")
        done = nfbench("run", path, "--out", f"out{number}", "--jobs", 1, cwd=tmp_path, timeout=120)
        assert done.returncode == 0 and "Traceback" not in done.stderr, (acts, done.stderr[-2000:])
        assert "1 of 1 runs" in done.stdout, (acts, done.stdout)
        left_out += f"bad{number}.py" in done.stderr
    assert left_out == IMPORTS  # none defines a plugin
    assert not processes_in(f"NFBENCH_TEST={tmp_path}")


@pytest.mark.slow
def test_random_hostile_options_cost_their_own_rows_only(manifest, tmp_path, monkeypatch):
    """The acts are those of ``validate``, which is called while the manifest is read."""
    monkeypatch.setenv("NFBENCH_TEST", str(tmp_path))
    rng = random.Random(4)
    source = HEAD
    for number in range(OPTIONS):
        apart = ("problem", "atexit", "print", "os.write")  # what a plugin prints itself is not held back
        lines = [line for line in body(rng, "").splitlines() if not any(text in line for text in apart)]
        acts = "".join(f"        {line}\n" for line in lines or ["raise KeyError"])
        source += f"\n@dataclass(frozen=True)\nclass Hostile{number}(Solver):\n    def validate(self):\n{acts}"
        source += "    def minimize(self, problem, rng):\n        problem(problem.lower.copy())\n"
    (tmp_path / "hostile.py").write_text(source)
    good = library.run(load_study(manifest(BASIC, repetitions=2)), out=tmp_path / "good", jobs=1)
    tables = "".join(f'[[solver]]\nkind = "hostile{number}"\n' for number in range(OPTIONS))
    path = manifest(f"{BASIC}run_timeout_s = 3\n{tables}", repetitions=2, plugins=["hostile.py"])
    done = nfbench("run", path, "--out", "out", "--jobs", 2, cwd=tmp_path, timeout=600)
    assert done.returncode == 1 and "Traceback" not in done.stdout + done.stderr, done.stderr[-3000:]
    results = library.Results(tmp_path / "out")
    runs = results.runs
    assert len(runs) == 2 * (OPTIONS + 1) and "open" not in results.counts
    kept = runs[runs.solver == "sampler"].drop(columns=["runtime_s", "cpu_s", "evaluation_s"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(
        kept, good.runs.drop(columns=["runtime_s", "cpu_s", "evaluation_s"]), check_exact=True
    )
    assert not processes_in(f"NFBENCH_TEST={tmp_path}")
    print(f"{OPTIONS} options: {results.counts}")
