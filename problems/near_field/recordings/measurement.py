"""From the numbers in a file to snapshots: one row per element, one column per snapshot."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

__all__ = ["normalized", "oriented", "spherical"]

WEAKEST = 1e-6  # power that the sources do not explain, relative to that of the data, below which it is rounding


def oriented(X: ndarray, elements: int, axis: int | None) -> tuple[ndarray, int]:
    """Return a table of numbers with the elements along its first axis, and the axis along which they were.

    axis: axis of the elements; None: the only axis of the right length, or the first one if both have it.
    Raises ValueError if no axis has as many entries as there are elements.
    """
    if X.ndim != 2:
        raise ValueError(f"expected a table with an axis of {elements} elements, got an array of shape {X.shape}")
    fits = [i for i in (0, 1) if X.shape[i] == elements]
    if not fits or (axis is not None and axis not in fits):
        where = "one axis" if axis is None else f"axis {axis}"
        raise ValueError(
            f"expected {elements} entries along {where}, one per element of the array, got an array of shape {X.shape}"
        )
    axis = fits[0] if axis is None else axis
    return (X if axis == 0 else X.T), axis


def normalized(Y: Complex[ndarray, "m t"], sources: int) -> tuple[Complex[ndarray, "m t"], float]:
    """Return the data divided by the deviation of what K sources cannot explain, and that deviation.

    The variance is the mean of the M − K smallest eigenvalues of Y·Yᴴ/T, but at least 1e-6 of the mean power of an
    element.
    """
    M, T = Y.shape
    energies = np.linalg.svd(Y, compute_uv=False) ** 2
    rest = float(energies[sources:].sum()) / (T * (M - sources))
    deviation = np.sqrt(max(rest, WEAKEST * float(energies.sum()) / (M * T)))
    return Y / deviation, float(deviation)


def spherical(points: Float[ndarray, "k 3"], has_elevation: bool) -> Float[ndarray, "k d"]:
    """Return points ``[x, y, z]`` [m] as sources ``[azimuth, (elevation,) range]`` [rad, m].

    Raises ValueError if there are no elevations and a point is more than a thousandth of its range from the plane z = 0.
    """
    r = np.linalg.norm(points, axis=1)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    if has_elevation:
        return np.stack([azimuth, np.arcsin(np.clip(points[:, 2] / r, -1.0, 1.0)), r], axis=1)
    if (above := np.abs(points[:, 2]) > 1e-3 * r).any():
        k = int(np.argmax(above))
        text = f"expected sources at elevation 0, as elevation_deg is not given, got one {points[k, 2]:.4g} m above it"
        raise ValueError(text)
    return np.stack([azimuth, np.hypot(points[:, 0], points[:, 1])], axis=1)
