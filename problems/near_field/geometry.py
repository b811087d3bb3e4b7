"""The coordinate system: the position of a source with given angles and range.

A source is a row ``theta``: ``[azimuth, range]`` in 2D, ``[azimuth, elevation, range]`` in 3D, in radians and metres.
The x axis points to the broadside of the built-in ULA and UPA, the y axis along the ULA, and the z axis upwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import KDTree

__all__ = [
    "Frame",
    "ambiguity",
    "azimuth_near",
    "cartesian",
    "direction_derivatives",
    "directions",
    "flatness",
    "nearest_distances",
]


@dataclass(frozen=True, eq=False)
class Frame:
    """The coordinates in which a user describes an array, related to those of this module.

    axes: unit vectors of the x (broadside), y and z (up) axes of this module, one per row, in the user's coordinates.
    origin: point from which ranges and angles are measured, in the user's coordinates [m].
    """

    axes: Float[ndarray, "3 3"]
    origin: Float[ndarray, " 3"]

    def inward(self, points: Float[ndarray, "*p 3"]) -> Float[ndarray, "*p 3"]:
        """Return points given in the user's coordinates in those of this module [m]."""
        p: ndarray = (points - self.origin) @ self.axes.T
        return p

    def outward(self, points: Float[ndarray, "*p 3"]) -> Float[ndarray, "*p 3"]:
        """Return points given in the coordinates of this module in those of the user [m]."""
        p: ndarray = points @ self.axes + self.origin
        return p


def directions(theta: Float[ndarray, "*p d"]) -> Float[ndarray, "*p 3"]:
    """Return the unit vectors u = [cosψ cosφ, cosψ sinφ, sinψ] from the origin to the sources ``theta`` [rad, m]."""
    u = np.zeros((*theta.shape[:-1], 3))
    azimuth = theta[..., 0]
    np.cos(azimuth, out=u[..., 0])
    np.sin(azimuth, out=u[..., 1])
    if theta.shape[-1] == 3:
        elevation = theta[..., 1]
        u[..., :2] *= np.cos(elevation)[..., None]
        np.sin(elevation, out=u[..., 2])
    return u


def direction_derivatives(theta: Float[ndarray, "p d"]) -> Float[ndarray, "p angles 3"]:
    """Return the derivatives of the unit vectors with respect to azimuth (and elevation) [1/rad]."""
    azimuth = theta[:, 0]
    elevation = theta[:, 1] if theta.shape[-1] == 3 else np.zeros_like(azimuth)
    cos_a, sin_a, cos_e, sin_e = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    by_azimuth = np.stack([-cos_e * sin_a, cos_e * cos_a, np.zeros_like(azimuth)], axis=-1)
    by_elevation = np.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e], axis=-1)
    return np.stack([by_azimuth, by_elevation][: theta.shape[-1] - 1], axis=1)


def cartesian(theta: Float[ndarray, "*p d"]) -> Float[ndarray, "*p 3"]:
    """Return the positions p = r·u [m] of sources ``theta`` [rad, m]."""
    p: ndarray = theta[..., -1:] * directions(theta)
    return p


def azimuth_near(azimuth: Float[ndarray, "*p"], near: Float[ndarray, "*p"] | float) -> Float[ndarray, "*p"]:
    """Return azimuths [rad] that differ by full turns from the given ones, and by at most half a turn from ``near``."""
    turned: ndarray = azimuth + 2 * np.pi * np.round((near - azimuth) / (2 * np.pi))
    return turned


def nearest_distances(Q: Float[ndarray, "m 3"]) -> Float[ndarray, " m"]:
    """Return the distance [m] from each element to its nearest neighbour."""
    distances = np.asarray(KDTree(Q).query(Q, k=2)[0])  # of the element itself, and of its neighbour
    return np.asarray(distances[:, 1])


def flatness(Q: Float[ndarray, "m 3"], tolerance: float) -> tuple[int, Float[ndarray, "3 3"]]:
    """Return whether the elements lie on a line (1), in a plane (2) or neither (3), and orthonormal axes.

    The elements extend along the first rows of the axes; the other rows are perpendicular to them. A deviation
    (root mean square) of up to ``tolerance`` [m], or of a millionth of the extent, is ignored.
    """
    centred = Q - Q.mean(axis=0)
    values, V = np.linalg.eigh(centred.T @ centred / len(Q))
    spread = np.sqrt(np.maximum(values[::-1], 0.0))
    rank = int(np.sum(spread > min(max(tolerance, 1e-6 * spread[0]), spread[0] / 2)))
    return rank, V.T[::-1]


def ambiguity(
    Q: Float[ndarray, "m 3"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], tolerance: float
) -> tuple[str, Float[ndarray, "two angles"]] | None:
    """Return the shape of an array that cannot distinguish two directions in a box, and two such directions [rad].

    The shape is "line" or "plane"; the result is None if there are no such directions. Two directions u and u' have the
    same distances to all elements at every range if (u − u')·q_m = 0 for all of them.

    Q: element positions relative to the origin [m].
    lower: lower bounds of one source [rad, m].
    upper: upper bounds of one source [rad, m].
    tolerance: deviation from a line or plane [m] that is ignored.
    """
    has_elevation = len(lower) == 3
    seen = Q if has_elevation else Q * [1.0, 1.0, 0.0]  # sources at z = 0 do not show the heights of the elements
    extent = np.linalg.norm(np.ptp(seen, axis=0))
    if extent <= tolerance:
        return "line", np.array([[angle] for angle in (lower[0], upper[0])])  # along z
    rank, axes = flatness(seen, tolerance)
    if rank == 3 or (rank == 2 and not has_elevation):
        return None
    angles = np.stack(
        np.meshgrid(*(np.linspace(low, high, 91) for low, high in zip(lower[:-1], upper[:-1], strict=True))), axis=-1
    ).reshape(-1, len(lower) - 1)
    u = directions(np.column_stack([angles, np.ones(len(angles))]))
    if rank == 2:
        mirrored = u - 2 * np.outer(u @ axes[2], axes[2])
    elif has_elevation:  # half a turn about the line, and a little more, as any turn leaves the distances unchanged
        return _turned(u, axes[0], angles, lower, upper)
    else:
        mirrored = 2 * np.outer(u @ axes[0], axes[0]) - u
    return _inside("plane" if rank == 2 else "line", u, mirrored, angles, lower, upper)


def _turned(
    u: Float[ndarray, "p 3"],
    axis: Float[ndarray, " 3"],
    angles: Float[ndarray, "p 2"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> tuple[str, Float[ndarray, "two angles"]] | None:
    """Look for a direction that stays in the box when it is turned about a line."""
    along = np.outer(u @ axis, axis)
    for turn in np.radians([180.0, 90.0, -90.0, 45.0, -45.0, 20.0, -20.0, 5.0, -5.0]):
        turned = along + (u - along) * np.cos(turn) + np.cross(axis, u) * np.sin(turn)
        if found := _inside("line", u, turned, angles, lower, upper):
            return found
    return None


def _inside(
    shape: str,
    u: Float[ndarray, "p 3"],
    other: Float[ndarray, "p 3"],
    angles: Float[ndarray, "p angles"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> tuple[str, Float[ndarray, "two angles"]] | None:
    """Return the pair of directions in the box that are farthest apart, if these are more than 2° apart."""
    azimuth = azimuth_near(np.arctan2(other[:, 1], other[:, 0]), (lower[0] + upper[0]) / 2)
    found = np.column_stack([azimuth, np.arcsin(np.clip(other[:, 2], -1.0, 1.0))])
    found = found[:, : angles.shape[1]]
    inside = ((found > lower[:-1] + 1e-6) & (found < upper[:-1] - 1e-6)).all(axis=1)
    apart = np.where(inside, np.linalg.norm(u - other, axis=1), 0.0)
    best = int(np.argmax(apart))
    return (shape, np.array([angles[best], found[best]])) if apart[best] > 0.035 else None
