"""
What a solver has to search
===========================

The objectives of NEMO and NEEF over azimuth and range, for one scene with two sources. Both have valleys that are
narrow in azimuth and long in range, with sidelobes beside them and a plateau everywhere else.
"""

# %%
# The scene: two sources in line of sight.

import matplotlib.pyplot as plt
import numpy as np

from nfbench.problems.near_field.arrays import ULA
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField

scenario = NearField(
    array=ULA(elements=128, spacing_wavelengths=0.25, origin="center"),
    wavelength_m=0.02,
    sources=2,
    snapshots=200,
    snr_db=10.0,
    azimuth_deg=(-60.0, 60.0),
    range_m=(1.0, 20.0),
    positions=((-20.0, 4.0), (25.0, 8.0)),
)
scene = scenario.draw(np.random.default_rng(0))

# %%
# Evaluate on a grid. A problem takes a batch of points, one per row, and returns one value per row.

azimuth, range_ = np.radians(np.linspace(-60, 60, 361)), np.geomspace(1, 20, 200)
grid = np.stack(np.meshgrid(azimuth, range_), axis=-1).reshape(-1, 2)

rls = RLS(scene.Y, scene.manifold, scene.lower, scene.upper)
residual = rls.evaluate(grid).reshape(200, 361) / np.linalg.norm(scene.Y) ** 2

subspace = np.linalg.svd(scene.Y, full_matrices=False)[0][:, :2]
esf = SubspaceFit(np.ascontiguousarray(subspace), scene.manifold, scene.lower, scene.upper)
with_first = np.hstack([np.broadcast_to(scene.truth()[0], grid.shape), grid])
misfit = esf.evaluate(with_first).reshape(200, 361)

# %%
# Left: RLS, the energy that one source leaves unexplained, as a share of all. NEMO minimizes it once per source.
# Right: ESF with its first source held at the true position, so that two of the four unknowns can be shown. Stars
# are the true sources.

figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True, layout="constrained")
titles = ("RLS: unexplained share of the energy", "ESF, first source fixed")
for plot, values, title in zip(axes, (residual, misfit), titles, strict=True):
    shown = plot.pcolormesh(np.degrees(azimuth), range_, values, cmap="viridis", shading="auto", rasterized=True)
    figure.colorbar(shown, ax=plot)
    plot.plot(np.degrees(scene.truth()[:, 0]), scene.truth()[:, 1], "*", color="tab:red", mec="white", ms=13)
    plot.set(title=title, xlabel="azimuth [°]", yscale="log")
    plot.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
axes[0].set_ylabel("range [m]")
plt.show()

# %%
# Cuts through the second source show the two scales. In azimuth the valley is about two degrees wide, of 120 that
# are searched, and has sidelobes; in range it is metres wide.

theta = scene.truth()[1]
along_azimuth = np.column_stack([np.radians(np.linspace(15, 35, 2001)), np.full(2001, theta[1])])
along_range = np.column_stack([np.full(500, theta[0]), np.linspace(1, 20, 500)])
figure, axes = plt.subplots(1, 2, figsize=(10, 3.2), sharey=True, layout="constrained")
for plot, cut, column, scale, label in (
    (axes[0], along_azimuth, 0, np.degrees(1), "azimuth [°]"),
    (axes[1], along_range, 1, 1.0, "range [m]"),
):
    values = esf.evaluate(np.hstack([np.broadcast_to(scene.truth()[0], cut.shape), cut]))
    plot.plot(cut[:, column] * scale, values, lw=1.2)
    plot.axvline(theta[column] * scale, color="tab:red", ls="--", lw=1)
    plot.set(xlabel=label)
    plot.grid(alpha=0.2)
axes[0].set_ylabel("ESF")
plt.show()
