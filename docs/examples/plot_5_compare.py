"""
Compare solvers at equal budgets
================================

How many evaluations does each solver need on the same near-field problems? Success at the end of a long budget
separates solvers little; the evaluations until success separate them well.
"""

# %%
# Twelve scenes with two sources, one ESF problem each. The target is the value that a local search reaches from the
# true positions, plus one percent: within it a solver has found the right valley.

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize as local_search

import nfbench
from nfbench.problems.near_field.arrays import ULA
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField

scenario = NearField(
    array=ULA(elements=64, spacing_wavelengths=0.25, origin="center"),
    wavelength_m=0.02,
    sources=2,
    snapshots=100,
    snr_db=10.0,
    azimuth_deg=(-60.0, 60.0),
    range_m=(0.5, 5.0),
    min_separation_deg=3.0,
)


def problem_and_target(seed):
    scene = scenario.draw(np.random.default_rng(seed))
    subspace = np.linalg.svd(scene.Y, full_matrices=False)[0][:, : scene.sources]
    problem = SubspaceFit(np.ascontiguousarray(subspace), scene.manifold, scene.lower, scene.upper)
    bounds = list(zip(problem.lower, problem.upper, strict=True))
    reached = local_search(
        problem.value_and_gradient, scene.truth().ravel(), jac=True, bounds=bounds, method="L-BFGS-B"
    )
    return problem, 1.01 * reached.fun


problems = [problem_and_target(seed) for seed in range(12)]

# %%
# ``target`` in the budget ends a run as soon as it is reached.

BUDGET = 10_000
names = ("de", "scipy-de", "cmaes", "l-shade", "pso", "multistart-lbfgsb", "random-search")
reached = {}
for name in names:
    solver = nfbench.solver(name)
    runs = [
        nfbench.minimize(problem, solver, nfbench.Budget(evaluations=BUDGET, target=target), seed=seed)
        for problem, target in problems
        for seed in range(2)
    ]
    targets = [target for _, target in problems for _ in range(2)]
    hits = [run.evaluations for run, target in zip(runs, targets, strict=True) if run.value <= target]
    reached[name] = np.sort(hits)
    print(f"{name:18} {len(hits):2} of {len(runs)} reach the target, median {np.median(hits) if hits else np.nan:.0f}")

# %%
# The share of runs that have reached the target, against evaluations. A value together with its gradient counts as
# one evaluation, which favours ``multistart-lbfgsb``: see the note on cost in :doc:`/benchmarks`.

figure, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
styles = ["-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1))]
for (name, hits), style in zip(reached.items(), styles, strict=True):
    steps = np.concatenate([[1], hits, [BUDGET]])
    share = np.concatenate([[0], np.arange(1, len(hits) + 1), [len(hits)]]) / (2 * len(problems))
    axes.step(steps, share, where="post", label=name, ls=style, lw=1.8)
axes.set(xscale="log", xlim=(20, BUDGET), ylim=(-0.02, 1.02))
axes.set(xlabel="evaluations", ylabel="share of runs at the target")
axes.legend(fontsize=9, loc="upper left")
axes.grid(alpha=0.2, which="both")
plt.show()
