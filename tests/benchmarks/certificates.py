"""Localization in numbers: ``OMP_NUM_THREADS=1 python tests/benchmarks/certificates.py [scenes]`` prints the tables.

The first are those of ``localization.py``. The next has, for each array and SNR, the share of certified scenes, the
time of a whole ``solve`` of ``certified`` from Y as a median over the scenes, the same as a multiple of that of
grid-refine, measured in turn, and the evaluations of D. The next has the accuracy of the three objectives in line of
sight, as pooled RMSE ÷ pooled stochastic bound over the same scenes, and the last that of NEMO with and without
relaxation, where each search is a grid with a local search. Processor times, one thread.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from kernels import PLANE, SPACE
from localization import minima, speed
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits
from timing import ratio

from nfbench import minimize
from nfbench.execution.environment import describe_environment
from nfbench.problems.near_field.arrays import ULA
from nfbench.problems.near_field.estimators.certified import Certified
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import resolution_grid

APART = 2.0  # degrees
CENTRED = replace(
    PLANE,
    array=ULA(elements=128, spacing_wavelengths=0.25, origin="center"),
    wavefront="exact",
    min_separation_deg=APART,
)
FIRST = replace(
    PLANE,
    array=ULA(elements=128, spacing_wavelengths=0.25, origin="first"),
    wavefront="paper",
    min_separation_deg=APART,
)
PLANAR = replace(SPACE, snapshots=200, min_separation_deg=APART)
FADING = {"rician_k": 10.0, "fading": "block"}
CASES: dict[str, tuple[NearField, tuple[float, ...]]] = {  # and the SNRs [dB]
    "ULA 128, exact, centre": (CENTRED, (-5.0, 0.0, 10.0, 20.0, 30.0, 40.0)),
    "ULA 128, paper, first": (FIRST, (0.0, 10.0, 20.0)),
    "UPA 16×16": (PLANAR, (0.0, 10.0, 20.0, 30.0)),
    "ULA 128, 5 sources": (replace(CENTRED, sources=5), (0.0, 20.0)),
    "ULA 128, block fading κ = 100": (replace(CENTRED, rician_k=100.0, fading="block"), (20.0,)),
    "ULA 128, block fading κ = 10": (replace(CENTRED, **FADING), (20.0,)),
    "ULA 128, paper, first, block fading κ = 10": (replace(FIRST, **FADING), (20.0,)),
}
RARE = {"ULA 128, paper, first, block fading κ = 10": 15}  # times as many scenes, as few are certified


def certificates(count: int) -> Table:
    table = Table("certified", "dB", "scenes", "certified", "ms", "÷ grid-refine", "evaluations of D", "largest gap")
    for name, (scenario, levels) in CASES.items():
        for level in levels:
            times: list[list[float]] = [[], []]
            found: list[dict[str, float]] = []
            scenes = count * RARE.get(name, 1)
            for seed in range(scenes):
                instance = replace(scenario, snr_db=level).draw(np.random.default_rng(seed))
                for each, formulation in zip(times, (Certified(), GridRefine()), strict=True):
                    start = time.thread_time()
                    solution = formulation.solve(instance, minimize)  # type: ignore[arg-type]  # it never minimizes
                    each.append(time.thread_time() - start)
                    found += [dict(solution.columns)] if "certified" in solution.columns else []
            proven = [columns["certified_gap"] for columns in found if columns["certified"]]
            table.add_row(
                name,
                f"{level:g}",
                f"{scenes}",
                f"{len(proven)}",
                f"{1e3 * statistics.median(times[0]):.2f}",
                f"{ratio(*times):.1f}",
                f"{statistics.median(columns['certificate_evaluations'] for columns in found):.0f}",
                f"{max(proven, default=math.nan):.0e}",
            )
    return table


def accuracy(count: int) -> Table:
    table = Table("RMSE ÷ bound, 20 dB, line of sight", "scenes", "esf", "wsf", "dml")
    for name, scenario in {"no separation": replace(FIRST, min_separation_deg=0.0), "2° apart": FIRST}.items():
        squares = dict.fromkeys(("esf", "wsf", "dml"), 0.0)
        bound = 0.0
        for seed in range(count):
            instance = replace(scenario, snr_db=20.0).draw(np.random.default_rng(seed))
            bound += instance.bounds()["crb_m"] ** 2
            for objective in squares:
                estimate = GridRefine(objective=objective).solve(instance, minimize).estimate  # type: ignore[arg-type]
                squares[objective] += instance.score(estimate)["rmse_m"] ** 2
        table.add_row(name, f"{count}", *(f"{math.sqrt(square / bound):.2f}" for square in squares.values()))
    return table


def relaxation(count: int) -> Table:
    table = Table("RMSE ÷ bound, line of sight, 2° apart", "scenes", "0 dB", "10 dB", "20 dB", "30 dB")
    for name, sweeps in {"NEMO": 0, "NEMO, relax = 5": 5}.items():
        ratios = []
        for level in (0.0, 10.0, 20.0, 30.0):
            square = bound = 0.0
            for seed in range(count):
                instance = replace(FIRST, snr_db=level).draw(np.random.default_rng(seed))
                grid = resolution_grid(instance.manifold, instance.lower, instance.upper, 2.0)
                search = lambda problem, grid=grid: SimpleNamespace(x=grid[np.argmin(problem.evaluate(grid))])  # noqa: E731
                estimate = Nemo(relax=sweeps, refine=True, alpha=0.0).solve(instance, search)
                square += instance.score(estimate)["rmse_m"] ** 2
                bound += instance.bounds()["crb_m"] ** 2
            ratios.append(math.sqrt(square / bound))
        table.add_row(name, f"{count}", *(f"{each:.2f}" for each in ratios))
    return table


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    console = Console(width=130)
    console.print(f"{describe_environment()['cpu']}, one thread, 3 sources {APART:g}° apart where not stated")
    for table in (speed(), minima(count / 100), certificates(count), accuracy(10 * count), relaxation(count)):
        console.print(table)


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
