"""Coordinates of one source, the phases of its response, and bounds of their third derivatives.

A chart uses c = (u, κ) with u = sinφ where all elements lie on the y axis and the box is in front of it, otherwise
c = (φ, κ) or (φ, ψ, κ). Lengths are in wavelengths and κ = λ/r. The phase of element m is ψ_m = 2π·f(s_m, κ) less its
mean over the elements (the centred gauge, in which âᴴâ' = 0 along every path); s_m = q_m·u(c) is linear in sinφ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Incompatible

from ..objectives import kernels
from ..wavefronts import Manifold
from . import phases

__all__ = ["Chart", "chart_of"]

ON_THE_AXIS = 1e-12  # wavelengths by which an element may be off the y axis
EDGE = 1e-12  # share of the width of the box within which a coordinate counts as on its edge
FARTHEST = 1000.0  # wavelengths of an element from the origin: D is then known to the ROUNDING of the kernels
TERMS = 40  # of the power series of f_κκκ with their own bounds


@dataclass(frozen=True, eq=False)
class Chart:
    """The coordinates of one source in a box Θ.

    Q: (M, 3) element positions relative to the origin, in wavelengths. lower, upper: the box Θ in coordinates, (d,).
    """

    manifold: Manifold
    Q: Float[ndarray, "m 3"]
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    is_sine: bool

    @property
    def dimension(self) -> int:
        return len(self.lower)

    @property
    def width(self) -> Float[ndarray, " d"]:
        return self.upper - self.lower

    @property
    def shear(self) -> float:
        """The slope ∂u/∂κ of lines on which the phase of ``paper`` changes by its curvature alone.

        f = q·u − κq²/2 = q'·(u − κq̄) − κq'²/2 up to a common phase, with q' = q − q̄.
        """
        return float(self.Q[:, 1].mean()) if self.is_sine and self.manifold.wavefront == "paper" else 0.0

    def from_theta(self, theta: Float[ndarray, "b d"]) -> Float[ndarray, "b d"]:
        """Return coordinates of sources [rad, m]."""
        c = theta.copy()
        if self.is_sine:
            c[:, 0] = np.sin(theta[:, 0])
        c[:, -1] = self.manifold.wavelength_m / theta[:, -1]
        return self.snapped(c)

    def snapped(self, C: Float[ndarray, "b d"]) -> Float[ndarray, "b d"]:
        """Return coordinates in the box, those next to an edge exactly on it."""
        near = EDGE * self.width
        onto_lower = np.where(self.lower + near >= C, self.lower, C)
        return np.where(self.upper - near <= C, self.upper, onto_lower)

    def to_theta(self, c: Float[ndarray, "b d"]) -> Float[ndarray, "b d"]:
        """Return sources [rad, m] with given coordinates."""
        theta = c.copy()
        if self.is_sine:
            theta[:, 0] = np.arcsin(c[:, 0])
        theta[:, -1] = self.manifold.wavelength_m / c[:, -1]
        return theta

    @cached_property
    def model(self) -> tuple[int, bool, Float[ndarray, "m 3"]]:
        """The first arguments of the kernels of phases."""
        phases.warm_up()
        return kernels.WAVEFRONTS[self.manifold.wavefront], self.is_sine, np.array(self.Q)

    def jets(
        self, C: Float[ndarray, "b d"], S: Float[ndarray, "b d d"] | None = None
    ) -> tuple[Complex[ndarray, "b m"], Float[ndarray, "b d m"], Float[ndarray, "b d d m"]]:
        """Return â at centres C, and ψ_i and ψ_ij by t, θ = c + S·t; by the coordinates themselves without S."""
        d = self.dimension
        S = np.tile(np.eye(d), (len(C), 1, 1)) if S is None else S
        return phases.phase_jets(*self.model, np.ascontiguousarray(C), np.ascontiguousarray(S))

    def third(
        self, C: Float[ndarray, "b d"], angle: Float[ndarray, " b"], kappa: Float[ndarray, " b"]
    ) -> Float[ndarray, "b 4 m"]:
        """Return bounds of |ψ_ijk| within ``angle`` and ``kappa`` of centres C, before the mean is subtracted.

        They hold on the straight lines from the centres to points of Θ. The second axis is the number of derivatives
        with respect to κ; the others are along unit directions of the angles.
        """
        k = C[:, -1]
        low = np.maximum(k - kappa, np.minimum(k, self.lower[-1]))
        high = np.minimum(k + kappa, np.maximum(k, self.upper[-1]))
        reach = np.column_stack([np.maximum(k - low, high - k), np.maximum(np.abs(low), np.abs(high))])
        where = np.ascontiguousarray(C), np.ascontiguousarray(angle), reach
        return phases.third_bounds(*self.model, self._slopes, _series(), *where)

    def analytic(self, C: Float[ndarray, "b d"]) -> Float[ndarray, "b d"]:
        """Return the points next to C at which the bounds of the exact phases hold: |u| <= 1 and |κ|·‖q_m‖ < 1."""
        if self.manifold.wavefront != "exact":
            return C
        limit = (self.upper[-1] + 1 / np.linalg.norm(self.Q, axis=1).max()) / 2  # of κ, beyond Θ
        angles = np.clip(C[:, :-1], -1, 1) if self.is_sine else C[:, :-1]
        return np.column_stack([angles, np.clip(C[:, -1], -limit, limit)])

    @cached_property
    def _slopes(self) -> Float[ndarray, "3 m"]:
        """Bounds of the first three derivatives of s = q·u along a straight line of unit speed in the angles.

        In (φ, ψ) ‖u'‖ <= 1, ‖u''‖² <= cos²ψ + sin²ψ(4x − 3x²) <= 4/3 and ‖u'''‖² <= 1 + 3x − 3x³ <= 2.155, x = ψ'².
        """
        if self.is_sine:  # s is linear in u
            return np.array([np.abs(self.Q[:, 1]), *np.zeros((2, len(self.Q)))])
        if self.dimension == 2:
            return np.tile(np.hypot(self.Q[:, 0], self.Q[:, 1]), (3, 1))
        return np.sqrt([[1.0], [4 / 3], [2.155]]) * np.linalg.norm(self.Q, axis=1)


def chart_of(manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> Chart:
    """Return the chart of a box [rad, m]. Raises Incompatible where no bound of the phases is known.

    That is the case for a planar wavefront, in which the range has no effect, where a range is not greater than the
    distance of an element from the origin, and for elements so far from it that phases are not known well enough.
    """
    if manifold.wavefront == "planar":
        raise Incompatible("wavefront: expected one in which the range has an effect, got planar")
    Q = manifold.positions / manifold.wavelength_m
    if np.linalg.norm(Q, axis=1).max() > FARTHEST:
        raise Incompatible(f"positions: expected elements within {FARTHEST:,.0f} wavelengths of the origin")
    kappa = manifold.wavelength_m / np.array([upper[-1], lower[-1]])
    if manifold.wavefront == "exact" and kappa[1] * np.linalg.norm(Q, axis=1).max() >= 1:
        farthest = np.linalg.norm(manifold.positions, axis=1).max()
        raise Incompatible(f"range_m: expected ranges beyond all elements ({farthest:g} m), got {lower[-1]:g} m")
    has_front = manifold.dimension == 2 and lower[0] >= -math.pi / 2 and upper[0] <= math.pi / 2
    is_sine = bool(has_front and np.abs(Q[:, 0]).max() <= ON_THE_AXIS)
    low, high = np.append(lower[:-1], kappa[0]), np.append(upper[:-1], kappa[1])
    if is_sine:
        low[0], high[0] = math.sin(lower[0]), math.sin(upper[0])
    return Chart(manifold, Q, low, high, is_sine)


@lru_cache(maxsize=1)
def _series() -> Float[ndarray, "2 n"]:
    """Return the coefficients of two power series in z = κρ, of which that of |f_κκκ|/ρ⁴ is made.

    f = −Σ_n C_n κ^{n−1} ρ^n with Gegenbauer's C_n = C_n^(−1/2)(s/ρ), |C_n| <= b_n, so |f_κκκ|/ρ⁴ is at most
    Σ_{n>=4} (n − 1)(n − 2)(n − 3) b_n z^{n−4}. b_n <= 1/(n − 1) gives 2/(1 − z)³ = Σ_{n>=4} (n − 2)(n − 3) z^{n−4}; of
    its first terms the second series is the sum, so that the rest can be added to the first.

    (2n − 1)C_n = P_n − P_{n−2}, so C_n' = P_{n−1}. Next to a maximum inside the interval, where C_n' = 0, C_n on a grid
    is lower by no more than an eighth of the square of the spacing times |P_{n−1}'| <= n²/2; at the ends it is 0.
    """
    n = np.arange(4, TERMS + 1)
    x = np.linspace(-1, 1, 40_001)
    P = np.polynomial.legendre.legvander(x, TERMS)
    largest = np.abs(P[:, n] - P[:, n - 2]).max(axis=0) / (2 * n - 1) + (x[1] - x[0]) ** 2 * n**2 / 16
    return np.array([(n - 1) * (n - 2) * (n - 3) * largest, (n - 2) * (n - 3)])
