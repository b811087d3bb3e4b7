"""The spectrum of MUSIC along the range axis of a grid, interpolated from its values at few ranges.

Along a ray, the phase of a response is a smooth function of 1/r: f = s − w/(2r) for the paper's wavefront, and nearly
so for an exact one. ‖U_sᴴa‖² is a sum of products of two entries of a, so that it is nearly a polynomial of low degree
in 1/r. From its values at n Chebyshev nodes of 1/r, the barycentric formula (Berrut & Trefethen 2004,
doi:10.1137/S0036144502417715) has the values at all ranges of the grid to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray
from scipy.interpolate import BarycentricInterpolator

from ..wavefronts import Manifold

__all__ = ["RangeAxis", "range_axis"]

TOLERANCE = 1e-12
"""Largest error of the product of two entries of a response that is interpolated.

Entries have modulus 1, so ‖U_sᴴa‖² is off by less than √K·M times this, where it is up to M."""

NODES = (1, *range(4, 16, 2), *range(16, 32, 4), *range(32, 64, 8), *range(64, 128, 16), *range(128, 513, 32))
DIRECTIONS, RANGES, ELEMENTS = 3, 128, 256  # directions per angle, ranges, elements for which it is tested
WORTHWHILE = 10**7  # entries of responses below which a grid is evaluated as it is: about 25 ms


@dataclass(frozen=True)
class RangeAxis:
    """The ranges [m] at which a spectrum is evaluated, and how its values at all ranges of the grid follow from these.

    ranges: ranges at which it is evaluated (n,) [m]. weights: matrix (R, n) of the barycentric formula; None: the
    ranges are those of the grid.
    """

    ranges: Float[ndarray, " n"]
    weights: Float[ndarray, "r n"] | None

    def values(self, at_ranges: Float[ndarray, "p n"]) -> Float[ndarray, "p r"]:
        """Return the values at the ranges of the grid for p directions."""
        return at_ranges if self.weights is None else at_ranges @ self.weights.T


def range_axis(manifolds: Sequence[Manifold], axes: Sequence[Float[ndarray, " _"]]) -> RangeAxis:
    """Return the fewest ranges from which the spectrum on a grid is interpolated to TOLERANCE.

    They are those of the grid if interpolation does not pay, or if responses have entries of another modulus than 1.

    manifolds: array and wavefront model of each frequency bin.
    axes: coordinates of the grid in azimuth, (elevation,) range [rad, m].
    """
    grid = axes[-1]
    size = sum(manifold.elements for manifold in manifolds) * math.prod(len(axis) for axis in axes)
    if size >= WORTHWHILE and all(manifold.has_unit_modulus for manifold in manifolds):
        rays = [ray for manifold in manifolds for ray in _rays(manifold, axes)]
        for n in NODES:
            if 2 * n > len(grid):
                break
            ranges, weights = _interpolation(n, grid)
            if all(ray.error(ranges, weights) <= TOLERANCE for ray in rays):
                return RangeAxis(ranges, weights)
    return RangeAxis(grid, None)


def _interpolation(n: int, grid: Float[ndarray, " r"]) -> tuple[Float[ndarray, " n"], Float[ndarray, "r n"]]:
    """The ranges whose inverses are Chebyshev nodes of the first kind, and the barycentric weights for each range."""
    angles = np.pi * (np.arange(n) + 0.5) / n
    highest, lowest = 1 / grid.min(), 1 / grid.max()
    nodes = (highest + lowest) / 2 + (highest - lowest) / 2 * np.cos(angles)
    factors = (-1.0) ** np.arange(n) * np.sin(angles)
    return 1 / nodes, BarycentricInterpolator(nodes, np.eye(n), wi=factors)(1 / grid)


@dataclass(frozen=True)
class _Ray:
    """Products a_m·a_e* along a ray, for the two elements e whose phases change most and least with the range."""

    manifold: Manifold
    direction: Float[ndarray, " angles"]
    grid: Float[ndarray, " r"]
    step: int  # every ``step``th range of the grid is tested

    def error(self, ranges: Float[ndarray, " n"], weights: Float[ndarray, "r n"]) -> float:
        """The largest error of an interpolated product."""
        return float(np.abs(weights[:: self.step] @ self._products(ranges) - self._true).max())

    @cached_property
    def _true(self) -> Complex[ndarray, "r m"]:
        return self._products(self.grid[:: self.step])

    @cached_property
    def _extremes(self) -> list[int]:
        a, derivatives = self.manifold.response_and_derivatives(self._points(self.grid[:1]))
        slopes = (derivatives[0, -1] / a[0]).imag  # steepest at the nearest range
        return [int(slopes.argmin()), int(slopes.argmax())]

    def _points(self, ranges: Float[ndarray, " n"]) -> Float[ndarray, "n d"]:
        return np.column_stack([np.tile(self.direction, (len(ranges), 1)), ranges])

    def _products(self, ranges: Float[ndarray, " n"]) -> Complex[ndarray, "n m"]:
        a = self.manifold.response(self._points(ranges))
        return np.hstack([a * a[:, [e]].conj() for e in self._extremes])


def _rays(manifold: Manifold, axes: Sequence[Float[ndarray, " _"]]) -> Iterator[_Ray]:
    """Rays in the directions at the edges and in the middle of the grid."""
    angles = [axis[_spread(len(axis), DIRECTIONS)] for axis in axes[:-1]]
    farthest = np.linalg.norm(manifold.positions, axis=1).argmax()
    elements = np.union1d(_spread(manifold.elements, ELEMENTS), farthest)
    manifold = replace(manifold, positions=manifold.positions[elements])
    for direction in product(*angles):
        yield _Ray(manifold, np.array(direction), axes[-1], max(len(axes[-1]) // RANGES, 1))


def _spread(length: int, count: int) -> Int[ndarray, " _"]:
    """At most ``count`` indices of a sequence, its ends included."""
    return np.unique(np.linspace(0, length - 1, count).astype(int))
