"""Modified MUSIC: angles first, from what is free of range, then a range for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import hankel, toeplitz

from nfbench import Formulation, Incompatible, Instance, Minimize

from ..enumeration import Criterion, Sources, how_many
from ..instance import NearFieldInstance
from ..objectives.rls import RLS
from ..subspace import signal_subspace
from ..wavefronts import Manifold, Wavefront
from .music import Grid, grid_maxima
from .refinement import refine

__all__ = ["ModifiedMusic"]


@final
@dataclass(frozen=True)
class ModifiedMusic(Formulation):
    """MUSIC by searches along lines (He, Swamy & Ahmad 2012, IEEE Trans. Signal Process. 60(4)).

    In a centred ULA the quadratic phases of elements m and M+1−m are equal, so that the anti-diagonal of the covariance
    z_m = R[m, M+1−m] = Σ p_k·exp(j2k·x_m·sinφ_k) depends on the angles alone. Its own MUSIC spectrum has K angles as
    peaks, and the spectrum of 2D MUSIC is searched along each of them for a range. The cubic phase of an exact
    wavefront is odd and biases the angles. Two sources at one angle are seen as one.

    grid: points in azimuth and range. refine: climb on from the grid's points, in azimuth and then in range.
    wavefront: what the search for ranges assumes (default: the scenario's). sources, criterion: how many, as of
    ``neef``.
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance
    needs_solver: ClassVar[bool] = False

    grid: Grid = Grid()  # noqa: RUF009  # frozen
    refine: bool = False
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """The sources (K, 2), highest peak in angle first [rad, m]; fewer where the angles have fewer peaks.

        Raises Incompatible in 3D; for all but a centred ULA along y of spacing below λ/(4·sinφ_max); for 2K elements
        or fewer; and with fewer snapshots than sources.
        """
        K, M = how_many(instance, self.sources, self.criterion), len(instance.Y)
        spacing = _spacing(instance)
        if K == 0:
            return np.empty((0, 2))
        if M <= 2 * K:
            raise Incompatible(f"array: expected more than {2 * K} elements for {K} sources, got {M}")
        U_s = signal_subspace(instance.Y, K)
        azimuths, ranges = self.grid.axes(instance.lower, instance.upper)

        U_z = _angle_subspace(instance.Y, K)
        places = np.zeros((len(U_z), 3))
        places[:, 1] = 2 * spacing * np.arange(len(U_z))
        far = Manifold(places, instance.manifold.wavelength_m, "planar", has_elevation=False)  # b_i = exp(j2kδ·i·sinφ)
        estimate = grid_maxima(U_z, far, [azimuths, ranges[:1]], K)
        if self.refine:
            angles = RLS(U_z, far, instance.lower, instance.upper)  # lowest where 1/(L − ‖U_zᴴb‖²) is highest
            estimate = np.array([refine(angles, theta, far) for theta in estimate])

        manifold = instance.manifold.under(self.wavefront)
        for theta in estimate:
            line = np.stack([np.full_like(ranges, theta[0]), ranges], axis=1)
            spectrum = RLS(U_s, manifold, line[0], line[-1])
            theta[:] = line[np.argmin(spectrum.evaluate(line))]
            if self.refine:
                theta[:] = refine(spectrum, theta, manifold)
        return estimate


def _spacing(instance: NearFieldInstance) -> float:
    """The step δ along y from element to element [m]; raises Incompatible where the method does not apply."""
    if instance.manifold.has_elevation:
        raise Incompatible("modified MUSIC works in the plane only; expected a scenario without elevation_deg")
    Q, wavelength = instance.manifold.positions, instance.manifold.wavelength_m
    steps = np.diff(Q, axis=0)
    spacing = float(steps[:, 1].mean())
    if not np.allclose(steps, [0.0, spacing, 0.0], rtol=0, atol=1e-6 * wavelength):
        raise Incompatible("array: modified MUSIC expects a uniform linear array along y, got another geometry")
    if not np.allclose(Q.mean(axis=0), 0.0, rtol=0, atol=1e-6 * wavelength):
        raise Incompatible(
            'array.origin: modified MUSIC expects "center", got another origin, from where the phases of elements '
            "m and M+1−m differ and its angles come out as sinφ − (M−1)δ/(2r)"
        )
    broadest = np.clip([-np.pi / 2, np.pi / 2], instance.lower[0], instance.upper[0])
    most = float(np.abs(np.sin([instance.lower[0], instance.upper[0], *broadest])).max())  # sinφ_max
    if not abs(spacing) < wavelength / (4 * most):
        raise Incompatible(
            f"array: modified MUSIC expects a spacing below λ/(4·sinφ_max) = {1 / (4 * most):.4g} λ, "
            f"got {abs(spacing) / wavelength:.4g} λ, at which its angles are ambiguous"
        )
    return spacing


def _angle_subspace(Y: Complex[ndarray, "m t"], sources: int) -> Complex[ndarray, "l k"]:
    """U_z, (L, K), which spans the b(φ_k) but for noise, from the anti-diagonal of R̂; L = ⌈M/2⌉.

    Odd M: eigenvectors of the Hermitian Toeplitz matrix of z. Even M has lags of half integers, of which none can be
    formed: left singular vectors of the L×(M−L+1) Hankel matrix.
    """
    z = np.vecdot(Y[::-1], Y) / Y.shape[1]  # z_m = Σ_t Y[m, t]·Y[M+1−m, t]*/T
    L = (len(z) + 1) // 2
    if len(z) % 2:
        U_z: ndarray = np.linalg.eigh(toeplitz(z[L - 1 :])).eigenvectors[:, ::-1][:, :sources]
        return U_z
    return signal_subspace(hankel(z[:L], z[L - 1 :]), sources)
