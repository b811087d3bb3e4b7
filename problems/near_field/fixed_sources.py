"""Sources at fixed positions, in spherical coordinates or in the Cartesian ones of the user, and their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .geometry import Frame, azimuth_near

__all__ = ["cartesian_problems", "cartesian_sources", "spherical_problems", "spherical_sources"]

OFF_PLANE = 1e-6  # share of the range by which a source may be off the plane of a scenario without elevation
ROUNDING = 1e-9  # of the conversion: angles [°] and shares of ranges by which a source may be outside the box

_Side = tuple[float, float]


def spherical_sources(positions: Sequence[Sequence[float]], azimuth_deg: _Side) -> Float[ndarray, "k d"]:
    """Return sources [azimuth, (elevation,) range] [°, m] in radians and metres, shape (K, d)."""
    degrees = np.array(positions)
    degrees[:, 0] = [_turned(azimuth, azimuth_deg) for azimuth in degrees[:, 0]]
    return np.hstack([np.radians(degrees[:, :-1]), degrees[:, -1:]])


def spherical_problems(positions: Sequence[Sequence[float]], sides: Mapping[str, _Side]) -> list[tuple[str, str]]:
    """Return the errors in fixed sources [azimuth, (elevation,) range] [°, m] as (path, message) pairs.

    sides: intervals of the box by the names of their options, in the order of the coordinates.
    """
    problems = []
    for k, position in enumerate(positions):
        if len(position) != len(sides):
            problems.append((f"positions[{k}]", f"expected {len(sides)} numbers ({', '.join(sides)}), got {position}"))
            continue
        for value, (name, (low, high)) in zip(position, sides.items(), strict=True):
            turned = _turned(value, (low, high)) if name == "azimuth_deg" else value
            if not low <= turned <= high:
                problems.append((f"positions[{k}]", f"expected {name} within [{low:g}, {high:g}], got {value:g}"))
    return problems


def cartesian_sources(
    positions_m: Sequence[Sequence[float]], frame: Frame, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> Float[ndarray, "k d"]:
    """Return sources [x, y, z] [m] of the user as [azimuth, (elevation,) range] [rad, m], shape (K, d), in the box."""
    theta = _spherical(positions_m, frame, (lower[0] + upper[0]) / 2)
    if len(lower) == 2:
        theta = theta[:, [0, 2]]
    inside: ndarray = np.clip(theta, lower, upper)  # of what rounding puts outside
    return inside


def cartesian_problems(
    positions_m: Sequence[Sequence[float]], frame: Frame, sides: Mapping[str, _Side]
) -> list[tuple[str, str]]:
    """Return the errors in fixed sources [x, y, z] [m] as (path, message) pairs; ``sides`` as above."""
    problems = []
    points = frame.inward(np.array(positions_m))
    middle = np.radians(sum(sides["azimuth_deg"]) / 2)
    theta = _spherical(positions_m, frame, middle)
    for k, (given, point, (azimuth, elevation, r)) in enumerate(zip(positions_m, points, theta, strict=True)):
        path = f"positions_m[{k}]"
        where = f"{list(given)}, which is at azimuth {np.degrees(azimuth):.4g}°"
        where += f", elevation {np.degrees(elevation):.4g}° and range {r:.4g} m"
        if "elevation_deg" not in sides and abs(point[2]) > OFF_PLANE * r:
            text = f"expected a source in the plane of azimuths, as elevation_deg is not given, got {list(given)}"
            problems.append((path, f"{text}, which is {abs(point[2]):.4g} m off that plane; set elevation_deg"))
            continue
        values = {"azimuth_deg": np.degrees(azimuth), "elevation_deg": np.degrees(elevation), "range_m": r}
        for name, (low, high) in sides.items():
            tolerance = ROUNDING * (r if name == "range_m" else 1.0)
            if not low - tolerance <= values[name] <= high + tolerance:
                problems.append((path, f"expected {name} within [{low:g}, {high:g}], got {where}"))
    return problems


def _spherical(positions_m: Sequence[Sequence[float]], frame: Frame, middle: float) -> Float[ndarray, "k 3"]:
    """Return [azimuth, elevation, range] [rad, m], with azimuths within half a turn of ``middle`` [rad]."""
    x, y, z = frame.inward(np.array(positions_m)).T
    r = np.sqrt(x**2 + y**2 + z**2)
    return np.stack([azimuth_near(np.arctan2(y, x), middle), np.arctan2(z, np.hypot(x, y)), r], axis=1)


def _turned(azimuth: float, interval: _Side) -> float:
    """Return an azimuth [°] that is equal up to full turns and in the interval, or the azimuth itself."""
    low, high = interval
    return next((turned for turned in (azimuth, azimuth + 360, azimuth - 360) if low <= turned <= high), azimuth)
