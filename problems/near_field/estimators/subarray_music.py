"""Subarray MUSIC: far-field angles on short subarrays, whose bearing lines meet where the sources are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from nfbench import Formulation, Ge, Incompatible, Instance, Lt, Minimize, Solution

from ..array_instance import ArrayInstance
from ..enumeration import Criterion, Sources, how_many
from ..objectives.rls import RLS
from ..search import warm_up as warm_up_search
from ..subspace import signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .music import grid_maxima
from .refinement import refine, refine_jointly
from .uniform_line import EQUAL, data_of_line, inverse_range_scale, regress

__all__ = ["SubarrayMusic"]

TITLE = "subarray MUSIC"
PER_BEAMWIDTH = 8  # points of the grid of sinφ per beamwidth λ/(nδ) of a subarray
EDGE = 91  # azimuths along the edges of the box at which the angles seen by a subarray are computed
FLAT = np.pi / 2  # curvature of the phase over a subarray, from its centre to its end, that passes as plane [rad]
ALIKE = 0.5  # correlation below which a peak of a subarray belongs to no source
EPS = 1e-9


@final
@dataclass(frozen=True)
class SubarrayMusic(Formulation):
    """Far-field MUSIC on subarrays and triangulation (Haghshenas, Mahmood & Gidlund 2025, arXiv:2501.11460).

    To a subarray of n elements around y = c that is short enough, a wave is plane, and its direction is that from c to
    the source. The peaks of 1/(n − ‖V_cᴴb(φ)‖²) are the directions φ_c of the sources, where V_c is an orthonormal
    basis of the rows of U_s that belong to the subarray. This basis has the SNR of the whole array.

    Peaks are paired by the vectors t with U_s,c·t ∝ b(φ_c). If U_s = A·X, where A has the responses of the whole array,
    then t is a column of X⁻¹ up to a factor, and so the same for all subarrays.

    The position of a source is the weighted least-squares point of its lines. The error of sinφ_c is the same for all
    subarrays, and a line misses the source by this times d_c/cosφ_c, where d_c is the distance (Stansfield 1947). With
    x = d_c·cosφ_c this is the linear regression tanφ_c = y/x − c·(1/x) with the weights cos⁶φ_c. For the approximate
    wavefronts the slope of the phase is regressed: sinφ_c = sinφ − c·κ with κ = cos²φ/r, or 1/r for "paper". If the
    lines diverge, the source is beyond the reach of the baseline, and its range is the largest of the box.

    The curvature within a subarray biases the angles where sources are close to each other. A source that fewer than
    two subarrays resolve is not found.

    elements: number n of elements of a subarray; None: as many as see waves from the nearest range of the box, or
        from 2D if this is larger, as plane to within a quarter of a turn, but at least K + 2 and at most M/2.
    overlap: part of a subarray that it shares with the next one.
    refine: whether to refine all sources together by a local search of weighted subspace fitting, which removes the
        bias; then there are standard errors.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel" or "paper"; None: that of the scenario.
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

    elements: Annotated[int, Ge(3)] | None = None
    overlap: Annotated[float, Ge(0.0), Lt(1.0)] = 0.75
    refine: bool = False
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

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"] | Solution:
        """Return the sources (K, 2) [rad, m]; fewer if the subarrays resolve fewer.

        Raises Incompatible if there are several frequency bins, elevation or fewer snapshots than sources, if the
        array is not a ULA along y, if its spacing is too large for the angles that the subarrays see, if subarrays are
        too short for the number of sources, or if the box has directions on both sides of the array.
        """
        Y, manifold, spacing = data_of_line(instance, self, "subarray-music", TITLE)
        K = how_many(instance, self.sources, self.criterion, self)
        lower, upper = instance.lower, instance.upper
        side = _side(lower, upper)
        n = self._length(K, len(Y), abs(spacing), manifold.wavelength_m, float(lower[1]))
        first = _first_elements(len(Y), n, self.overlap)
        y = manifold.positions[:, 1]
        centres = (y[first] + y[first + n - 1]) / 2
        sines = _sines(centres, lower, upper)
        _require_unambiguous(sines, abs(spacing), manifold.wavelength_m)
        if K == 0:
            return np.empty((0, 2))
        U_s = signal_subspace(Y, K)
        found = [_bearings(U_s[m : m + n], sines, spacing, manifold.wavelength_m) for m in first]
        tracks = _pair(found, K)
        theta = np.array([_triangulate(s, centres, manifold.wavefront) for s in tracks]).reshape(-1, 2)
        if side < 0:
            theta[:, 0] = np.pi * np.sign(lower[0] + upper[0]) - theta[:, 0]
        theta[:, 1] = 1 / np.maximum(theta[:, 1], EPS)  # lines that diverge: beyond the box
        theta = np.clip(theta, lower, upper)
        return refine_jointly(Y, manifold, lower, upper, theta) if self.refine else theta

    def _length(self, K: int, M: int, spacing: float, wavelength: float, nearest: float) -> int:
        """Return the number n of elements of a subarray."""
        n = self.elements
        if n is None:
            r = max(nearest, 2 * (M - 1) * spacing)
            plane = int(math.sqrt(4 * FLAT * r * wavelength / np.pi) / spacing) + 1  # (π/λ)·(nδ/2)²/r = FLAT
            n = min(max(plane, K + 2, 3), max(M // 2, 3))
        if not K < n < M:
            raise Incompatible(
                f"elements: expected subarrays of more than {K} elements for {K} sources, and of fewer than the "
                f"{M} elements of the array, got {n}"
            )
        return n


def _side(lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> int:
    """Return 1 if the box is in front of the array, x > 0, and -1 if it is behind; raises Incompatible otherwise."""
    low, high = np.degrees([lower[0], upper[0]])
    if low >= -90 - EPS and high <= 90 + EPS:
        return 1
    if (low >= 90 - EPS and high <= 270 + EPS) or (low >= -270 - EPS and high <= -90 + EPS):
        return -1
    raise Incompatible(
        f"azimuth_deg: expected directions on one side of the array for {TITLE}, because a line cannot distinguish its "
        f"sides, got [{low:g}, {high:g}]"
    )


def _first_elements(M: int, n: int, overlap: float) -> ndarray:
    """Return the index of the first element of each subarray; the subarrays reach from one end to the other."""
    step = max(n * (1 - overlap), 1.0)
    return np.unique(np.round(np.linspace(0, M - n, math.ceil((M - n) / step) + 1)).astype(np.intp))


def _sines(
    centres: Float[ndarray, " s"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> tuple[float, float]:
    """Return the least and the largest sinφ_c of the directions from the centres to the points of the box."""
    azimuth = np.linspace(lower[0], upper[0], EDGE)[:, None, None]
    r = np.array([lower[1], upper[1]])[:, None]
    along, away = r * np.sin(azimuth) - centres, r * np.cos(azimuth)
    s = along / np.maximum(np.hypot(along, away), EPS)
    return float(s.min()), float(s.max())


def _require_unambiguous(sines: tuple[float, float], spacing: float, wavelength: float) -> None:
    """Raise Incompatible if two directions that a subarray may see give it the same phases."""
    extent = sines[1] - sines[0]
    if spacing * extent > wavelength * (1 + EQUAL):
        raise Incompatible(
            f"array: expected a spacing of at most {1 / extent:.4g} λ for {TITLE}, whose subarrays see sines from "
            f"{sines[0]:.3g} to {sines[1]:.3g}, got {spacing / wavelength:.4g} λ, for which the angles are ambiguous"
        )


def _bearings(
    U: Complex[ndarray, "n k"], sines: tuple[float, float], spacing: float, wavelength: float
) -> tuple[Float[ndarray, " peaks"], Complex[ndarray, "k peaks"]]:
    """Return the sinφ_c of the K highest peaks of a subarray, and the unit vectors t with U·t ∝ b(φ_c)."""
    n, K = U.shape
    positions = np.zeros((n, 3))
    positions[:, 1] = spacing * (np.arange(n) - (n - 1) / 2)
    far = Manifold(positions, wavelength, "planar", has_elevation=False)
    V = np.linalg.qr(U).Q
    beamwidth = wavelength / (n * abs(spacing))
    low, high = max(sines[0] - beamwidth, -1.0), min(sines[1] + beamwidth, 1.0)
    azimuth = np.arcsin(np.linspace(low, high, math.ceil(PER_BEAMWIDTH * (high - low) / beamwidth) + 1))
    peaks = grid_maxima([(V, far)], [azimuth, np.ones(1)], K)
    spectrum = RLS(V, far, np.array([azimuth[0], 1.0]), np.array([azimuth[-1], 1.0]))
    peaks = np.array([refine(spectrum, theta, far) for theta in peaks])
    t = np.linalg.lstsq(U, far.response(peaks).T, rcond=None)[0]
    return np.sin(peaks[:, 0]), t / np.maximum(np.linalg.norm(t, axis=0), EPS)


def _pair(
    found: list[tuple[Float[ndarray, " peaks"], Complex[ndarray, "k peaks"]]], K: int
) -> list[Float[ndarray, " s"]]:
    """Return the sinφ_c of each source by subarray, NaN where a subarray does not resolve it.

    The first directions t are those of the subarray that resolves most sources, and separates them best; the second
    ones are the means of all that were assigned to them.
    """
    most = max(len(s) for s, _ in found)
    T = max((t for s, t in found if len(s) == most), key=lambda t: float(np.linalg.svd(t, compute_uv=False)[-1]))
    for _ in range(2):
        tracks = np.full((T.shape[1], len(found)), np.nan)
        members: list[list[ndarray]] = [[] for _ in tracks]
        for i, (s, t) in enumerate(found):
            alike = np.abs(T.conj().T @ t)
            for k, peak in zip(*linear_sum_assignment(-alike), strict=True):
                if alike[k, peak] >= ALIKE:
                    tracks[k, i] = s[peak]
                    members[k].append(t[:, peak])
        T = np.stack([np.linalg.svd(np.array(group).T)[0][:, 0] for group in members], axis=1)
    return [track for track in tracks[:K] if np.isfinite(track).sum() >= 2]


def _triangulate(s: Float[ndarray, " s"], centres: Float[ndarray, " s"], wavefront: Wavefront) -> tuple[float, float]:
    """Return the azimuth of a source in front of the array [rad], and its inverse range [1/m], which may be negative.

    s: sinφ_c by subarray, NaN where it is not known. centres: c [m].
    """
    known = np.isfinite(s)
    s, c = s[known], centres[known]
    if wavefront != "exact":
        sine, curvature = regress(s, c, np.ones_like(s))
        azimuth = math.asin(min(max(sine, -1.0), 1.0))
        return azimuth, curvature / max(float(inverse_range_scale(wavefront, np.array(azimuth))), EPS)
    cosine = np.sqrt(np.maximum(1 - s**2, EPS))
    slope, inverse_x = regress(s / cosine, c, cosine**6)  # y/x and 1/x
    return math.atan(slope), inverse_x / math.hypot(1.0, slope)
