"""Draws the positions of sources that are a minimum angle apart, whenever the box has room for them."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .geometry import directions

__all__ = ["has_room", "place_sources"]

TOLERANCE = 1e-12  # of chords on the unit sphere, for rounding
_CANDIDATES = (16, 256, 4096)  # of the next source, per attempt
_RESTARTS, _STEPS = 100, 2000  # of the relaxation in three dimensions


def place_sources(
    rng: np.random.Generator,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    sources: int,
    separation: float = 0.0,
) -> Float[ndarray, "k d"]:
    """Draw K sources in a box, each uniformly among the places that are far enough from the sources before it.

    rng: random generator; each source has its own child of it, so that the first sources do not depend on their number.
    lower, upper: bounds of one source [azimuth, (elevation,) range] [rad, m], shape (d,).
    sources: number K of sources.
    separation: minimum angle between the directions of any two sources, seen from the origin [rad].

    If the sources before leave no room for the next one, all sources are placed again together: in the plane at angles
    whose gaps beyond the separation are uniform, in three dimensions at random angles that are pushed apart. In the
    plane, this succeeds whenever there is room. Raises ValueError if no placement is found.
    """
    *own, for_all = rng.spawn(sources + 1)
    placed = np.empty((0, len(lower)))
    for stream in own:
        candidate = _next(stream, lower, upper, placed, separation)
        if candidate is None:
            return _together(for_all, lower, upper, sources, separation)
        placed = np.vstack([placed, candidate])
    return placed


def has_room(lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], sources: int, separation: float) -> bool:
    """Whether sources in the plane fit into the box; in three dimensions True, as that cannot be said in general."""
    return len(lower) > 2 or (sources - 1) * separation <= _arc(lower, upper, separation) * (1 + TOLERANCE)


def _arc(lower: ndarray, upper: ndarray, separation: float) -> float:
    """The usable interval of azimuths [rad]: on a full circle, the last source must also be apart from the first."""
    return float(min(upper[0] - lower[0], 2 * math.pi - separation))


def _next(
    rng: np.random.Generator, lower: ndarray, upper: ndarray, placed: ndarray, separation: float
) -> ndarray | None:
    """The first of many random places that is apart from all placed sources, (d,); None if there is none."""
    others, chord = directions(placed), _chord(separation)
    for count in _CANDIDATES:
        candidates = rng.uniform(lower, upper, (count, len(lower)))
        apart = np.linalg.norm(directions(candidates)[:, None] - others, axis=-1).min(axis=1, initial=math.inf) >= chord
        if apart.any():
            return np.asarray(candidates[np.argmax(apart)])
    return None


def _together(
    rng: np.random.Generator, lower: ndarray, upper: ndarray, sources: int, separation: float
) -> Float[ndarray, "k d"]:
    """Place all sources at once. Raises ValueError if no placement is found."""
    theta = rng.uniform(lower, upper, (sources, len(lower)))
    if len(lower) == 2 and has_room(lower, upper, sources, separation):
        theta[:, 0] = rng.permutation(_spaced(rng, lower, upper, sources, separation))
        return theta
    for _ in range(_RESTARTS if len(lower) > 2 else 0):
        if _pushed_apart(theta, lower, upper, separation):
            return theta
        theta = rng.uniform(lower, upper, (sources, len(lower)))
    raise ValueError(
        f"min_separation_deg: expected a placement of {sources} sources {math.degrees(separation):g}° apart, found "
        f"none; widen the box, or reduce min_separation_deg or sources"
    )


def _spaced(rng: np.random.Generator, lower: ndarray, upper: ndarray, sources: int, separation: float) -> ndarray:
    """Increasing azimuths (K,) [rad], uniform among all that are far enough apart.

    Without the separations between them, they are the order statistics of uniform numbers in what is left of the box.
    """
    arc = _arc(lower, upper, separation)
    first = lower[0] + rng.uniform(0.0, upper[0] - lower[0] - arc)
    left = max(arc - (sources - 1) * separation, 0.0)
    azimuths = first + np.sort(rng.uniform(0.0, left, sources)) + separation * np.arange(sources)
    return np.minimum(azimuths, upper[0])


def _pushed_apart(theta: ndarray, lower: ndarray, upper: ndarray, separation: float) -> bool:
    """Move directions that are too close away from each other, in place; whether all are apart at the end."""
    chord = _chord(separation)
    wanted = chord * (1 + 1e-6)
    for _ in range(_STEPS):
        u = directions(theta)
        between = u[:, None] - u
        distance = np.linalg.norm(between, axis=-1)
        np.fill_diagonal(distance, math.inf)
        if distance.min() >= chord:
            return True
        push = np.maximum(wanted - distance, 0.0) / np.maximum(distance, 1e-9)
        u += 0.5 * np.einsum("ij,ijc->ic", push, between)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        theta[:, :2] = _angles(u, theta[:, 0])
        np.clip(theta, lower, upper, out=theta)
    return False


def _angles(u: Float[ndarray, "k 3"], near: Float[ndarray, " k"]) -> Float[ndarray, "k 2"]:
    """Azimuth and elevation of directions [rad]; the azimuth is the one closest to ``near``."""
    azimuth = np.arctan2(u[:, 1], u[:, 0])
    azimuth += 2 * math.pi * np.round((near - azimuth) / (2 * math.pi))
    return np.stack([azimuth, np.arcsin(np.clip(u[:, 2], -1.0, 1.0))], axis=1)


def _chord(separation: float) -> float:
    """The smallest distance of two unit vectors that are this angle apart, less a tolerance for rounding."""
    return 2 * math.sin(separation / 2) - TOLERANCE
