"""
Write and run your own solver
=============================

A solver is a frozen dataclass with one method. This one is a (μ, λ) evolution strategy in twenty lines. The guide
:doc:`/your-own-solver` explains the contract in full.
"""

# %%
# The fields are the options, with their limits. ``problem`` counts evaluations and ends the run at the budget, so
# there is no stopping rule to write. ``from_unit`` maps the unit cube to the box of the problem.

from dataclasses import dataclass
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np

import nfbench
from nfbench import Ge, Gt, Solver, SolverInfo
from nfbench.problems.functions import Functions


@dataclass(frozen=True)
class SmallES(Solver):
    """A (μ, λ) evolution strategy with one step size for all coordinates, restarted when the step has vanished.

    parents: μ. offspring: λ. step: the first step size, as a fraction of the box's width.
    """

    info = SolverInfo(batched=True, reference="Schwefel 1981")
    parents: Annotated[int, Ge(1)] = 6
    offspring: Annotated[int, Ge(2)] = 24
    step: Annotated[float, Gt(0.0)] = 0.2

    def minimize(self, problem, rng):
        n = problem.dimension
        while True:
            centre, step = rng.random(n), self.step
            while step > 1e-8:
                steps = step * np.exp(rng.standard_normal(self.offspring) / np.sqrt(n))
                U = np.clip(centre + steps[:, None] * rng.standard_normal((self.offspring, n)), 0, 1)
                best = np.argsort(problem.evaluate(problem.from_unit(U)))[: self.parents]
                centre, step = U[best].mean(axis=0), np.exp(np.log(steps[best]).mean())


# %%
# The options are checked when a solver is made:

try:
    SmallES(step=0.0)
except nfbench.OptionError as error:
    print(error)

# %%
# Run it beside two built-in solvers on the Rastrigin function in four dimensions, ten seeds each.

problem = Functions(function="rastrigin", dimension=4).draw(np.random.default_rng(1)).problem
solvers = {"SmallES": SmallES(), "de": nfbench.solver("de"), "cmaes": nfbench.solver("cmaes")}
checkpoints = np.geomspace(50, 8000, 100)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name, solver in solvers.items():
    traces = [nfbench.minimize(problem, solver, 8000, seed=seed).trace for seed in range(10)]
    curves = np.array(
        [t.values[np.maximum(np.searchsorted(t.evaluations, checkpoints, side="right") - 1, 0)] for t in traces]
    )
    low, middle, high = np.quantile(np.maximum(curves, 1e-12), [0.25, 0.5, 0.75], axis=0)
    (line,) = axes.plot(checkpoints, middle, label=name, lw=1.8)
    axes.fill_between(checkpoints, low, high, color=line.get_color(), alpha=0.15, lw=0)
axes.set(xscale="log", yscale="log", xlabel="evaluations", ylabel="best value so far")
axes.legend(title="median and quartiles", fontsize=9)
axes.grid(alpha=0.2, which="both")
plt.show()

# %%
# The conformance checks say whether a solver honours bounds, budget and seeds. ``nfbench check solver FILE`` runs
# all of them; here are three.

from nfbench.testing import solver_checks  # noqa: E402

for result in solver_checks(SmallES(), only=["budget", "bounds", "same-seed"]):
    print("ok  " if result.passed else "FAIL", result.name, result.message)
