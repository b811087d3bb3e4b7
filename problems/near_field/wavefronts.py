"""Response vectors of an array for four models of the wavefront, and their derivatives.

Each model states the advance f = r − d_m, by how much nearer than the origin a source is to an element, as a function
of s = u·q_m, r and w = ‖q_m‖². Then a_m = exp(j·2π/λ·f). Formulas and derivatives are in ``objectives/kernels``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray

from .geometry import direction_derivatives, directions
from .objectives import kernels

__all__ = ["Manifold", "Wavefront"]

Wavefront: TypeAlias = Literal["exact", "fresnel", "paper", "planar"]


@dataclass(frozen=True, eq=False)
class Manifold:
    """The response vectors a(θ), |a_m| = 1, of an array.

    positions: (M, 3) element positions relative to the origin [m]. wavelength_m: λ [m]. has_elevation: sources are
    ``[azimuth, elevation, range]`` rather than ``[azimuth, range]`` [rad, m].
    """

    positions: Float[ndarray, "m 3"]
    wavelength_m: float
    wavefront: Wavefront
    has_elevation: bool

    @property
    def elements(self) -> int:
        """The number M of antennas."""
        return len(self.positions)

    @property
    def dimension(self) -> int:
        """The number d of unknowns of one source: 2, or 3 with elevation."""
        return 3 if self.has_elevation else 2

    def under(self, wavefront: Wavefront | None) -> Manifold:
        """The same array under another model of the wavefront; None keeps the one it has."""
        return self if wavefront in (None, self.wavefront) else replace(self, wavefront=wavefront)

    def response(self, theta: Float[ndarray, "*p d"]) -> Complex[ndarray, "*p m"]:
        """The response vectors of sources ``theta``, one a row [rad, m]."""
        A = kernels.responses(*self.packed, np.asarray(theta, dtype=np.float64).reshape(-1, self.dimension))
        return A.reshape(*np.shape(theta)[:-1], self.elements)

    def response_and_derivatives(
        self, theta: Float[ndarray, "p d"]
    ) -> tuple[Complex[ndarray, "p m"], Complex[ndarray, "p d m"]]:
        """The response vectors and ∂a/∂θ_i, i in the order of ``theta`` [1/rad, 1/m]."""
        a, s = self.response(theta), directions(theta) @ self._columns
        by_s, by_r = kernels.advance_slopes(kernels.WAVEFRONTS[self.wavefront], s, theta[:, -1], self._squares)
        slopes = np.empty((*theta.shape, self.elements))
        slopes[:, :-1] = by_s[:, None] * (direction_derivatives(theta) @ self._columns)
        slopes[:, -1] = by_r
        if self.wavefront == "exact":
            self._correct_near_elements(theta, by_s > kernels.NEAR, slopes)
        return a, (1j * self._wavenumber) * slopes * a[:, None]

    def _correct_near_elements(
        self, theta: Float[ndarray, "p d"], near: Bool[ndarray, "p m"], slopes: Float[ndarray, "p d m"]
    ) -> None:
        """Replace the slopes of an exact wavefront where a source is so near to an element that they have no digits."""
        u, turns = directions(theta), direction_derivatives(theta)
        for i, m in np.argwhere(near):
            r, (x, y, z), (q_x, q_y, q_z) = theta[i, -1], u[i], self.positions[m]
            v: ndarray = np.array(kernels.towards(x, y, z, r, q_x, q_y, q_z))
            slopes[i, :-1, m] = -r * (turns[i] @ v)
            slopes[i, -1, m] = 1 - v @ u[i]

    @cached_property
    def packed(self) -> tuple[float, int, Float[ndarray, "4 padded"], int]:
        """The same for the kernels: λ, the wavefront's number, the geometry, M."""
        kernels.warm_up()
        geometry = kernels.pack_geometry(self.positions, self.wavelength_m)
        return float(self.wavelength_m), kernels.WAVEFRONTS[self.wavefront], geometry, self.elements

    @cached_property
    def _wavenumber(self) -> float:
        return 2 * math.pi / self.wavelength_m

    @cached_property
    def _columns(self) -> ndarray:
        return np.ascontiguousarray(self.positions.T)

    @cached_property
    def _squares(self) -> ndarray:
        squares: ndarray = np.sum(self.positions**2, axis=1)
        return squares
