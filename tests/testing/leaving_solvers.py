"""Solvers that keep state between runs or leave a trace in their process, each in one way."""

import contextlib
import locale
import os
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from nfbench import Solver, SolverInfo

INFO = SolverInfo(converges=False)
STATE = np.random.default_rng(3)
DEVIATES: list[float] = []  # the second one of a pair, until it is needed
DIMENSIONS: list[int] = []


def forget():
    """Bring the state of this module back to that of a new process."""
    DEVIATES.clear()
    DIMENSIONS.clear()


def search(problem, rng):
    """Uniform points until the budget ends the run."""
    while True:
        problem.evaluate(problem.from_unit(rng.random((7, problem.dimension))))


def deviate(rng):
    """A normal deviate by the polar method, which computes them in pairs."""
    if not DEVIATES:
        radius, angle = np.sqrt(-2.0 * np.log(1.0 - rng.random())), 2.0 * np.pi * rng.random()
        DEVIATES.extend([radius * np.cos(angle), radius * np.sin(angle)])
    return DEVIATES.pop()


@dataclass(frozen=True)
class KeepsGenerator(Solver):
    """Draws from a generator of its module."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        search(problem, STATE)


@dataclass(frozen=True)
class KeepsDeviate(Solver):
    """Draws an odd number of normal deviates when the number of unknowns is odd, as CR-FM-NES of fcmaes does."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        first = [deviate(rng) for _ in range(problem.dimension)]
        problem(problem.from_unit(np.clip(0.5 + 0.1 * np.array(first), 0.0, 1.0)))
        search(problem, rng)


@dataclass(frozen=True)
class KeepsDimension(Solver):
    """Starts where the largest problem so far suggests."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        DIMENSIONS.append(problem.dimension)
        problem(problem.from_unit(np.full(problem.dimension, 1.0 / max(DIMENSIONS))))
        search(problem, rng)


@dataclass(frozen=True)
class KeepsAfterError(Solver):
    """Restores a setting at the end of a run, but not after an exception."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        scale = float(os.environ.get("NFBENCH_TEST_SCALE", "1"))
        os.environ["NFBENCH_TEST_SCALE"] = "0.5"
        try:
            problem.evaluate(problem.from_unit(scale * rng.random((40, problem.dimension))))
            search(problem, rng)
        except ValueError:
            raise
        except BaseException:
            del os.environ["NFBENCH_TEST_SCALE"]
            raise


def act_on_descriptor():
    os.close(2)


def replace_descriptor():
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)


def replace_generator():
    original = np.random.default_rng
    np.random.default_rng = lambda seed=None: original(1)


def set_locale():
    for name in ("C.UTF-8", "C.utf8", "en_US.UTF-8", "POSIX"):
        with contextlib.suppress(locale.Error):
            if locale.setlocale(locale.LC_ALL) != name:
                locale.setlocale(locale.LC_ALL, name)
                return


def write_file():
    Path("best.txt").write_text("0.1", encoding="utf-8")


def write_temporary_file():
    tempfile.mkstemp()


def start_thread():
    threading.Thread(target=threading.Event().wait, daemon=True, name="helper").start()


def start_program():
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])


def start_orphan():
    subprocess.run(["sh", "-c", "sleep 60 &"], check=True)


def fork():
    if not (child := os.fork()):
        os._exit(0)
    os.waitpid(child, 0)


ACTIONS = {  # what a run does: the setting or thing that the check names
    act_on_descriptor: "descriptor 2 (standard error)",
    replace_descriptor: "descriptor 1 (standard output)",
    lambda: os.chdir(".."): "the working directory",
    lambda: np.seterr(all="raise"): "np.geterr()",
    lambda: np.set_printoptions(precision=3): "np.get_printoptions()",
    replace_generator: "numpy.random.default_rng",
    lambda: signal.signal(signal.SIGTERM, signal.SIG_IGN): f"the handler of signal {int(signal.SIGTERM)}",
    set_locale: "the locale",
    lambda: warnings.simplefilter("ignore"): "warnings.filters",
    lambda: warnings.resetwarnings(): "warnings.filters",
    lambda: os.environ.update(OMP_NUM_THREADS="8"): "the environment variable OMP_NUM_THREADS",
    lambda: os.environ.update(MY_LIBRARY="1"): "the environment variable MY_LIBRARY",
    lambda: sys.setrecursionlimit(4321): "the recursion limit",
    lambda: os.umask(0): "the umask",
    write_file: "no file to be left",
    write_temporary_file: "no file to be left",
    start_thread: "no thread to be left running after a run, got helper",
    start_program: "no child process to be left after a run",
    start_orphan: "no child process to be left after a run, got sleep",
    fork: "a solver that does not fork",
    lambda: os.dup(0): "the number of open file descriptors not to grow",
}
NUMBERED = list(ACTIONS)


@dataclass(frozen=True)
class Leaves(Solver):
    """Does something to its process, and does not undo it.

    action: number of what it does in ``ACTIONS``.
    """

    action: int = 0

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        NUMBERED[self.action]()
        search(problem, rng)


@dataclass(frozen=True)
class LeavesAfterError(Solver):
    """Restores NumPy's error handling unless the problem raises."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        before = np.seterr(divide="raise")
        try:
            search(problem, rng)
        except ValueError:
            raise
        except BaseException:
            np.seterr(**before)
            raise


@dataclass(frozen=True)
class Threads(Solver):
    """Evaluates in a pool of threads, which it shuts down."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        with ThreadPoolExecutor(2) as pool:
            while True:
                X = problem.from_unit(rng.random((2, problem.dimension)))
                list(pool.map(problem, X))


@dataclass(frozen=True)
class Restores(Solver):
    """Changes many settings and restores all of them, also after an exception."""

    info: ClassVar[SolverInfo] = INFO

    def minimize(self, problem, rng):
        directory, errors = Path.cwd(), np.seterr(all="raise")
        thread = threading.Thread(target=str)
        thread.start()
        subprocess.run([sys.executable, "-c", ""], check=True)
        try:
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
                warnings.simplefilter("ignore")
                os.chdir(folder)
                search(problem, rng)
        finally:
            thread.join()
            os.chdir(directory)
            np.seterr(**errors)
