"""Record the numbers of evaluations that mealpy's JADE and SHADE need to reach a target, for test_independent.py.

The results are written to mealpy_hits.json. Run in a separate environment, because mealpy requires numpy <= 1.26:

    pip install mealpy==3.0.3 coco-experiment==2.8.2 && python tests/solvers/mealpy_hits.py

This takes about 15 minutes. mealpy's SHADE archives the trial vector, whereas the paper archives the parent that it
replaces; the script fixes this first.
"""

import inspect
import json
import logging
from functools import partial
from pathlib import Path

import numpy as np
from cocoex import BareProblem
from mealpy import FloatVar
from mealpy.evolutionary_based import DE, SHADE

RUNS, N = 60, 60


def sphere(z):
    return float((z * z).sum())


def rastrigin(z):
    return float((z * z + 20 * np.sin(np.pi * z) ** 2).sum())


def bbob(function, n, instance):
    """Return the function f - f_opt."""
    problem = BareProblem("bbob", function, n, instance)
    return lambda x: float(problem(x)) - problem.best_value()


TASKS = {  # function, unknowns, half the box, target, budget
    "sphere": (sphere, 6, 5.12, 1e-8, 20_000),
    "rastrigin": (rastrigin, 6, 5.12, 1e-6, 20_000),
    "10": (bbob(10, 5, 12), 5, 5.0, 1e-6, 20_000),
    "15": (bbob(15, 3, 5), 3, 5.0, 1e-6, 60_000),
}


class Reached(Exception):
    """Raised when the target is reached."""


def corrected_shade():
    source = inspect.getsource(SHADE)
    source = source[source.index("class OriginalSHADE") : source.index("class L_SHADE")]
    wrong = ["self.pop[idx] = pop[idx].copy()", "self.dyn_pop_archive.append(pop[idx].copy())"]
    right = ["self.dyn_pop_archive.append(self.pop[idx].copy())", "self.pop[idx] = pop[idx].copy()"]
    gap = "\n" + 16 * " "
    assert gap.join(wrong) in source
    names = dict(vars(SHADE))
    exec(source.replace(gap.join(wrong), gap.join(right)), names)
    return names["OriginalSHADE"]


def hits(make, function, n, half, target, budget):
    for seed in range(RUNS):
        count = 0

        def objective(x):
            nonlocal count
            count += 1
            value = function(np.asarray(x))
            if value <= target:
                raise Reached
            return value

        box = FloatVar(lb=(-half,) * n, ub=(half,) * n)
        np.random.seed(seed)  # noqa: NPY002 -- mealpy draws F with SciPy from the global state
        optimizer = make(epoch=budget // N, pop_size=N, miu_f=0.5, miu_cr=0.5)
        try:
            optimizer.solve({"obj_func": objective, "bounds": box, "minmax": "min", "log_to": None}, seed=seed)
            count = budget
        except Reached:
            pass
        yield min(count, budget)


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    makers = {"jade": partial(DE.JADE, pt=0.05, ap=0.1), "shade": corrected_shade()}
    recorded = {f"{name} {task}": list(hits(make, *TASKS[task])) for name, make in makers.items() for task in TASKS}
    (Path(__file__).parent / "mealpy_hits.json").write_text(json.dumps(recorded) + "\n")
