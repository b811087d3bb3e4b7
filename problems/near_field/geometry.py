"""The coordinate system: the position of a source with given angles and range.

A source is a row ``theta``: ``[azimuth, range]`` in 2D, ``[azimuth, elevation, range]`` in 3D, in radians and metres.
The x axis points to the broadside of the built-in ULA and UPA, the y axis along the ULA, and the z axis upwards.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

__all__ = ["cartesian", "direction_derivatives", "directions"]


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
