"""Generalized ESPRIT: angles at which the mirrored halves of the array match, then a range for each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Instance, Minimize, Solution

from ..array_instance import ArrayInstance, ArrayScenario
from ..enumeration import Criterion, Sources, how_many
from ..objectives.rls import RLS
from ..search import warm_up as warm_up_search
from ..subspace import signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .mirrored import candidates, confirmed, data_of_mirrored_line, examined, halves, mismatch
from .music import Grid, search_s, warn_of_line_grid
from .refinement import refine_jointly

__all__ = ["GeneralizedEsprit"]

TITLE = "generalized ESPRIT"
LEAST = 1e-300  # a determinant that rounding makes 0 or negative


@final
@dataclass(frozen=True)
class GeneralizedEsprit(Formulation):
    """Symmetric subarrays (Zhi & Chia 2007, IEEE Signal Process. Lett. 14(6); Gao & Gershman 2005 for the far field).

    In a centred ULA the quadratic phases of elements m and −m are equal. With the rows U_1 and U_2 of U_s that belong
    to the two halves, the second one in reverse order, U_1 − Ψ(φ)U_2 therefore loses rank at the angle of each source,
    where Ψ(φ) = diag(exp(j2k·y_m·sinφ)). The angles are the K highest peaks of 1/|det(WᴴU_1 − WᴴΨ(φ)U_2)|. Of the
    matrices W that the method leaves open, W = U_1 − Ψ(φ)U_2 makes the determinant that of a Gram matrix, which is zero
    at the sources only. For each angle the spectrum of 2D MUSIC is searched for the range.

    Two sources of similar curvature κ = cos²φ/r cause a false peak at the mean of their sines. Ranges are therefore
    searched for K(K + 1)/2 peaks, and the K sources are those whose responses are the closest to the signal subspace.
    The cubic phase of an exact wavefront is odd, and biases the angles. Two sources at the same angle are detected as
    one.

    grid: table with the numbers of grid points in azimuth and range.
    refine: whether to refine all sources together by a local search of weighted subspace fitting, which removes the
        bias and the errors of the grid; then there are standard errors.
    wavefront: wavefront model that the search for ranges assumes, "exact", "fresnel" or "paper"; None: that of the
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

    grid: Grid = Grid()  # noqa: RUF009  # frozen
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

    def warnings(self, scenario: ArrayScenario) -> list[str]:
        azimuths, ranges = self.grid.counts(2)
        M, K = scenario.array.count, scenario.sources
        seconds = search_s(azimuths, M, K * K) + search_s(ranges * examined(K), M, K)
        return warn_of_line_grid(self.grid, scenario, seconds)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"] | Solution:
        """Return the sources (K, 2) [rad, m], the best first; fewer if there are fewer peaks.

        Raises Incompatible if there are several frequency bins, elevation or fewer snapshots than sources, if the
        array is not a centred ULA along y with a spacing below λ/(4·sinφ_max), or if it has 2K + 1 elements or fewer.
        """
        Y, manifold = data_of_mirrored_line(instance, self, "generalized-esprit", TITLE)
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, 2))
        azimuths, ranges = self.grid.axes(instance.lower, instance.upper)
        U_s = signal_subspace(Y, K)
        pair = halves(U_s, manifold.positions[:, 1])
        squares = np.linalg.eigvalsh(mismatch(pair, azimuths, manifold.wavelength_m))
        spectrum = -np.sum(np.log(np.maximum(squares, LEAST)), axis=1)  # ln 1/det
        angles = azimuths[candidates(spectrum, K)]
        theta = np.array([_search_range(U_s, manifold, phi, ranges) for phi in angles])
        theta = confirmed(theta, U_s, manifold)
        return refine_jointly(Y, manifold, instance.lower, instance.upper, theta) if self.refine else theta


def _search_range(
    U_s: Complex[ndarray, "m k"], manifold: Manifold, azimuth: float, ranges: Float[ndarray, " p"]
) -> Float[ndarray, " d"]:
    """Return the source at this angle whose response is the closest to the signal subspace."""
    line = np.stack([np.full_like(ranges, azimuth), ranges], axis=1)
    best: ndarray = line[np.argmin(RLS(U_s, manifold, line[0], line[-1]).evaluate(line))]
    return best
