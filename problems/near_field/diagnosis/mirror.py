"""Where the mirror images of estimates are that a line or a plane of elements cannot distinguish from them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ..geometry import Frame, azimuth_near, directions, flatness
from ..wavefronts import Manifold

__all__ = ["mirror_notes"]

FLAT = 0.02  # deviation from a line or plane [wavelengths, root mean square] that phases do not show
ASIDE = 0.02  # cosine from which a direction is on one side of a plane, and a plane is seen from its front


def mirror_notes(
    theta: Float[ndarray, "k d"],
    manifold: Manifold,
    frame: Frame,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> list[str]:
    """Return a sentence with the mirror images of estimates on the back of a line or plane of elements.

    An array whose broadside lies in its plane has no back; then the images of all estimates are returned. Images inside
    the box are left out, as the box is warned of.

    theta: estimated sources [rad, m], shape (K, d).
    manifold: array and wavefront model.
    frame: coordinates in which the user describes the array.
    lower, upper: bounds of one source [rad, m], shape (d,).
    """
    Q, has_elevation = manifold.positions, theta.shape[1] == 3
    seen = Q if has_elevation else Q * [1.0, 1.0, 0.0]
    tolerance = FLAT * manifold.wavelength_m
    if not len(theta) or np.linalg.norm(np.ptp(seen, axis=0)) <= tolerance:
        return []
    rank, axes = flatness(seen, tolerance)
    if rank == 3 or (rank == 2 and not has_elevation):
        return []
    u = directions(theta)
    if rank == 2:
        front, mirrored = axes[2], u - 2 * np.outer(u @ axes[2], axes[2])
    else:
        front, mirrored = np.array([1.0, 0, 0]) - axes[0, 0] * axes[0], 2 * np.outer(u @ axes[0], axes[0]) - u
        front = front / max(float(np.linalg.norm(front)), ASIDE)
    front = front if front[0] >= 0 else -front
    side = u @ front
    hidden: ndarray = np.where(front[0] > ASIDE, side, -np.abs(side)) < -ASIDE
    level = np.abs((u - mirrored) @ Q.T).max(axis=1) < 10 * tolerance  # the plane contains the origin
    hidden = hidden & level & ~_in_box(mirrored, lower, upper)
    if not hidden.any():
        return []
    places = frame.outward(theta[hidden, -1:] * mirrored[hidden])
    listed = " and ".join(f"({x:.4g}, {y:.4g}, {z:.4g}) m" for x, y, z in places)
    which = " and ".join(str(k + 1) for k in np.flatnonzero(hidden))
    many = bool(hidden.sum() > 1)
    return [
        f"the elements lie {'in a plane' if rank == 2 else 'on a line'}, so that the mirror image{'s' * many} of "
        f"source{'s' * many} {which} on the other side, at {listed}, fit{'s' * (not many)} equally well"
    ]


def _in_box(u: Float[ndarray, "k 3"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> ndarray:
    azimuth = azimuth_near(np.arctan2(u[:, 1], u[:, 0]), (lower[0] + upper[0]) / 2)
    angles = np.column_stack([azimuth, np.arcsin(np.clip(u[:, 2], -1.0, 1.0))])[:, : len(lower) - 1]
    return np.asarray(((angles >= lower[:-1]) & (angles <= upper[:-1])).all(axis=1))
