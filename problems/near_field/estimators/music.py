"""MUSIC: the points of a grid whose responses lie closest to the signal subspace."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.ndimage import label, maximum_filter

from nfbench import Formulation, Ge, Incompatible, Instance, Le, Minimize, Options

from ..array_instance import ArrayInstance, ArrayScenario
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives import kernels
from ..objectives.general_fit import GeneralFit
from ..objectives.rls import RLS, flattened
from ..objectives.sum_of_fits import SumOfFits, together
from ..search import warm_up as warm_up_search
from ..subspace import compress, signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .range_axis import RangeAxis, range_axis
from .refinement import refine

__all__ = ["SLOW_S", "Grid", "Music", "grid_maxima", "pick_peaks", "search_s", "warn_of_line_grid"]

SAME_PEAK = 0.9999
"""The squared correlation |a₁ᴴa₂|²/(‖a₁‖²‖a₂‖²) above which two refined maxima are considered the same peak.

Local searches that end at the same peak agree to within 1e-6 of 1. Two sources with a correlation as high as this do
not form two peaks at any realistic SNR."""

KEEP = 1000  # number of grid maxima kept; a ridge has about ten
MAX_SLAB = 10**7  # grid points of one azimuth, which are held in memory
BLOCK = 2**17  # grid points computed at once, or those of one azimuth if these are more

SLOW_S = 10.0  # time of a run [s] from which a default grid is worth a warning
ELEMENT_S, ROW_S = 2.5e-9, 0.15e-9  # time per grid point and element, and per dimension of the subspace besides [s]
POINT_S = 5e-8  # time to look whether a grid point is a maximum [s]

_Points: TypeAlias = Annotated[int, Ge(2), Le(100_000)] | None


@final
@dataclass(frozen=True)
class Grid(Options):
    """The numbers of grid points along each side of the box, including both ends.

    azimuth: number of azimuths; None: that of the paper, 400 without elevation and 200 with elevation.
    elevation: number of elevations, only for scenarios with elevation; None: that of the paper, 200.
    range: number of ranges; None: that of the paper, 2000 without elevation and 400 with elevation.
    """

    azimuth: _Points = None
    elevation: _Points = None
    range: _Points = None

    def validate(self) -> None:
        if (self.elevation or 1) * (self.range or 1) > MAX_SLAB:
            text = f"{self.elevation} × {self.range}"
            raise ValueError(f"elevation × range: expected at most {MAX_SLAB:,} grid points per azimuth, got {text}")

    def counts(self, dimension: int) -> list[int]:
        """Return the number of points along each side of a box of this dimension, 2 or 3."""
        if dimension == 2:
            return [self.azimuth or 400, self.range or 2000]
        return [self.azimuth or 200, self.elevation or 200, self.range or 400]

    def has_defaults(self, dimension: int) -> bool:
        """Whether the number of points along any side of a box of this dimension is the default."""
        return None in ([self.azimuth, self.range] if dimension == 2 else [self.azimuth, self.elevation, self.range])

    def axes(self, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> list[Float[ndarray, " _"]]:
        """Return the coordinates along each side of a box [rad, m].

        Raises Incompatible if ``elevation`` is given and the scenario has no elevation.
        """
        if len(lower) == 2 and self.elevation is not None:
            raise Incompatible(f"grid.elevation: expected none without elevation_deg, got {self.elevation}")
        return [np.linspace(*side) for side in zip(lower, upper, self.counts(len(lower)), strict=True)]


@final
@dataclass(frozen=True)
class Music(Formulation):
    """2D and 3D MUSIC: the K highest distinct peaks of 1/(M − ‖U_sᴴa‖²) on a grid (Schmidt 1986; Huang & Barkat 1991).

    If the ridge of a peak is oblique to the grid, it has several local maxima on the grid. Maxima from which a local
    search reaches the same peak of the continuous spectrum are counted once, by the highest of them. If there are fewer
    than K distinct peaks, the highest remaining maxima complete the estimate.

    For several frequency bins f the spectrum is 1/Σ_f(M − ‖U_s,fᴴa_f‖²): the distances of the response from the signal
    subspaces are added, and all bins have the same weight (incoherent wideband MUSIC with the arithmetic mean; Wax,
    Shan & Kailath 1984, doi:10.1109/TASSP.1984.1164400).

    grid: table with the numbers of grid points in azimuth, elevation and range.
    refine: whether to return the refined peaks instead of the grid points.
    interpolate: whether the spectrum along the range is interpolated from its values at few ranges, which agrees with
        evaluating every grid point to rounding and takes a fraction of the time.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass
    needs_solver: ClassVar[bool] = False

    grid: Grid = Grid()
    refine: bool = False
    interpolate: bool = True
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def warm_up(self) -> None:
        warm_up_search()

    def warnings(self, scenario: ArrayScenario) -> list[str]:
        d = 2 if scenario.elevation_deg is None else 3
        counts = self.grid.counts(d)
        seconds = search_s(math.prod(counts), scenario.array.count, scenario.sources) * scenario.bins
        if seconds <= SLOW_S or not self.grid.has_defaults(d):
            return []
        if self.interpolate:
            axes = self.grid.axes(*scenario.box())
            evaluated = len(range_axis([scenario.manifold().under(self.wavefront)], axes).ranges)
            seconds = seconds * evaluated / counts[-1] + math.prod(counts) * POINT_S
            if seconds <= SLOW_S:
                return []
        size = " × ".join(map(str, counts))
        names = "azimuth and range" if d == 2 else "azimuth, elevation and range"
        text = f"grid: the default of {size} points with {scenario.array.count} elements takes about {seconds:,.0f} s"
        return [f"{text} per run; set grid to fewer points in {names}, or state these numbers if they are intended"]

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m], the highest peak first; fewer if the grid has fewer local maxima.

        Raises Incompatible if there are fewer snapshots than sources, or if the grid has elevations and the scenario
        has none.
        """
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, instance.manifold.dimension))
        axes = self.grid.axes(instance.lower, instance.upper)
        bins = [(signal_subspace(band.Y, K), band.manifold) for band in calibrated(instance, self)]
        maxima = grid_maxima(bins, axes, KEEP, self.interpolate)
        # ‖(I − P_a)U_s‖² = K − ‖U_sᴴa‖²/M: the minima of RLS of the signal subspace are the peaks of the spectrum
        spectrum = together([RLS(U_s, manifold, instance.lower, instance.upper) for U_s, manifold in bins])
        points, peaks = pick_peaks(spectrum, maxima, K)
        return peaks if self.refine else points


def search_s(points: int, elements: int, sources: int) -> float:
    """Return about how long a search of a grid takes [s], on one core of a machine of 2020."""
    return points * elements * (ELEMENT_S + ROW_S * sources)


def warn_of_line_grid(grid: Grid, scenario: ArrayScenario, seconds: float) -> list[str]:
    """Return a warning if separate searches in azimuth and range on the default grid take long.

    seconds: how long they take.
    """
    if seconds <= SLOW_S or not grid.has_defaults(2):
        return []
    (azimuths, ranges), M, K = grid.counts(2), scenario.array.count, scenario.sources
    text = f"grid: the default of {azimuths} azimuths and {ranges} ranges with {M} elements and {K} sources takes"
    return [f"{text} about {seconds:,.0f} s per run; set grid to fewer points"]


def grid_maxima(
    bins: Sequence[tuple[Complex[ndarray, "m k"], Manifold]],
    axes: list[Float[ndarray, " _"]],
    keep: int,
    interpolate: bool = True,
) -> Float[ndarray, "p d"]:
    """Return the highest local maxima of Σ‖U_sᴴa‖² on a grid, shape (p, d) [rad, m], in descending order.

    A maximum is not lower than any of its neighbours, including the diagonal ones. A plateau counts once. The grid is
    never stored as a whole: only a block of azimuths and the two azimuths before it are held at a time.

    bins: signal subspace, shape (M, K), and array and wavefront model of each frequency bin.
    axes: coordinates of the grid in azimuth, (elevation,) range [rad, m].
    keep: maximum number of maxima.
    interpolate: whether the values along the range may be interpolated to rounding.
    """
    along = range_axis([manifold for _, manifold in bins], axes) if interpolate else RangeAxis(axes[-1], None)
    energies = [_energies(compress(U_s), manifold) for U_s, manifold in bins]
    azimuth, slab = axes[0], tuple(len(axis) for axis in axes[1:])
    count = min(max(BLOCK // math.prod(slab), 1), len(azimuth))
    X = np.empty((count, *slab[:-1], len(along.ranges), len(axes)))
    X[..., 1:] = np.stack(np.meshgrid(*axes[1:-1], along.ranges, indexing="ij"), axis=-1)
    window = np.full((2, *slab), -np.inf)
    points, heights = np.empty((0, len(axes))), np.empty(0)
    for first in range(0, len(azimuth) + 1, count):
        block = azimuth[first : first + count]
        X[: len(block), ..., 0] = block.reshape(-1, *[1] * len(slab))
        candidates = X[: len(block)].reshape(-1, len(axes))
        new = energies[0](candidates)
        for energy in energies[1:]:
            new += energy(candidates)
        edge = np.full((1 if first + count > len(azimuth) else 0, *slab), -np.inf)  # beyond the last azimuth
        values = along.values(new.reshape(-1, len(along.ranges))).reshape(-1, *slab)
        window = np.concatenate([window[-2:], values, edge])
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


def _energies(
    rows: Complex[ndarray, "m c"], manifold: Manifold
) -> Callable[[Float[ndarray, "p d"]], Float[ndarray, " p"]]:
    """Return the function ‖U_sᴴa‖² of many sources, or ‖U_sᴴa‖²/‖a‖² where responses have another modulus than 1."""
    if (flat := flattened(rows, manifold)) is None:
        return GeneralFit(rows, manifold, least=0.0).explained
    F, unit = flat
    return partial(kernels.projected_energy, *unit.packed, kernels.pack_rows(F))


def pick_peaks(
    spectrum: RLS | SumOfFits, maxima: Float[ndarray, "p d"], count: int
) -> tuple[Float[ndarray, "k d"], Float[ndarray, "k d"]]:
    """Return the highest maxima from which a local search reaches different peaks, and these peaks.

    If there are fewer peaks than ``count``, the highest remaining maxima are appended to both, as far as there are any.

    spectrum: RLS of the signal subspace, or their sum over the frequency bins, whose minima are the peaks.
    maxima: points (p, d) [rad, m], the highest first.
    count: number of peaks to return.
    """
    parts = spectrum.parts if isinstance(spectrum, SumOfFits) else (spectrum,)
    d, manifolds = len(spectrum.lower), [part.manifold for part in parts]
    points, peaks, twins = np.empty((0, d)), np.empty((0, d)), np.empty((0, d))
    for point in maxima:
        if len(points) == count:
            break
        peak = refine(spectrum, point, spectrum.manifold)
        is_same = [_same_direction(manifold, peaks, peak) for manifold in manifolds]
        if np.all(is_same, axis=0).any():
            twins = np.vstack([twins, point])
        else:
            points, peaks = np.vstack([points, point]), np.vstack([peaks, peak])
    missing = twins[: count - len(points)]
    return np.vstack([points, missing]), np.vstack([peaks, missing])


def _same_direction(manifold: Manifold, peaks: Float[ndarray, "k d"], peak: Float[ndarray, " d"]) -> ndarray:
    """Whether the response of each of several sources is nearly parallel to that of another."""
    A, a = manifold.response(peaks), manifold.response(peak)
    lengths = np.sum(np.abs(A) ** 2, axis=1) * np.vdot(a, a).real  # M² where all have modulus 1
    return np.abs(A.conj() @ a) ** 2 >= SAME_PEAK * lengths
