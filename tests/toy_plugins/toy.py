"""Small scenarios, formulations and solvers for the tests of the framework."""

import ctypes
import math
import os
import signal
import time
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Formulation, Ge, Incompatible, Instance, Le, Problem, Scenario, Solver, SolverInfo


class Bowl(Problem):
    """‖x − centre‖² over [-1, 1]ⁿ."""

    def __init__(self, centre):
        self.centre = centre
        self.lower, self.upper = -np.ones(len(centre)), np.ones(len(centre))

    def evaluate(self, X):
        return ((X - self.centre) ** 2).sum(axis=1)


class ToyInstance(Instance):
    def __init__(self, centre, noise):
        self.centre, self.noise = centre, noise

    def score(self, estimate):
        if estimate.shape != self.centre.shape:
            raise ValueError(f"expected {self.centre.shape}, got {estimate.shape}")
        error = float(np.linalg.norm(estimate - self.centre))
        return {"rmse_m": error, "error_1_m": error}


@dataclass(frozen=True)
class ToyScenario(Scenario):
    """An unknown point in a box.

    dimension: number of coordinates of the point.
    noise: stored in the instance; it has no effect.
    names: an option whose value is a list; it has no effect.
    """

    name: ClassVar[str] = "toy"
    instance: ClassVar[type[Instance]] = ToyInstance

    dimension: Annotated[int, Ge(1)] = 2
    noise: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    names: tuple[str, ...] = ()

    def draw(self, rng):
        return ToyInstance(rng.uniform(-0.9, 0.9, self.dimension), self.noise)


@dataclass(frozen=True)
class Once(Formulation):
    """Minimizes one bowl.

    shift: added to every coordinate of the bowl's centre.
    """

    accepts: ClassVar[type[Instance]] = ToyInstance

    shift: float = 0.0

    def solve(self, instance, minimize):
        return minimize(Bowl(instance.centre + self.shift)).x


@dataclass(frozen=True)
class Twice(Formulation):
    """Minimizes two bowls one after the other."""

    accepts: ClassVar[type[Instance]] = ToyInstance

    def solve(self, instance, minimize):
        return (minimize(Bowl(instance.centre)).x + minimize(Bowl(instance.centre)).x) / 2


@dataclass(frozen=True)
class Oracle(Formulation):
    """Returns the true point; works only in two dimensions."""

    accepts: ClassVar[type[Instance]] = ToyInstance
    needs_solver: ClassVar[bool] = False

    def solve(self, instance, minimize):
        if len(instance.centre) != 2:
            raise Incompatible(f"works in 2 dimensions, not in {len(instance.centre)}")
        return instance.centre


@dataclass(frozen=True)
class WrongShape(Formulation):
    accepts: ClassVar[type[Instance]] = ToyInstance
    needs_solver: ClassVar[bool] = False

    def solve(self, instance, minimize):
        return np.zeros(7)


@dataclass(frozen=True)
class NotANumber(Formulation):
    accepts: ClassVar[type[Instance]] = ToyInstance
    needs_solver: ClassVar[bool] = False

    def solve(self, instance, minimize):
        return np.full_like(instance.centre, math.nan)


@dataclass(frozen=True)
class Sampler(Solver):
    """Evaluates uniform random samples in batches.

    batch: number of points per batch.
    """

    info = SolverInfo(batched=True, converges=False)
    batch: Annotated[int, Ge(1)] = 8

    def minimize(self, problem, rng):
        while True:
            problem.evaluate(problem.from_unit(rng.random((self.batch, problem.dimension))))


@dataclass(frozen=True)
class Raises(Solver):
    def minimize(self, problem, rng):
        problem(problem.lower.copy())
        raise RuntimeError("out of luck")


@dataclass(frozen=True)
class Lazy(Solver):
    def minimize(self, problem, rng):
        return


@dataclass(frozen=True)
class Mutates(Solver):
    def minimize(self, problem, rng):
        problem.lower[0] = -100.0


@dataclass(frozen=True)
class Outside(Solver):
    def minimize(self, problem, rng):
        problem(problem.upper + 1.0)


@dataclass(frozen=True)
class Exits(Solver):
    def minimize(self, problem, rng):
        raise SystemExit(3)


@dataclass(frozen=True)
class Crashes(Solver):
    def minimize(self, problem, rng):
        os._exit(3)


@dataclass(frozen=True)
class Sleeps(Solver):
    def minimize(self, problem, rng):
        time.sleep(3600)


@dataclass(frozen=True)
class Spins(Solver):
    """Runs a loop in C, during which Python does not call signal handlers."""

    def minimize(self, problem, rng):
        sum(range(10**15))


@dataclass(frozen=True)
class Stubborn(Solver):
    """Ignores SIGTERM."""

    def minimize(self, problem, rng):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(3600)


@dataclass(frozen=True)
class Segfaults(Solver):
    def minimize(self, problem, rng):
        ctypes.string_at(0)


@dataclass(frozen=True)
class Hoards(Solver):
    def minimize(self, problem, rng):
        held = []
        while True:
            held.append(bytearray(2**24))


KEPT = []


@dataclass(frozen=True)
class Keeps(Solver):
    def minimize(self, problem, rng):
        KEPT.append(b"x" * 2**25)
        problem(problem.lower)


@dataclass(frozen=True)
class Shouts(Solver):
    def minimize(self, problem, rng):
        for _ in range(3000):
            print("x" * 1000)
        os.write(2, b"y" * 10**6)
        problem(problem.lower)


@dataclass(frozen=True)
class AsksForNaN(Solver):
    def minimize(self, problem, rng):
        problem(np.full(problem.dimension, math.nan))
