"""The grid whose spacing matches the resolution of the array, and the responses of its points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Incompatible

from ..geometry import direction_derivatives
from ..wavefronts import Manifold, Wavefront
from . import kernels
from .local_search import resolution

__all__ = [
    "ResponseGrid",
    "beamwidths_along",
    "grid_size",
    "resolution_grid",
    "response_grid",
    "spread",
]

SAMPLES = 61  # directions along each angle at which the beamwidth is computed
LARGEST_GRID = 10**8  # points, 2.4 GB
LARGEST_TABLE = 64 * 2**20  # bytes; the responses of a larger grid are computed whenever they are needed
BLOCK = 2**21  # complex numbers of responses computed at once
REMEMBERED = 4  # grids, each of one array, wavefront, box and density


@dataclass(frozen=True, eq=False)
class ResponseGrid:
    """A grid of candidate sources with their responses.

    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    points: candidates [rad, m], shape (p, d).
    table: responses as the kernels read them, shape (2, p, padded), or (2, 0, padded) if they would be too large or
        have another modulus than 1.
    """

    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    points: Float[ndarray, "p d"]
    table: Float[ndarray, "2 p padded"]

    def responses(self) -> Iterator[tuple[int, Complex[ndarray, "block m"]]]:
        """Yield the responses in blocks, one per row, each with the index of its first point."""
        if self._all is not None:
            yield 0, self._all
            return
        count = max(BLOCK // self.manifold.elements, 1)
        for first in range(0, len(self.points), count):
            yield first, self.manifold.response(self.points[first : first + count])

    @cached_property
    def _all(self) -> Complex[ndarray, "p m"] | None:
        small = 16 * self.manifold.elements * len(self.points) < LARGEST_TABLE
        return self.manifold.response(self.points) if small else None


def response_grid(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], density: float
) -> ResponseGrid:
    """Return the ``resolution_grid`` with its responses; those of the last few arrays and boxes are remembered."""
    array = manifold.positions.tobytes(), manifold.wavelength_m, manifold.wavefront, manifold.has_elevation
    if not manifold.has_unit_modulus:
        return _general(manifold, lower, upper, density)
    return _remembered(*array, lower.tobytes(), upper.tobytes(), density)


def _general(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], density: float
) -> ResponseGrid:
    """Return the grid of an array whose responses have another modulus than 1; it has no table for the kernels."""
    unit = replace(manifold, weights=None, amplitude="constant")
    points = response_grid(unit, lower, upper, density).points
    return ResponseGrid(manifold, lower, upper, points, np.empty((2, 0, 0)))


@lru_cache(maxsize=REMEMBERED)
def _remembered(
    positions: bytes,
    wavelength_m: float,
    wavefront: Wavefront,
    has_elevation: bool,
    lower: bytes,
    upper: bytes,
    density: float,
) -> ResponseGrid:
    kernels.warm_up()
    manifold = Manifold(np.frombuffer(positions).reshape(-1, 3), wavelength_m, wavefront, has_elevation)
    low, high = np.frombuffer(lower), np.frombuffer(upper)
    points = resolution_grid(manifold, low, high, density)
    width = manifold.packed[2].shape[1]
    stored = points if 16 * width * len(points) < LARGEST_TABLE else points[:0]
    return ResponseGrid(manifold, low, high, points, kernels.respond_all(*manifold.packed, stored))


def resolution_grid(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], density: float
) -> Float[ndarray, "p d"]:
    """Return a grid of points (p, d) [rad, m] in the box, including its ends.

    The beamwidth at direction u in an angle is λ/E, where E is the extent of q_m·∂u/∂angle over the array; for a ULA
    the points are therefore uniform in sinφ. The spacing of elevations is fine enough for every azimuth, and vice
    versa.

    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    density: number of grid points per beamwidth in each angle, and per depth of focus in inverse range.

    Raises Incompatible if the grid would have more than 10^8 points.
    """
    sides = beamwidths_along(manifold, lower, upper)
    depth = resolution(manifold)[1]
    extents = [*(beamwidths[-1] for _, beamwidths in sides), (1 / lower[-1] - 1 / upper[-1]) / depth]
    counts = [max(math.ceil(extent * density), 1) + 1 for extent in extents]
    if math.prod(counts) > LARGEST_GRID:
        size = " × ".join(f"{count:,}" for count in counts)
        raise Incompatible(
            f"the grid that resolves the box would have {size} points, more than {LARGEST_GRID:,}; check the units of "
            f"the positions and the wavelength, make the box smaller, or reduce density"
        )
    axes = []
    for axis, beamwidths in sides:
        axes.append(np.interp(spread(0.0, beamwidths[-1], density), beamwidths, axis))
    axes.append(1 / (spread(1 / upper[-1] / depth, 1 / lower[-1] / depth, density) * depth))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(lower))


def grid_size(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], density: float
) -> list[int]:
    """Return about how many points ``resolution_grid`` has along each side, from the outermost elements."""
    Q = manifold.positions
    outermost = np.unique(np.argmax(Q @ (np.indices((3, 3, 3)).reshape(3, -1) - 1), axis=0))
    few = Manifold(Q[outermost], manifold.wavelength_m, manifold.wavefront, manifold.has_elevation)
    extents = [beamwidths[-1] for _, beamwidths in beamwidths_along(few, lower, upper)]
    extents.append((1 / lower[-1] - 1 / upper[-1]) / resolution(manifold)[1])
    return [max(math.ceil(extent * density), 1) + 1 for extent in extents]


def beamwidths_along(
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    extent: Callable[..., ndarray] = np.ptp,
) -> list[tuple[Float[ndarray, " samples"], Float[ndarray, " samples"]]]:
    """Return, for each angle, samples of it [rad] and the number of beamwidths from the first of them to each.

    extent: function of q_m·∂u/∂angle over the elements, along ``axis``, to which a beamwidth is inverse.
    """
    angles = manifold.dimension - 1
    fine = [np.linspace(low, high, SAMPLES) for low, high in zip(lower[:angles], upper[:angles], strict=True)]
    directions = np.stack([*np.meshgrid(*fine, indexing="ij"), np.ones([SAMPLES] * angles)], axis=-1)
    slopes = direction_derivatives(directions.reshape(-1, angles + 1)) @ manifold.positions.T  # q_m·∂u [m/rad]
    beams = extent(slopes, axis=-1).reshape(*[SAMPLES] * angles, angles) / manifold.wavelength_m  # [1/rad]
    found = []
    for i, axis in enumerate(fine):
        rate = beams[..., i].max(axis=tuple(j for j in range(angles) if j != i))
        found.append((axis, np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(axis))])))
    return found


def spread(first: float, last: float, density: float) -> Float[ndarray, " n"]:
    """Return points from ``first`` to ``last``, as far apart as possible with at least ``density`` per unit."""
    return np.linspace(first, last, max(math.ceil((last - first) * density), 1) + 1)
