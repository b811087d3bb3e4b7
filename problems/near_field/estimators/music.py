"""MUSIC: the places on a grid whose responses lie closest to the signal subspace."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.ndimage import label, maximum_filter

from nfbench import Formulation, Ge, Incompatible, Instance, Minimize, Options

from ..enumeration import Criterion, Sources, how_many
from ..instance import NearFieldInstance
from ..objectives import kernels
from ..objectives.rls import RLS
from ..subspace import compress, signal_subspace
from ..wavefronts import Manifold, Wavefront
from .refinement import refine

__all__ = ["Grid", "Music", "grid_maxima", "pick_peaks"]

SAME_PEAK = 0.9999
"""The squared correlation |a₁ᴴa₂|²/M² from which on two climbed maxima are one peak.

Climbs to one peak end within 1e-6 of 1; two sources as alike as this are not two peaks at any realistic SNR."""

KEEP = 1000  # grid maxima remembered; a ridge makes some ten
BLOCK = 2**17  # grid points at once, or one azimuth's if these are more

_Points: TypeAlias = Annotated[int, Ge(2)] | None


@final
@dataclass(frozen=True)
class Grid(Options):
    """Points on each side of the box, both ends included; what is left out is the paper's.

    azimuth: 400 in the plane, 200 with elevation. elevation: 200, only where the scenario has elevation. range: 2000 in
    the plane, 400 with elevation.
    """

    azimuth: _Points = None
    elevation: _Points = None
    range: _Points = None

    def axes(self, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> list[Float[ndarray, " _"]]:
        """The coordinates along each side of a box [rad, m]. Raises Incompatible for elevations in the plane."""
        if len(lower) == 2 and self.elevation is not None:
            raise Incompatible(f"grid.elevation: expected none for a scenario in the plane, got {self.elevation}")
        if len(lower) == 2:
            counts = [self.azimuth or 400, self.range or 2000]
        else:
            counts = [self.azimuth or 200, self.elevation or 200, self.range or 400]
        return [np.linspace(*side) for side in zip(lower, upper, counts, strict=True)]


@final
@dataclass(frozen=True)
class Music(Formulation):
    """2D and 3D MUSIC: the K highest distinct peaks of 1/(M − ‖U_sᴴa‖²) on a grid (Schmidt 1986; Huang & Barkat 1991).

    A peak whose ridge lies oblique to the grid has several local maxima there. Maxima that climb to one and the same
    peak of the continuous spectrum count once, by the highest. Where there are fewer than K distinct peaks the
    estimate is filled up with the highest maxima left.

    grid: points in azimuth, elevation and range. refine: report the peaks climbed to instead of the grid's points.
    wavefront: what the estimator assumes (default: the scenario's). sources, criterion: how many, as of ``neef``.
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance
    needs_solver: ClassVar[bool] = False

    grid: Grid = Grid()
    refine: bool = False
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """The sources (K, d), highest peak first [rad, m]; fewer where the grid has fewer local maxima.

        Raises Incompatible with fewer snapshots than sources, or for a grid in elevation in the plane.
        """
        K = how_many(instance, self.sources, self.criterion)
        if K == 0:
            return np.empty((0, instance.manifold.dimension))
        axes = self.grid.axes(instance.lower, instance.upper)
        manifold = instance.manifold.under(self.wavefront)
        U_s = signal_subspace(instance.Y, K)
        maxima = grid_maxima(U_s, manifold, axes, KEEP)
        # ‖(I − P_a)U_s‖² = K − ‖U_sᴴa‖²/M: RLS on the signal subspace has its minima where the spectrum has its peaks
        spectrum = RLS(U_s, manifold, instance.lower, instance.upper)
        points, peaks = pick_peaks(spectrum, manifold, maxima, K)
        return peaks if self.refine else points


def grid_maxima(
    U_s: Complex[ndarray, "m k"], manifold: Manifold, axes: list[Float[ndarray, " _"]], keep: int
) -> Float[ndarray, "p d"]:
    """The highest local maxima of ‖U_sᴴa‖² on a grid among all their neighbours, corners too, highest first.

    The grid is streamed: some azimuths at a time are held, with the two before them. A plateau counts once.

    axes: the grid's coordinates in azimuth, (elevation,) range. keep: how many maxima at most.
    """
    rows = kernels.pack_rows(compress(U_s))
    azimuth, slab = axes[0], tuple(len(axis) for axis in axes[1:])
    count = min(max(BLOCK // math.prod(slab), 1), len(azimuth))
    X = np.empty((count, *slab, len(axes)))
    X[..., 1:] = np.stack(np.meshgrid(*axes[1:], indexing="ij"), axis=-1)
    window = np.full((2, *slab), -np.inf)
    points, heights = np.empty((0, len(axes))), np.empty(0)
    for first in range(0, len(azimuth) + 1, count):
        turn = azimuth[first : first + count]
        X[: len(turn), ..., 0] = turn.reshape(-1, *[1] * len(slab))
        new = kernels.projected_energy(*manifold.packed, rows, X[: len(turn)].reshape(-1, len(axes)))
        edge = np.full((1 if first + count > len(azimuth) else 0, *slab), -np.inf)  # beyond the last azimuth
        window = np.concatenate([window[-2:], new.reshape(-1, *slab), edge])
        is_highest = (window == maximum_filter(window, 3, mode="constant", cval=-np.inf))[1:-1]
        where = np.flatnonzero(is_highest)
        plateaus = label(is_highest, np.ones((3,) * len(axes)))[0].ravel()[where]
        where = where[np.unique(plateaus, return_index=True)[1]]
        index = np.unravel_index(where, is_highest.shape)
        index = (index[0] + (first - 1), *index[1:])
        at = np.stack([axis[i] for axis, i in zip(axes, index, strict=True)], axis=1)
        points = np.vstack([points, at])
        heights = np.append(heights, window[1:-1].ravel()[where])
        highest = np.argsort(-heights, kind="stable")[:keep]
        points, heights = points[highest], heights[highest]
    return points


def pick_peaks(
    spectrum: RLS, manifold: Manifold, maxima: Float[ndarray, "p d"], count: int
) -> tuple[Float[ndarray, "k d"], Float[ndarray, "k d"]]:
    """The highest maxima that climb to different peaks, and these peaks; ``maxima`` come highest first.

    Where there are fewer peaks than ``count``, the highest maxima left fill up both, as far as they go.
    """
    M, d = manifold.elements, manifold.dimension
    points, peaks, twins = np.empty((0, d)), np.empty((0, d)), np.empty((0, d))
    for point in maxima:
        if len(points) == count:
            break
        peak = refine(spectrum, point, manifold)
        alike = np.abs(manifold.response(peaks).conj() @ manifold.response(peak)) ** 2 >= SAME_PEAK * M**2
        if alike.any():
            twins = np.vstack([twins, point])
        else:
            points, peaks = np.vstack([points, point]), np.vstack([peaks, peak])
    missing = twins[: count - len(points)]
    return np.vstack([points, missing]), np.vstack([peaks, missing])
