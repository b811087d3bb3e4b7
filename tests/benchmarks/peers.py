"""Overhead between optimizer and objective, in nfbench and in other libraries, in µs per evaluation."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np
from rich.table import Table
from scipy.optimize import differential_evolution
from timing import in_turn

from nfbench import Budget, MeteredProblem, Problem, Solver, minimize
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.solvers.cmaes import CMAES, cma
from nfbench.solvers.de import DE
from nfbench.solvers.scipy_de import ScipyDE

EVALUATIONS = 12_000
POPULATION = 120


class Watched(Problem):
    """A problem that records the total time and the number of its evaluations."""

    def __init__(self, problem: Problem) -> None:
        self.lower, self.upper = problem.lower, problem.upper
        self.problem, self.seconds, self.points = problem, 0.0, 0

    def evaluate(self, X: np.ndarray) -> np.ndarray:
        start = time.perf_counter()
        values = self.problem.evaluate(X)
        self.seconds += time.perf_counter() - start
        self.points += len(X)
        return values

    def value(self, x: np.ndarray) -> float:
        start = time.perf_counter()
        value = self.problem.value(x)
        self.seconds += time.perf_counter() - start
        self.points += 1
        return value


def optimizers(problem: SubspaceFit) -> Table:
    """Measure the same objective with nfbench's solvers and with the libraries themselves."""
    table = Table("driving ESF, n = 6", "evaluations", "objective µs", "overhead µs per evaluation", "share")
    box = list(zip(problem.lower, problem.upper, strict=True))

    def through(solver: Solver) -> Callable[[Watched], object]:
        return lambda watched: minimize(watched, solver, EVALUATIONS, seed=1)

    def scipy_alone(watched: Watched) -> None:
        generations = EVALUATIONS // POPULATION - 1
        differential_evolution(
            lambda X: watched.evaluate(np.ascontiguousarray(X.T)),
            box,
            popsize=POPULATION // 6,
            maxiter=generations,
            tol=0,
            atol=0,
            polish=False,
            vectorized=True,
            updating="deferred",
            rng=np.random.default_rng(1),
        )

    def cma_alone(watched: Watched) -> None:
        width = problem.upper - problem.lower
        options = {"bounds": [0, 1], "maxfevals": EVALUATIONS, "seed": 1, "verbose": -9, "popsize": 12, "tolfun": 0}
        es = cma.CMAEvolutionStrategy(np.full(6, 0.5), 0.3, {**options, "tolx": 0, "tolflatfitness": 10**9})
        for _ in range(EVALUATIONS // 12):
            X = es.ask()
            es.tell(X, watched.evaluate(problem.lower + np.array(X) * width).tolist())

    for name, run in (
        ("nfbench de", through(DE(population=POPULATION))),
        ("nfbench scipy-de", through(ScipyDE())),
        ("SciPy's differential_evolution, vectorized", scipy_alone),
        ("nfbench cmaes", through(CMAES())),
        ("pycma's CMAEvolutionStrategy, ask and tell", cma_alone),
    ):
        rounds = []
        for _ in range(3):
            watched = Watched(problem)
            start = time.perf_counter()
            run(watched)
            whole = time.perf_counter() - start
            count, inside = watched.points, watched.seconds
            rounds.append((count, inside / count, (whole - inside) / count, 1 - inside / whole))
        count, inside, outside, share = (statistics.median(column) for column in zip(*rounds, strict=True))
        table.add_row(name, f"{count:,.0f}", f"{1e6 * inside:.2f}", f"{1e6 * outside:.2f}", f"{share:.0%}")
    return table


class Free(Problem):
    """A problem whose evaluation costs almost nothing, so that the overhead remains."""

    def __init__(self, n: int) -> None:
        self.lower, self.upper = np.full(n, -5.0), np.full(n, 5.0)

    def evaluate(self, X: np.ndarray) -> np.ndarray:
        return np.ones(len(X))

    def value(self, x: np.ndarray) -> float:
        return 1.0


class Counter:
    """The minimum that a meter in Python must do: count, stop, and keep the best value."""

    def __init__(self, value: Callable[[np.ndarray], float]) -> None:
        self.value, self.evaluations, self.best = value, 0, math.inf

    def __call__(self, x: np.ndarray) -> float:
        if self.evaluations >= 10**9:
            raise StopIteration
        value = self.value(x)
        self.evaluations += 1
        if value < self.best:
            self.best = value
        return value


def wrappers() -> Table:
    """Measure one call of a function that costs almost nothing, through the wrappers of several benchmarks."""
    table = Table("a free function, n = 2, one point", "µs per call")
    free, x = Free(2), np.array([0.1, 0.2])
    calls: dict[str, Callable[[], object]] = {"bare": lambda: free.value(x)}
    counter, meter = Counter(free.value), MeteredProblem(free, Budget(evaluations=10**9))
    calls["a Python counter without checks"] = lambda: counter(x)
    calls["nfbench's meter: count, budget, bounds, best, trace"] = lambda: meter(x)
    missing = []
    try:
        import ioh

        wrapped = ioh.wrap_problem(lambda x: 1.0, "free", ioh.ProblemClass.REAL, dimension=2, lb=-5.0, ub=5.0)
        calls["ioh.wrap_problem, no logger"] = lambda: wrapped(x)
    except ImportError:
        missing.append("ioh")
    try:
        import cocoex

        sphere = cocoex.Suite("bbob", "", "dimensions:2 function_indices:1 instance_indices:1").get_problem(0)
        calls["cocoex, BBOB's sphere in C, no observer"] = lambda: sphere(x)
    except ImportError:
        missing.append("coco-experiment")
    for name, times in zip(calls, in_turn(list(calls.values()), [5000] * len(calls)), strict=True):
        table.add_row(name, f"{1e6 * statistics.median(times):.2f}")
    if missing:
        table.caption = f"not installed, so not compared: {', '.join(missing)}"
    return table
