"""The axes of an array in the coordinates in which it is described: where its front is, and where up is."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import OptionError

__all__ = ["NEARLY", "Axis", "axes_of", "axis_text"]

NEARLY = 0.9998  # cosine of 1°

Axis: TypeAlias = Literal["+x", "-x", "+y", "-y", "+z", "-z"] | tuple[float, float, float]
"""A direction in the coordinates of an array: an axis by name, or a vector of any length."""


def axes_of(broadside: Axis | None, up: Axis | None, owner: str) -> Float[ndarray, "3 3"]:
    """Return the unit vectors of broadside, left and up, one per row; by default +x, and +z, or +y if +z is in front.

    The part of ``up`` along the broadside is ignored. Raises OptionError in the name of the class ``owner`` if one of
    them is not a direction, or if both are the same.
    """
    x = _unit("broadside", "+x" if broadside is None else broadside, owner)
    usual: Axis = "+y" if abs(x[2]) > NEARLY else "+z"
    upwards = _unit("up", usual if up is None else up, owner)
    z = upwards - (upwards @ x) * x
    if np.linalg.norm(z) < 0.01:
        text = f"expected a direction that is not along the broadside {broadside or '+x'}, got {up}"
        raise OptionError(owner, [("up", text)])
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z]) + 0.0


def axis_text(vector: Float[ndarray, " 3"]) -> str:
    """Return a direction as it is written in a manifest: an axis by name if it is within 1° of it, or a vector."""
    longest = int(np.argmax(np.abs(vector)))
    if abs(vector[longest]) > NEARLY * np.linalg.norm(vector):
        return f'"{"-" if vector[longest] < 0 else "+"}{"xyz"[longest]}"'
    return f"[{', '.join(f'{part + 0.0:.4g}' for part in vector)}]"


def _unit(name: str, axis: Axis, owner: str) -> Float[ndarray, " 3"]:
    """Return the unit vector of an axis. Raises OptionError if it is not a direction."""
    if isinstance(axis, str):
        vector = np.zeros(3)
        vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
        return vector
    vector = np.array(axis)
    length = float(np.linalg.norm(vector))
    if not 1e-12 < length < 1e12:
        raise OptionError(owner, [(name, f"expected a direction, got {list(axis)}")])
    return vector / length
