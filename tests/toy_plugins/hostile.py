"""Solvers, formulations and scenarios that do what a plugin must not do. Each may cost its own rows and no others."""

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Literal

import numpy as np
from toy import Bowl, ToyInstance

from nfbench import BudgetExhausted, Formulation, Incompatible, Instance, Scenario, Solver


def spend(problem, rng):
    with contextlib.suppress(BudgetExhausted):
        while True:
            problem(problem.from_unit(rng.random(problem.dimension)))


class Unreadable(Exception):
    def __str__(self):
        raise RuntimeError("no message")


@dataclass(frozen=True)
class RaisesWhat(Solver):
    """Raises each kind of exception."""

    name: ClassVar[str] = "raises-what"
    what: Literal["surrogate", "control", "long", "unreadable", "interrupt", "generator-exit", "exit", "budget"] = (
        "long"
    )

    def minimize(self, problem, rng):
        problem(problem.lower)
        raise {
            "surrogate": ValueError("lone \ud800 surrogate"),
            "control": ValueError("\x1b[31mred\x1b[0m\rover\nwritten\x00\u202e"),
            "long": ValueError("λ" * 10**6),
            "unreadable": Unreadable(),
            "interrupt": KeyboardInterrupt(),
            "generator-exit": GeneratorExit(),
            "exit": SystemExit(0),
            "budget": Incompatible(Unreadable()),
        }[self.what]


@dataclass(frozen=True)
class Dies(Solver):
    """Ends its process in each way."""

    how: Literal["segfault", "kill", "real-time", "exit-0", "abort", "hup"] = "kill"

    def minimize(self, problem, rng):
        if self.how == "segfault":
            ctypes.string_at(0)
        elif self.how == "exit-0":
            os._exit(0)
        elif self.how == "abort":
            os.abort()
        else:
            os.kill(os.getpid(), {"kill": signal.SIGKILL, "real-time": 40, "hup": signal.SIGHUP}[self.how])
            time.sleep(60)


@dataclass(frozen=True)
class Forks(Solver):
    """Forks, and goes on in both processes or leaves one behind."""

    then: Literal["both", "sleeper", "sleeper-and-segfault", "double"] = "both"

    def minimize(self, problem, rng):
        if self.then == "both":
            os.fork()
            spend(problem, rng)
        elif os.fork() == 0:
            if self.then == "double":
                os.fork()
            time.sleep(3600)
            os._exit(0)
        elif self.then == "sleeper-and-segfault":
            ctypes.string_at(0)
        spend(problem, rng)


@dataclass(frozen=True)
class Changes(Solver):
    """Changes the process that it runs in, and then does its work."""

    what: Literal[
        "stdout", "stderr", "low-descriptors", "directory", "files-limit", "size-limit", "numpy", "math", "signals",
        "errors", "subprocess", "thread", "recursion", "environment", "terminates-itself", "interrupts-itself",
    ] = "stdout"  # fmt: skip

    def minimize(self, problem, rng):
        getattr(self, "_" + self.what.replace("-", "_"))(problem)
        spend(problem, rng)

    def _stdout(self, problem):
        os.close(1)

    def _stderr(self, problem):
        os.close(2)

    def _low_descriptors(self, problem):
        os.closerange(0, 64)

    def _directory(self, problem):
        os.chdir("/")

    def _files_limit(self, problem):
        resource.setrlimit(resource.RLIMIT_NOFILE, (12, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))

    def _size_limit(self, problem):
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))

    def _numpy(self, problem):
        np.random.default_rng = None

    def _math(self, problem):
        import math

        math.sqrt = None
        np.asarray = np.asarray

    def _signals(self, problem):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    def _errors(self, problem):
        np.seterr(all="raise")

    def _subprocess(self, problem):
        subprocess.Popen(["sleep", "3600"], stdout=subprocess.DEVNULL)

    def _thread(self, problem):
        threading.Thread(target=time.sleep, args=(3600,)).start()

    def _recursion(self, problem):
        sys.setrecursionlimit(200)

    def _environment(self, problem):
        os.environ.clear()

    def _terminates_itself(self, problem):
        os.kill(os.getpid(), signal.SIGTERM)

    def _interrupts_itself(self, problem):
        os.kill(os.getpid(), signal.SIGINT)


@dataclass(frozen=True)
class Parallel(Solver):
    """Evaluates in eight threads."""

    def minimize(self, problem, rng):
        threads = [threading.Thread(target=spend, args=(problem, np.random.default_rng(k))) for k in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


@dataclass(frozen=True)
class Cheats(Solver):
    """Writes to the meter."""

    what: Literal["limit", "best-value", "public-best-value", "count", "public-count"] = "limit"

    def minimize(self, problem, rng):
        if self.what == "limit":
            problem._limit = 10**9
            for _ in range(500):
                problem(problem.lower)
        elif self.what == "public-best-value":
            problem.best_value = "abc"
        elif self.what == "public-count":
            problem.evaluations = 0
        problem(problem.lower)
        if self.what == "best-value":
            problem._best_value = "abc"
        elif self.what == "count":
            problem._evaluations = 0


@dataclass(frozen=True)
class WarmUpRaises(Solver):
    def warm_up(self):
        raise RuntimeError("cold")

    def minimize(self, problem, rng):
        spend(problem, rng)


@dataclass(frozen=True)
class WarmUpExits(WarmUpRaises):
    def warm_up(self):
        raise SystemExit(3)


@dataclass(frozen=True)
class ValidateRaises(Solver):
    def validate(self):
        raise RuntimeError("never valid")

    def minimize(self, problem, rng):
        spend(problem, rng)


@dataclass(frozen=True)
class Returns(Formulation):
    """Returns what is not an estimate."""

    accepts: ClassVar[type[Instance]] = Instance
    needs_solver: ClassVar[bool] = False
    what: Literal["complex", "text", "ragged", "object", "huge", "none", "nan", "array-raises", "dates"] = "complex"

    def solve(self, instance, minimize):
        class Raises:
            def __array__(self, *arguments, **options):
                raise RuntimeError("no array")

        return {
            "complex": instance.centre + 1j,
            "text": ["\ud800", "b"],
            "ragged": [[1.0], [1.0, 2.0]],
            "object": np.array([object(), None]),
            "huge": np.zeros(10**6),
            "none": None,
            "nan": np.full(2, np.nan),
            "array-raises": Raises(),
            "dates": np.array(["2026-01-01"], dtype="datetime64[D]"),
        }[self.what]


@dataclass(frozen=True)
class Centre(Formulation):
    """Knows the answer."""

    accepts: ClassVar[type[Instance]] = Instance
    needs_solver: ClassVar[bool] = False

    def solve(self, instance, minimize):
        return instance.centre


@dataclass(frozen=True)
class NoAccepts(Formulation):
    def solve(self, instance, minimize):
        return minimize(Bowl(instance.centre)).x


class OddScores(ToyInstance):
    def __init__(self, centre, what):
        super().__init__(centre, 0.0)
        self.what = what

    def score(self, estimate):
        return {"rmse_m": 0.5, **ODD[self.what]} if self.what in ODD else {"none": None, "list": [1]}[self.what]


ODD = {
    "complex": {"x": 1j},
    "text": {"x": "0.5"},
    "name": {3: 1.0},
    "long-name": {"x" * 1000: 1.0},
    "surrogate-name": {"\ud800": 1.0},
    "column": {"status": 1.0},
    "swept-column": {"scenario.noise": 1.0},
    "vector": {"x": np.zeros(3)},
    "many": {f"x{i}": 1.0 for i in range(20_000)},
    "big": {"x": 10**400, "y": Fraction(1, 3), "z": np.float32(0.5), "t": True},
}


@dataclass(frozen=True)
class OddScenario(Scenario):
    name: ClassVar[str] = "odd"
    instance: ClassVar[type[Instance]] = ToyInstance
    what: str = "complex"

    def draw(self, rng):
        return OddScores(rng.uniform(-0.9, 0.9, 2), self.what)
