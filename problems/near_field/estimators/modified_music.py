"""Modified MUSIC: first the angles, from statistics that do not depend on range, then a range for each angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import hankel, toeplitz

from nfbench import Formulation, Incompatible, Instance, Minimize

from ..array_instance import ArrayInstance, ArrayScenario
from ..bands import one_band
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives.rls import RLS
from ..subspace import signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .music import Grid, grid_maxima, search_s, warn_of_line_grid
from .refinement import refine
from .uniform_line import require_centre, require_quarter_wave, spacing_of, widest_sine

__all__ = ["ModifiedMusic"]


@final
@dataclass(frozen=True)
class ModifiedMusic(Formulation):
    """MUSIC with one-dimensional searches (He, Swamy & Ahmad 2012, IEEE Trans. Signal Process. 60(4)).

    In a centred ULA the quadratic phases of elements m and M+1−m are equal, so that the anti-diagonal of the covariance
    z_m = R[m, M+1−m] = Σ p_k·exp(j2k·x_m·sinφ_k) depends only on the angles. The K highest peaks of the MUSIC spectrum
    of z are the angles, and for each angle the spectrum of 2D MUSIC is searched for the range. The cubic phase of an
    exact wavefront is odd, and biases the angles. Two sources at the same angle are detected as one.

    grid: table with the numbers of grid points in azimuth and range.
    refine: whether to refine the grid points by a local search, first in azimuth and then in range.
    wavefront: wavefront model that the search for ranges assumes, "exact", "fresnel", "paper" or "planar"; None: that
        of the scenario.
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

    def warnings(self, scenario: ArrayScenario) -> list[str]:
        azimuths, ranges = self.grid.counts(2)
        M, K = scenario.array.count, scenario.sources
        seconds = search_s(azimuths, (M + 1) // 2, K) + search_s(ranges * K, M, K)
        return warn_of_line_grid(self.grid, scenario, seconds)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, 2) [rad, m], the highest peak in angle first; fewer if there are fewer peaks.

        Raises Incompatible if the scenario has elevation, if the array is not a centred ULA along y with a spacing
        below λ/(4·sinφ_max), if it has 2K elements or fewer, if there are fewer snapshots than sources, or if there are
        several frequency bins.
        """
        one_band(instance.bands, "modified-music", "as the statistics of the angles are those of one wavelength")
        Y, manifold = calibrated(instance, self)[0].received
        K, M = how_many(instance, self.sources, self.criterion, self), len(Y)
        spacing = _spacing(instance, manifold)
        if K == 0:
            return np.empty((0, 2))
        if M <= 2 * K:
            raise Incompatible(f"array: expected more than {2 * K} elements for {K} sources, got {M}")
        U_s = signal_subspace(Y, K)
        azimuths, ranges = self.grid.axes(instance.lower, instance.upper)

        U_z = _angle_subspace(Y, K)
        positions = np.zeros((len(U_z), 3))
        positions[:, 1] = 2 * spacing * np.arange(len(U_z))
        # b_i = exp(j2kδ·i·sinφ)
        far = Manifold(positions, instance.manifold.wavelength_m, "planar", has_elevation=False)
        estimate = grid_maxima([(U_z, far)], [azimuths, ranges[:1]], K)
        if self.refine:
            angles = RLS(U_z, far, instance.lower, instance.upper)  # minimal where 1/(L − ‖U_zᴴb‖²) is maximal
            estimate = np.array([refine(angles, theta, far) for theta in estimate])

        for theta in estimate:
            line = np.stack([np.full_like(ranges, theta[0]), ranges], axis=1)
            spectrum = RLS(U_s, manifold, line[0], line[-1])
            theta[:] = line[np.argmin(spectrum.evaluate(line))]
            if self.refine:
                theta[:] = refine(spectrum, theta, manifold)
        return estimate


def _spacing(instance: ArrayInstance, manifold: Manifold) -> float:
    """Return the spacing δ of the elements along y [m]; raises Incompatible if the method does not apply."""
    spacing = spacing_of(manifold, "modified MUSIC")
    require_centre(manifold, "modified MUSIC")
    require_quarter_wave(manifold, spacing, widest_sine(instance.lower, instance.upper), "modified MUSIC")
    return spacing


def _angle_subspace(Y: Complex[ndarray, "m t"], sources: int) -> Complex[ndarray, "l k"]:
    """Return U_z (L, K), L = ⌈M/2⌉, from the anti-diagonal of R̂; without noise it spans the b(φ_k).

    For odd M it consists of eigenvectors of the Hermitian Toeplitz matrix of z. For even M the lags are half-integers,
    from which no such matrix can be formed; U_z then consists of left singular vectors of the L×(M−L+1) Hankel matrix.
    """
    z = np.vecdot(Y[::-1], Y) / Y.shape[1]  # z_m = Σ_t Y[m, t]·Y[M+1−m, t]*/T
    L = (len(z) + 1) // 2
    if len(z) % 2:
        U_z: ndarray = np.linalg.eigh(toeplitz(z[L - 1 :])).eigenvectors[:, ::-1][:, :sources]
        return U_z
    return signal_subspace(hankel(z[:L], z[L - 1 :]), sources)
