"""
Where a source can be
=====================

The certificate of a scene, step by step: which parts of the box of one source remain once a good configuration is
known, and the proof that this configuration is the global minimum of ESF. The page :doc:`/certificate` has the
theorems.
"""

# %%
# A scene with three sources at 10 dB, and what a solver makes of it. The page uses the same symbols: *J* is the misfit
# over all sources, and *D* that of one.

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D

import nfbench
from nfbench.problems.near_field.arrays import ULA
from nfbench.problems.near_field.certificate import certify
from nfbench.problems.near_field.certificate.cells import cells_of
from nfbench.problems.near_field.certificate.regions import prune_box
from nfbench.problems.near_field.objectives.kernels import pack_rows
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField

scenario = NearField(
    array=ULA(elements=128, spacing_wavelengths=0.25, origin="center"),
    wavelength_m=0.02,
    sources=3,
    snapshots=200,
    snr_db=10.0,
    azimuth_deg=(-60.0, 60.0),
    range_m=(1.27, 20.16),
    positions=((-35.0, 4.0), (10.0, 8.0), (40.0, 12.0)),
)
scene = scenario.draw(np.random.default_rng(1))
K = scene.sources
U = np.ascontiguousarray(np.linalg.svd(scene.Y, full_matrices=False)[0][:, :K])
esf = SubspaceFit(U, scene.manifold, scene.lower, scene.upper)
found = nfbench.minimize(esf, nfbench.solver("cmaes"), nfbench.Budget(evaluations=60_000), seed=1)
print(f"CMA-ES: J = {found.value:.9f} after {found.evaluations:,} evaluations")

# %%
# Is there a lower value anywhere? ``certify`` needs the signal subspace, the array, the box of one source, and the
# configuration. It knows nothing of the true positions.

proof = certify(U, scene.manifold, scene.lower, scene.upper, found.x.reshape(K, 2))
print(f"certified: {proof.certified}, J = {proof.J:.9f}, lower by at most {proof.gap:.1e}")
print(f"{proof.regions} regions after {proof.evaluations:,} evaluations of D")

# %%
# Every source of every configuration with :math:`J \le f^\star` lies where :math:`D \le f^\star` (T1), here with
# :math:`f^\star` the value just found. Pruning (T3) leaves small boxes that hold all of that set.

share = 1 / 4  # of α: the length of the leaves
leaves = prune_box(cells_of(scene.manifold, scene.lower, scene.upper), pack_rows(U), proof.J + 1e-11, share)
sides = np.sin(scene.upper[0]) - np.sin(scene.lower[0]), 1 / scene.lower[1] - 1 / scene.upper[1]
area = 4 * leaves.halves.prod(axis=1).sum() / (sides[0] * sides[1] * scenario.wavelength_m)
print(f"{len(leaves.D)} boxes in {leaves.regions} regions are left, {area:.2%} of the box")

# %%
# The upper panel shows the whole box in the coordinates of the proof, with *D* in grey. The lower panels show the
# regions: the boxes that are left, and in red the set :math:`D \le f^\star` that they must hold. At its minimum *D* is
# not zero, because noise turns the signal subspace away from the responses.


def in_coordinates(theta):
    """The coordinates sin φ and 1/r of sources."""
    return np.column_stack([np.sin(theta[:, 0]), 1 / theta[:, 1]])


def shade(axes, u, kappa, outline=False):
    """Draw D in grey, dark where it is small, and the outline of D <= f*."""
    theta = np.stack(np.meshgrid(np.arcsin(u), 1 / kappa), axis=-1).reshape(-1, 2)
    energy = np.linalg.norm(scene.manifold.response(theta).conj() @ U, axis=1) ** 2
    D = (1 - energy / scene.manifold.elements).reshape(len(kappa), len(u))
    if outline:
        axes.contour(u, kappa, D, [proof.J], colors="tab:red", linewidths=2)
    limits = {"vmin": np.log10(proof.J) - 0.8, "vmax": 0.0}
    return axes.pcolormesh(u, kappa, np.log10(D), cmap=greys, shading="auto", rasterized=True, **limits)


def draw_boxes(axes, mine):
    for c, h in zip(centres[mine], halves[mine], strict=True):
        axes.add_patch(plt.Rectangle(c - h, *(2 * h), fill=False, edgecolor="k", lw=0.6))


greys = ListedColormap(plt.get_cmap("gray")(np.linspace(0.4, 1, 256)))
metres = np.array([1.0, scenario.wavelength_m])  # the boxes are in sin φ and λ/r
centres, halves = leaves.centres / metres, leaves.halves / metres
truth, estimates = in_coordinates(scene.truth()), in_coordinates(proof.theta)
corners = in_coordinates(np.array([[scene.lower[0], scene.upper[1]], [scene.upper[0], scene.lower[1]]]))
regions = sorted(range(leaves.regions), key=lambda k: centres[leaves.region == k, 0].mean())

figure = plt.figure(figsize=(9, 7.6), layout="constrained")
panels = figure.subplot_mosaic([["all"] * K, regions], height_ratios=[1, 1.2])
shown = shade(panels["all"], np.linspace(*corners[:, 0], 700), np.linspace(*corners[:, 1], 250))
panels["all"].set(xlabel="sin φ", ylabel="1/r [1/m]", title="The box of one source, and the regions that are left")
bar = figure.colorbar(shown, ax=panels["all"], pad=0.01, label="log₁₀ D")
bar.ax.axhline(np.log10(proof.J), color="tab:red", lw=2)
for number, k in enumerate(regions, start=1):
    axes, mine = panels[k], leaves.region == k
    low, high = (centres - halves)[mine].min(axis=0), (centres + halves)[mine].max(axis=0)
    window = np.clip([1.2 * low - 0.2 * high, 1.2 * high - 0.2 * low], *corners)
    shade(axes, np.linspace(*window[:, 0], 200), np.linspace(*window[:, 1], 200), outline=True)
    draw_boxes(axes, mine)
    axes.plot(*estimates.T, "o", color="white", mec="k", ms=10, mew=1.2)
    axes.plot(*truth.T, "x", color="tab:blue", ms=7, mew=2)
    axes.set(xlim=window[:, 0], ylim=window[:, 1], xlabel="sin φ", title=f"Region {number}")
    axes.locator_params(axis="x", nbins=3)
    draw_boxes(panels["all"], mine)
    panels["all"].annotate(f"{number}", (high + low) / 2, xytext=(9, 9), textcoords="offset points", weight="bold")
panels[regions[0]].set_ylabel("1/r [1/m]")
keys = [
    Line2D([], [], color="k", lw=0.8, label="boxes that are left"),
    Line2D([], [], color="tab:red", lw=2, label="D = f*"),
    Line2D([], [], color="tab:blue", marker="x", ls="", ms=7, mew=2, label="true source"),
    Line2D([], [], color="white", marker="o", mec="k", ls="", ms=10, mew=1.2, label="minimum of ESF"),
]
figure.legend(handles=keys, loc="outside lower center", ncols=4, frameon=False)
plt.show()
