"""The polar grid: candidates whose neighbours have responses of a given coherence, in angle and in inverse range."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Incompatible

from ..geometry import directions
from ..wavefronts import Manifold, Wavefront
from .grid import beamwidths_along, spread

__all__ = ["polar_grid", "polar_grid_size"]

Sides: TypeAlias = list[tuple[Float[ndarray, " samples"], Float[ndarray, " samples"]]]

REMEMBERED = 4  # grids, each of one array, wavefront, box and coherence
LARGEST = 10**7  # points, 240 MB
SPARSE = 3  # every how many sampled directions the size is estimated


def polar_grid(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], coherence: float
) -> Float[ndarray, "p d"]:
    """Return the polar grid of the box (p, d) [rad, m], including its ends; the last few are remembered.

    Neighbours in an angle, and neighbours in inverse range, are as far apart as the coherence |aᴴb|/(‖a‖‖b‖) of their
    responses allows, to second order of the phase: a change of coordinate by Δ that changes the phases by k·Δ·ξ_m has
    the coherence exp(−(k·Δ)²·var(ξ)/2), so that Δ = √(−2·ln(coherence))/(k·std(ξ)). For an angle, ξ_m = q_m·∂u/∂angle.
    For the inverse range it is the curvature (‖q_m‖² − (u·q_m)²)/2, with q_m measured from the centre of the array:
    from another origin, the rest of the phase is that of another angle. The paper's wavefront has the curvature
    ‖q_m‖²/2.

    For a linear array this is the polar-domain grid of Cui & Dai (2022, doi:10.1109/TCOMM.2022.3146400), uniform in
    sinφ, with the ranges Z(1 − sin²φ)/s, Z ∝ D²/λ. They space the angles by a whole beamwidth, where the coherence is
    0, and begin the ranges at infinity, s = 0; here they begin at the far end of the box.

    Raises Incompatible if the grid would have more than 10^7 points.

    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    coherence: coherence of neighbours, between 0 and 1.
    """
    array = manifold.positions.tobytes(), manifold.wavelength_m, manifold.wavefront, manifold.has_elevation
    return _remembered(*array, lower.tobytes(), upper.tobytes(), coherence)


@lru_cache(maxsize=REMEMBERED)
def _remembered(
    positions: bytes,
    wavelength_m: float,
    wavefront: Wavefront,
    has_elevation: bool,
    lower: bytes,
    upper: bytes,
    coherence: float,
) -> Float[ndarray, "p d"]:
    manifold = Manifold(np.frombuffer(positions).reshape(-1, 3), wavelength_m, wavefront, has_elevation)
    angles, counts = _angles_and_counts(manifold, np.frombuffer(lower), np.frombuffer(upper), coherence)
    far, near = 1 / np.frombuffer(upper)[-1], 1 / np.frombuffer(lower)[-1]
    step = np.concatenate([np.arange(count) / (count - 1) for count in counts])
    points = np.empty((len(step), manifold.dimension))
    points[:, :-1] = np.repeat(angles, counts, axis=0)
    points[:, -1] = 1 / (far + (near - far) * step)
    points = np.clip(points, np.frombuffer(lower), np.frombuffer(upper))  # the rounding of the ends
    points.flags.writeable = False
    return points


def polar_grid_size(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], coherence: float
) -> int:
    """Return about how many points ``polar_grid`` has, from the ranges in a sample of the directions."""
    sides, width = beamwidths_along(manifold, lower, upper, np.std), _width(coherence)
    sampled = [axis[::SPARSE] for axis, _ in sides]
    counts = _counts(manifold, lower, upper, width, _product(sampled))
    return int(math.prod(_lengths(sides, width)) * counts.mean())


def _angles_and_counts(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], coherence: float
) -> tuple[Float[ndarray, "n angles"], ndarray]:
    """Return the directions of the grid [rad], one per row, and the number of ranges in each of them."""
    sides, width = beamwidths_along(manifold, lower, upper, np.std), _width(coherence)
    _limit(math.prod(_lengths(sides, width)) * 2)
    angles = _product([np.interp(spread(0.0, beams[-1], 1 / width), beams, axis) for axis, beams in sides])
    counts = _counts(manifold, lower, upper, width, angles)
    _limit(int(counts.sum()))
    return angles, counts


def _width(coherence: float) -> float:
    """Return k·Δ·std(ξ)/2π of neighbours."""
    return math.sqrt(-2 * math.log(coherence)) / (2 * math.pi)


def _lengths(sides: Sides, width: float) -> list[int]:
    """Return the number of points along each angle."""
    return [max(math.ceil(beams[-1] / width), 1) + 1 for _, beams in sides]


def _product(axes: list[Float[ndarray, " _"]]) -> Float[ndarray, "n angles"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _counts(
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    width: float,
    angles: Float[ndarray, "n angles"],
) -> ndarray:
    """Return the number of ranges in each direction."""
    depths = (1 / lower[-1] - 1 / upper[-1]) * _curvatures(manifold, angles) / manifold.wavelength_m
    return np.maximum(np.ceil(depths / width), 1).astype(np.int64) + 1


def _curvatures(manifold: Manifold, angles: Float[ndarray, "n angles"]) -> Float[ndarray, " n"]:
    """Return std(ξ) [m²] over the elements, the spread of the curvature of the wavefront, in each direction."""
    Q = manifold.positions - manifold.positions.mean(axis=0)
    square = np.sum(Q**2, axis=1)
    if manifold.wavefront == "planar":
        return np.zeros(len(angles))
    if manifold.wavefront == "paper":
        return np.full(len(angles), float(np.std(square)) / 2)
    found = np.empty(len(angles))
    count = max(2**21 // len(Q), 1)
    for first in range(0, len(angles), count):
        block = angles[first : first + count]
        u = directions(np.column_stack([block, np.ones(len(block))]))
        found[first : first + count] = np.std(square - (u @ Q.T) ** 2, axis=1) / 2
    return found


def _limit(points: int) -> None:
    if points > LARGEST:
        raise Incompatible(
            f"the polar grid would have {points:,} points or more, expected at most {LARGEST:,}; check the units of "
            "the positions and the wavelength, make the box smaller, or reduce coherence"
        )
