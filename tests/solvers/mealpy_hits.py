"""Notes the evaluations to a target of mealpy's JADE and SHADE in mealpy_hits.json, for test_independent.py.

    pip install mealpy==3.0.3 && python tests/solvers/mealpy_hits.py

in an environment of its own (mealpy wants numpy <= 1.26); some minutes. mealpy's SHADE archives the trial vector where
the paper archives the parent it replaces; this is mended first.
"""

import inspect
import json
import logging
from pathlib import Path

import numpy as np
from mealpy import FloatVar
from mealpy.evolutionary_based import DE, SHADE

RUNS, N, BUDGET = 40, 60, 20_000


def sphere(z):
    return float((z * z).sum())


def rastrigin(z):
    return float((z * z + 20 * np.sin(np.pi * z) ** 2).sum())


class Reached(Exception):
    """The target."""


def mended_shade():
    source = inspect.getsource(SHADE)
    source = source[source.index("class OriginalSHADE") : source.index("class L_SHADE")]
    wrong = ["self.pop[idx] = pop[idx].copy()", "self.dyn_pop_archive.append(pop[idx].copy())"]
    right = ["self.dyn_pop_archive.append(self.pop[idx].copy())", "self.pop[idx] = pop[idx].copy()"]
    gap = "\n" + 16 * " "
    assert gap.join(wrong) in source
    names = dict(vars(SHADE))
    exec(source.replace(gap.join(wrong), gap.join(right)), names)
    return names["OriginalSHADE"]


def hits(make, function, target):
    for seed in range(RUNS):
        count = 0

        def objective(x):
            nonlocal count
            count += 1
            value = function(np.asarray(x))
            if value <= target:
                raise Reached
            return value

        box = FloatVar(lb=(-5.12,) * 6, ub=(5.12,) * 6)
        try:
            make().solve({"obj_func": objective, "bounds": box, "minmax": "min", "log_to": None}, seed=seed)
            count = BUDGET
        except Reached:
            pass
        yield min(count, BUDGET)


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    common = {"epoch": BUDGET // N, "pop_size": N, "miu_f": 0.5, "miu_cr": 0.5}
    shade = mended_shade()
    makers = {"jade": lambda: DE.JADE(**common, pt=0.05, ap=0.1), "shade": lambda: shade(**common)}
    noted = {
        f"{name} {function.__name__}": list(hits(make, function, target))
        for name, make in makers.items()
        for function, target in ((sphere, 1e-8), (rastrigin, 1e-6))
    }
    (Path(__file__).parent / "mealpy_hits.json").write_text(json.dumps(noted) + "\n")
