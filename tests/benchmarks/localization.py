"""Speed of a localization: ``OMP_NUM_THREADS=1 python tests/benchmarks/localization.py`` prints the tables.

The first table has the time of a whole ``solve`` of grid-refine from Y, of its parts, and of NEEF-DE with 60,000
evaluations, on the same scenes in turn, as medians over the scenes. Times are those of the processor: on a shared
machine, a long call is interrupted more often than a short one, which would flatter the ratio. Each scene is used once,
so that its data come from memory. "target" is what a quiet machine should reach.

The second table counts the scenes in which grid-refine ends at the best known minimum of its objective, to within a
millionth: the smallest of its own and of what L-BFGS-B finds from the true sources and from the estimate.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from kernels import PLANE, SPACE
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits
from timing import ratio

from nfbench import minimize
from nfbench.execution.environment import describe_environment
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.neef import Neef
from nfbench.problems.near_field.estimators.refinement import _refine_by_quasi_newton, refine
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import response_grid, search_greedily
from nfbench.problems.near_field.subspace import compress, decompose
from nfbench.solvers.de import DE

EVALUATIONS = 60_000
SCENES = 30
SAME = 1e-6  # relative difference of J up to which two minima are the same

LINE_OF_SIGHT = {
    "ULA 128": (replace(PLANE, min_separation_deg=2.0), 0.8, 300),
    "UPA 16×16": (replace(SPACE, min_separation_deg=2.0), 1.5, 200),
}
"""The scenario of each case, the target of its time [ms], and the number of scenes in which minima are compared."""


def scenes(scenario: NearField, count: int) -> list[NearFieldInstance]:
    return [scenario.draw(np.random.default_rng(seed)) for seed in range(count)]


def neef_de(instance: NearFieldInstance) -> object:
    return Neef().solve(instance, lambda problem: minimize(problem, DE(population=120), EVALUATIONS, seed=1))


def parts(instance: NearFieldInstance) -> list[Callable[[], object]]:
    """Return the whole, NEEF-DE, the two parts of the whole, the subspace by SVD, and both local searches."""
    U_s = decompose(instance.Y, instance.sources).U_s
    grid = response_grid(instance.manifold, instance.lower, instance.upper, GridRefine.density)
    esf = SubspaceFit(U_s, instance.manifold, instance.lower, instance.upper)
    start = search_greedily(U_s, grid, instance.sources, 0).x * 1.0005
    start = np.clip(start, esf.lower, esf.upper)
    return [
        partial(GridRefine().solve, instance, minimize),  # type: ignore[arg-type]  # it never minimizes
        partial(neef_de, instance),
        partial(decompose, instance.Y, instance.sources),
        partial(search_greedily, U_s, grid, instance.sources, 5),
        lambda: np.linalg.svd(compress(instance.Y), full_matrices=False),
        partial(refine, esf, start, instance.manifold),
        partial(_refine_by_quasi_newton, esf, start, instance.manifold),
    ]


def speed() -> Table:
    columns = ("grid-refine ms", "target ms", "NEEF-DE ms", "ratio", "target", "subspace ms", "÷ SVD", "search ms")
    table = Table("whole solve, K = 3, 20 dB", *columns, "local search µs", "÷ L-BFGS-B")
    for name, (scenario, target, _) in LINE_OF_SIGHT.items():
        timed: list[list[float]] = [[] for _ in range(7)]
        for calls in [parts(instance) for instance in scenes(scenario, SCENES)]:
            for times, call in zip(timed, calls, strict=True):
                start = time.thread_time()
                call()
                times.append(time.thread_time() - start)
        whole, de, subspace, search, svd, local, slow = timed
        table.add_row(
            name,
            f"{1e3 * statistics.median(whole):.2f}",
            f"{target}",
            f"{1e3 * statistics.median(de):.1f}",
            f"{ratio(de, whole):.0f}",
            "40",
            f"{1e3 * statistics.median(subspace):.2f}",
            f"{ratio(svd, subspace):.1f}",
            f"{1e3 * statistics.median(search):.2f}",
            f"{1e6 * statistics.median(local):.0f}",
            f"{ratio(slow, local):.0f}",
        )
    return table


def excess(instance: NearFieldInstance, options: dict) -> float:
    """Return the relative difference of J of grid-refine from the best known minimum."""
    esf = SubspaceFit(decompose(instance.Y, instance.sources).U_s, instance.manifold, instance.lower, instance.upper)
    x = GridRefine(**options).solve(instance, minimize).estimate.ravel()  # type: ignore[arg-type]
    others = [_refine_by_quasi_newton(esf, start, instance.manifold) for start in (x, instance.theta.ravel())]
    J = esf.value(x)
    return J / min(J, *map(esf.value, others)) - 1


def minima(share: float) -> Table:
    table = Table("grid-refine at the best known minimum", "scenes", "same", "worst excess")
    cases = {
        **{name: (scenario, count, {}) for name, (scenario, _, count) in LINE_OF_SIGHT.items()},
        "ULA 128, block fading κ = 10": (replace(PLANE, rician_k=10.0, fading="block"), 100, {}),
        "ULA 128, no separation": (PLANE, 300, {}),
        "ULA 128, −10 dB": (replace(PLANE, snr_db=-10.0, min_separation_deg=2.0), 100, {}),
        "UPA 16×16, block fading κ = 10": (replace(SPACE, rician_k=10.0, fading="block"), 50, {}),
        "ULA 128, no sweep": (PLANE, 300, {"sweeps": 0}),
    }
    for name, (scenario, count, options) in cases.items():
        found = [excess(instance, options) for instance in scenes(scenario, max(int(share * count), 1))]
        table.add_row(name, f"{len(found)}", f"{sum(e <= SAME for e in found)}", f"{max(found):.0e}")
    return table


def main() -> None:
    """Print the tables; a number after the command is the share of the scenes in which minima are compared."""
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    console = Console(width=150)
    console.print(f"{describe_environment()['cpu']}, one thread, line of sight, sources 2° apart")
    console.print(speed())
    console.print(minima(share))


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
