"""Reads points in space, such as the true positions of sources, from a file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .files import read_array

__all__ = ["read_points"]

_METRES = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
_COLUMN = re.compile(r"([xyz])(?:[ _(\[]+(m|cm|mm)[)\]]?)?", re.IGNORECASE)


def read_points(path: str) -> Float[ndarray, "p 3"]:
    """Return the points in a file [m], one row x, y, z per point.

    The first line of a text file may name the columns, such as x_m, z_m or x [mm], y [mm]; coordinates that it does not
    name are 0. Raises ValueError if there are no such rows.
    """
    X = read_array(path).array
    if np.iscomplexobj(X) or X.ndim != 2:
        raise ValueError(f"{Path(path).name}: expected rows x, y, z of real numbers, got {X.dtype} of shape {X.shape}")
    columns = _named(path) if Path(path).suffix.lower() in (".csv", ".txt", ".tsv") else []
    if not columns and X.shape[1] == 3:
        return X
    if len(columns) != X.shape[1]:
        raise ValueError(f"{Path(path).name}: expected rows x, y, z, got {X.shape[1]} columns without such names")
    points = np.zeros((len(X), 3))
    for i, (axis, unit) in enumerate(columns):
        points[:, "xyz".index(axis)] = X[:, i] * _METRES[unit]
    return points


def _named(path: str) -> list[tuple[str, str]]:
    """Return the axis and the unit of each column that the first line names; empty if it names no axes."""
    first = next(line for line in Path(path).read_text(encoding="utf-8-sig").splitlines() if line.split("#")[0].strip())
    found = [_COLUMN.fullmatch(cell.strip()) for cell in re.split(r"[,;\t]", first.split("#")[0])]
    return [(match[1].lower(), (match[2] or "").lower()) for match in found if match]
