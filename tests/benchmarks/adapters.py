"""Wall-clock time per point of the optional libraries, on a sphere with 4 unknowns.

python tests/benchmarks/adapters.py
"""

import numpy as np
from rich.console import Console
from rich.table import Table

import nfbench
from nfbench import MissingExtra
from nfbench.problems.functions import Functions

ALGORITHMS = {
    "fcmaes": ("DE", "ACMA"),
    "minionpy": ("ARRDE", "LSHADE"),
    "nevergrad": ("DE", "TwoPointsDE", "CMA"),
    "optuna": ("cmaes", "nsgaii", "qmc", "tpe"),
    "pygmo": ("sade", "cmaes"),
    "pymoo": ("DE", "CMAES"),
}
BUDGETS = (1000, 2000)


def main() -> None:
    instance = Functions(function="sphere", dimension=4).draw(np.random.default_rng(1))
    table = Table("solver", "algorithm", *(f"µs per point, {budget} points" for budget in BUDGETS))
    for name, algorithms in ALGORITHMS.items():
        for algorithm in algorithms:
            try:
                solver = nfbench.solver(name, algorithm=algorithm)
            except MissingExtra as error:
                table.add_row(name, str(error))
                break
            minima = [nfbench.minimize(instance.problem, solver, budget, 1) for budget in BUDGETS]
            table.add_row(name, algorithm, *(f"{1e6 * found.runtime_s / found.evaluations:.0f}" for found in minima))
    Console().print(table)


if __name__ == "__main__":
    main()
