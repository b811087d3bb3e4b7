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

from nfbench import Incompatible

from .geometry import direction_derivatives, directions
from .objectives import kernels

__all__ = ["Amplitude", "Manifold", "Wavefront"]

Wavefront: TypeAlias = Literal["exact", "fresnel", "paper", "planar"]

Amplitude: TypeAlias = Literal["constant", "spherical"]
"""How the amplitude of a wave differs between the elements: not at all, or as that of a spherical wave, r/‖p − q_m‖."""

NEAREST = 1e-6  # distance [wavelengths] from an element below which the amplitude of a spherical wave does not grow


@dataclass(frozen=True, eq=False)
class Manifold:
    """The response vectors a(θ) of an array, |a_m| = 1, or W·(ρ(θ) ⊙ a(θ)) with weights W and amplitudes ρ.

    positions: (M, 3) element positions relative to the origin [m]. wavelength_m: λ [m]. has_elevation: sources are
    ``[azimuth, elevation, range]`` rather than ``[azimuth, range]`` [rad, m]. weights: W, a matrix (rows, M) or a
    diagonal (M,), such as gains, mutual coupling and a whitening filter; None: I. amplitude: "constant", ρ = 1, or
    "spherical", ρ_m = r/‖p − q_m‖.
    """

    positions: Float[ndarray, "m 3"]
    wavelength_m: float
    wavefront: Wavefront
    has_elevation: bool
    weights: Complex[ndarray, "rows ..."] | None = None
    amplitude: Amplitude = "constant"

    @property
    def elements(self) -> int:
        """The number of entries of a response: the number M of antennas, or of rows of the weights."""
        return len(self.positions) if self.weights is None else len(self.weights)

    @property
    def has_unit_modulus(self) -> bool:
        """Whether all entries of every response have modulus 1, as the compiled kernels assume."""
        return self.weights is None and self.amplitude == "constant"

    @property
    def dimension(self) -> int:
        """The number d of unknowns of one source: 2, or 3 with elevation."""
        return 3 if self.has_elevation else 2

    def under(self, wavefront: Wavefront | None) -> Manifold:
        """The same array under another model of the wavefront; None keeps the one it has."""
        return self if wavefront in (None, self.wavefront) else replace(self, wavefront=wavefront)

    def response(self, theta: Float[ndarray, "*p d"]) -> Complex[ndarray, "*p m"]:
        """The response vectors of sources ``theta``, one a row [rad, m]."""
        rows = np.asarray(theta, dtype=np.float64).reshape(-1, self.dimension)
        A = kernels.responses(*self._packed, rows)
        if self.amplitude == "spherical":
            A *= self._amplitudes(rows)[0]
        A = self._weighted(A)
        return A.reshape(*np.shape(theta)[:-1], self.elements)

    def response_and_derivatives(
        self, theta: Float[ndarray, "p d"]
    ) -> tuple[Complex[ndarray, "p m"], Complex[ndarray, "p d m"]]:
        """The response vectors and ∂a/∂θ_i, i in the order of ``theta`` [1/rad, 1/m]."""
        a = kernels.responses(*self._packed, np.asarray(theta, dtype=np.float64))
        s = directions(theta) @ self._columns
        by_s, by_r = kernels.advance_slopes(kernels.WAVEFRONTS[self.wavefront], s, theta[:, -1], self._squares)
        slopes = np.empty((*theta.shape, len(self.positions)))
        slopes[:, :-1] = by_s[:, None] * (direction_derivatives(theta) @ self._columns)
        slopes[:, -1] = by_r
        if self.wavefront == "exact":
            self._correct_near_elements(theta, by_s > kernels.NEAR, slopes)
        derivatives = (1j * self._wavenumber) * slopes * a[:, None]
        if self.has_unit_modulus:
            return a, derivatives
        if self.amplitude == "spherical":
            rho, rho_slopes = self._amplitudes(theta)
            derivatives = rho[:, None] * derivatives + rho_slopes * a[:, None]
            a = rho * a
        return self._weighted(a), self._weighted(derivatives)

    def _weighted(self, A: Complex[ndarray, "*p m"]) -> Complex[ndarray, "*p rows"]:
        """W·a of every row a."""
        if self.weights is None:
            return A
        weighted: ndarray = A * self.weights if self.weights.ndim == 1 else A @ self.weights.T
        return weighted

    def _amplitudes(self, theta: Float[ndarray, "p d"]) -> tuple[Float[ndarray, "p m"], Float[ndarray, "p d m"]]:
        """ρ = r/δ with δ = ‖p − q_m‖, and its derivatives r²·(∂u·q)/δ³ by an angle and (w − r·s)/δ³ by the range."""
        u, r = directions(theta), theta[:, -1:]
        delta = np.linalg.norm((r * u)[:, None] - self.positions, axis=-1)
        delta = np.maximum(delta, NEAREST * self.wavelength_m)
        slopes = np.empty((*theta.shape, len(self.positions)))
        slopes[:, :-1] = (r**2 / delta**3)[:, None] * (direction_derivatives(theta) @ self._columns)
        slopes[:, -1] = (self._squares - r * (u @ self._columns)) / delta**3
        return r / delta, slopes

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

    @property
    def packed(self) -> tuple[float, int, Float[ndarray, "4 padded"], int]:
        """The same for the kernels: λ, the wavefront's number, the geometry, M.

        Raises Incompatible if there are weights or amplitudes, which the kernels would ignore.
        """
        if not self.has_unit_modulus:
            raise Incompatible("responses: expected a modulus of 1 at every element, got weights or amplitudes")
        return self._packed

    @cached_property
    def _packed(self) -> tuple[float, int, Float[ndarray, "4 padded"], int]:
        kernels.warm_up()
        geometry = kernels.pack_geometry(self.positions, self.wavelength_m)
        return float(self.wavelength_m), kernels.WAVEFRONTS[self.wavefront], geometry, len(self.positions)

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
