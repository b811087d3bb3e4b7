"""Overhead of the meter: ``python tests/benchmarks/meter.py``.

Single points and batches of 100 are evaluated alternately with and without the meter, at the same points; the result is
the median of the paired differences. ESF of the paper's ULA shows the cost of a typical evaluation for comparison.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

import numpy as np
from kernels import PLANE
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits
from timing import seconds

from nfbench import Budget, MeteredProblem, Problem
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.subspace import signal_subspace

ROUNDS = 41


class Free(Problem):
    """A problem whose evaluation costs almost nothing, so that the overhead of the meter remains."""

    def __init__(self, n: int) -> None:
        self.lower, self.upper = np.full(n, -1.0), np.full(n, 1.0)
        self._values = np.ones(100)

    def evaluate(self, X: np.ndarray) -> np.ndarray:
        return self._values[: len(X)]

    def value(self, x: np.ndarray) -> float:
        return 1.0


def paired(bare: Callable[[], object], metered: Callable[[], object], number: int) -> tuple[float, float]:
    """Return the median time of the bare call and the median additional time of the metered call [µs]."""
    rounds = [(seconds(bare, number), seconds(metered, number)) for _ in range(ROUNDS)]
    return 1e6 * statistics.median(b for b, _ in rounds), 1e6 * statistics.median(m - b for b, m in rounds)


def main() -> None:
    table = Table("problem", "call", "bare µs", "meter adds µs", "share")
    rng = np.random.default_rng(0)
    instance = PLANE.draw(rng)
    esf = SubspaceFit(signal_subspace(instance.Y, 3), instance.manifold, instance.lower, instance.upper)
    for name, problem, number in (
        ("free, n = 2", Free(2), 2000),
        ("free, n = 6", Free(6), 2000),
        ("ESF, n = 6", esf, 200),
    ):
        X = rng.uniform(problem.lower, problem.upper, (100, len(problem.lower)))
        meter = MeteredProblem(problem, Budget(evaluations=10**9))
        x = X[0]
        for call, bare, metered, count in (
            ("one point", lambda p=problem, x=x: p.value(x), lambda m=meter, x=x: m(x), number),
            ("batch of 100", lambda p=problem, X=X: p.evaluate(X), lambda m=meter, X=X: m.evaluate(X), number // 20),
        ):
            cost, extra = paired(bare, metered, count)
            table.add_row(name, call, f"{cost:.2f}", f"{extra:.2f}", f"{extra / (cost + extra):.1%}")
    Console().print(table)


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
