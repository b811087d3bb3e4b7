"""
Arrays, angles and ranges
=========================

Where the sources are, in which direction angles grow, and where the near field ends. The page :doc:`/conventions`
states the same in formulas.
"""

# %%
# A source is a row ``[azimuth, range]`` in the plane, or ``[azimuth, elevation, range]`` in space, in radians and
# metres. The built-in linear array lies along *y*, and azimuth 0 points along *x*, perpendicular to the array.

import matplotlib.pyplot as plt
import numpy as np

from nfbench.problems.near_field.arrays import UCA, ULA, UPA
from nfbench.problems.near_field.geometry import cartesian

wavelength = 0.02  # m
array = ULA(elements=128, spacing_wavelengths=0.25, origin="first")
elements = array.place(wavelength)  # (M, 3), in metres from the origin
sources = np.array([[np.radians(-35), 4.0], [np.radians(10), 8.0], [np.radians(40), 12.0]])
positions = cartesian(sources)

aperture = np.ptp(elements[:, 1])
fraunhofer = 2 * aperture**2 / wavelength
print(f"aperture D = {aperture:.3f} m, Fraunhofer distance 2D²/λ = {fraunhofer:.1f} m")

# %%
# Seen from above, the scene of the quickstart study. Azimuth grows from *x* towards *y*, counter-clockwise. Sources
# are drawn from the shaded box: azimuth within ±60°, range between 1.27 m (two apertures) and 20.16 m (half the
# Fraunhofer distance).

azimuth = np.radians(np.linspace(-60, 60, 200))
near = cartesian(np.column_stack([azimuth, np.full(200, 1.27)]))
far = cartesian(np.column_stack([azimuth, np.full(200, 20.16)]))
rim = np.concatenate([near, far[::-1], near[:1]])

figure, axes = plt.subplots(figsize=(6.4, 8.2), layout="constrained")
axes.fill(rim[:, 0], rim[:, 1], facecolor="tab:blue", alpha=0.08)
axes.plot(rim[:, 0], rim[:, 1], color="tab:blue", lw=0.8, alpha=0.5)
axes.annotate("", (21.5, 0), (0, 0), arrowprops={"arrowstyle": "->", "lw": 1})
axes.text(15.8, -1.1, "x, broadside (φ = 0)", fontsize=9)
axes.plot(elements[:, 0], elements[:, 1], "s", color="k", ms=2.5)
axes.annotate(
    "array along y,\norigin at its first element",
    (0, -0.1),
    xytext=(-1.6, -5.2),
    fontsize=9,
    arrowprops={"arrowstyle": "-", "lw": 0.6},
)
for number, ((phi, r), p) in enumerate(zip(sources, positions, strict=True), start=1):
    axes.plot([0, p[0]], [0, p[1]], color="tab:blue", lw=0.8)
    axes.plot(p[0], p[1], "*", color="tab:red", ms=13)
    label = f"source {number}\nφ = {np.degrees(phi):+.0f}°, r = {r:g} m"
    axes.annotate(label, p[:2], xytext=(10, -3), textcoords="offset points", fontsize=9)
turn = np.radians(np.linspace(0, 40, 50))
axes.plot(6 * np.cos(turn), 6 * np.sin(turn), color="k", lw=1)
axes.text(5.9, 2.6, "azimuth φ > 0", fontsize=9)
axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(-2, 23), ylim=(-18.5, 18.5), aspect="equal")
axes.grid(alpha=0.2)
plt.show()

# %%
# The built-in arrays, with their origin. Ranges and angles are measured from the origin, which is either the first
# element or the centre.

kinds = {
    "ula, origin = first": ULA(elements=8, spacing_wavelengths=0.5, origin="first"),
    "upa, origin = center": UPA(columns=4, rows=3, spacing_wavelengths=0.5, origin="center"),
    "uca, origin = center": UCA(elements=8, radius_wavelengths=0.7, origin="center"),
}
figure = plt.figure(figsize=(9, 3.6), layout="constrained")
for number, (title, kind) in enumerate(kinds.items(), start=1):
    axes = figure.add_subplot(1, 3, number, projection="3d")
    q = kind.place(wavelength) * 1000
    axes.scatter(*q.T, color="k", s=18, depthshade=False)
    axes.scatter(0, 0, 0, color="tab:red", marker="+", s=120, linewidths=2)
    axes.set_title(title, fontsize=10)
    low, high = min(q.min(), -15), max(q.max(), 15)
    axes.set(xlim=(low, high), ylim=(low, high), zlim=(low, high))
    axes.set_xlabel("x [mm]", fontsize=8)
    axes.set_ylabel("y [mm]", fontsize=8)
    axes.set_zlabel("z [mm]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.locator_params(nbins=4)
    axes.view_init(22, -55)
plt.show()

# %%
# Close to the array the phase along the elements is curved, and the curvature carries the range. This is the
# difference to a plane wave, in wavelengths, for a source at broadside of the centred array.

centred = ULA(elements=128, spacing_wavelengths=0.25, origin="center").place(wavelength)[:, 1]
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for r in (1.27, 5.0, 20.16, fraunhofer):
    excess = (np.hypot(r, centred) - r) / wavelength
    axes.plot(centred, excess, label=f"r = {r:.3g} m")
axes.set(xlabel="element position y [m]", ylabel="extra path [λ]")
axes.legend(fontsize=9)
axes.grid(alpha=0.2)
plt.show()
