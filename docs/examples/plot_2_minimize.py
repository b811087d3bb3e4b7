"""
Minimize one problem
====================

The smallest use of nfbench from Python: draw a scene, make a problem of it, let a solver work on it within a
budget, and look at how the objective fell.
"""

# %%
# A scenario describes what is measured. ``draw`` returns one scene of it: the data, and the truth to score against.

import matplotlib.pyplot as plt
import numpy as np

import nfbench
from nfbench.problems.near_field.arrays import ULA
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField

scenario = NearField(
    array=ULA(elements=64, spacing_wavelengths=0.25, origin="center"),
    wavelength_m=0.02,
    sources=2,
    snapshots=100,
    snr_db=15.0,
    azimuth_deg=(-60.0, 60.0),
    range_m=(0.5, 5.0),
)
scene = scenario.draw(np.random.default_rng(3))
print("true sources [rad, m]:\n", scene.truth().round(3))

# %%
# NEEF minimizes eigen-subspace fitting (ESF) over all sources at once: four unknowns here. ESF needs the signal
# subspace, which is spanned by the strongest left singular vectors of the data.

subspace = np.linalg.svd(scene.Y, full_matrices=False)[0][:, : scene.sources]
problem = SubspaceFit(np.ascontiguousarray(subspace), scene.manifold, scene.lower, scene.upper)

budget = nfbench.Budget(evaluations=8_000)
solvers = {name: nfbench.solver(name) for name in ("de", "cmaes", "scipy-de", "random-search")}
found = {name: nfbench.minimize(problem, solver, budget, seed=1) for name, solver in solvers.items()}
for name, minimum in found.items():
    error = scene.score(minimum.x.reshape(scene.sources, 2))["rmse_m"]
    print(f"{name:14} J = {minimum.value:.6f} after {minimum.evaluations} evaluations, error {error:.3f} m")

# %%
# Every minimum carries its trace: the best value so far against the number of evaluations. The dashed line is the
# objective at the true positions. The global minimum lies slightly below it, because noise moves it away from the
# truth. CMA-ES does not find it within this budget with this seed. One run says little about a solver, which is why a
# study compares solvers over many scenes.

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name, minimum in found.items():
    trace = minimum.trace
    axes.step(trace.evaluations, trace.values, where="post", label=name)
axes.axhline(problem.value(scene.truth().ravel()), color="k", ls="--", lw=1, label="at the true positions")
axes.set(xscale="log", yscale="log", xlabel="evaluations", ylabel="best ESF value so far")
axes.legend(fontsize=9)
axes.grid(alpha=0.2, which="both")
plt.show()
