"""Reads points in space, such as the true positions of sources, from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ..arrays.text_tables import parsed
from .files import read_array

__all__ = ["read_points"]

MOST = 100_000


def read_points(path: str) -> Float[ndarray, "p 3"]:
    """Return the points in a file [m], one row x, y, z per point, at least one.

    Text files are written like those with the positions of an array: the first line may name the columns, such as
    x_m, z_m or x [mm], y [mm]; coordinates that it does not name are 0. Raises ValueError if there are no such rows.
    """
    name = Path(path).name
    if Path(path).suffix.lower() in (".csv", ".txt", ".tsv", ".dat"):
        try:
            points, _ = parsed(Path(path).read_text(encoding="utf-8-sig"), None, MOST)
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(f"{name}: expected rows of coordinates, but reading it failed: {error}") from error
    else:
        points = read_array(path).array
    if points.ndim != 2 or points.shape[1] != 3 or np.iscomplexobj(points) or not np.isfinite(points).all():
        raise ValueError(f"{name}: expected rows x, y, z of finite numbers, got {points.dtype} of shape {points.shape}")
    if not len(points):
        raise ValueError(f"{name}: expected at least one point, got none")
    return points
