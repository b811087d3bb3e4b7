"""What a network sees of a scene, and the coordinates in which it answers.

The coordinates of a source in the plane are u = sinφ and v = λ·cos²φ/r, or λ/r for the wavefront "paper", which has no
cos²φ. In these, the phase of a ULA along y is u·q − v·q²/2 up to higher orders (positions q in wavelengths), so that
the response of a source looks the same wherever it is, relative to its own coordinates.

With elevation they are u = cosψ·sinφ, w = sinψ and v = λ/r. The phase of an array in the plane of y and z is then
s − v·(‖q‖² − s²)/2 up to higher orders, s = u·q_y + w·q_z. It depends on the direction through s², which no factor of v
removes, so that the network also sees the direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..objectives import kernels
from ..wavefronts import Manifold

__all__ = ["PolarGrid", "cosines", "from_polar", "to_polar"]

FLOOR = 0.01  # added to 1 − e before the logarithm
INFINITE = 1e9  # range [wavelengths] of a planar wave, v = 0


@final
@dataclass(frozen=True)
class PolarGrid:
    """A grid in u and v: u = i·step_u, |i| <= half_u, and v = j·step_v, 0 <= j < count_v.

    With elevation, also in w: w = i·step_u, |i| <= half_w. In the plane, half_w is None.
    """

    step_u: float
    half_u: int
    step_v: float
    count_v: int
    half_w: int | None = None

    @property
    def halves(self) -> tuple[int, ...]:
        """The halves of the axes of the direction: of u, or of u and w."""
        return (self.half_u,) if self.half_w is None else (self.half_u, self.half_w)

    @property
    def u(self) -> Float[ndarray, " n"]:
        return self.step_u * np.arange(-self.half_u, self.half_u + 1)

    @property
    def v(self) -> Float[ndarray, " j"]:
        return self.step_v * np.arange(self.count_v)

    @property
    def directions(self) -> Float[ndarray, "*n a"]:
        """The direction (u,) or (u, w) at each point of the grid."""
        axes = [self.step_u * np.arange(-half, half + 1) for half in self.halves]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    @property
    def channels_count(self) -> int:
        """The number of inputs of a network at each direction."""
        return 2 * self.count_v + (0 if self.half_w is None else 5)

    def spectrum(self, U_s: Complex[ndarray, "m k"], manifold: Manifold) -> Float[ndarray, "*n j"]:
        """Return e = ‖U_sᴴa‖²/M at all points, by u, w and v: a function of the projector U_s·U_sᴴ alone.

        The phases of the eigenvectors, and rotations among them, make no difference. Without noise, e = 1 at a source.
        """
        directions = self.directions
        *shape, axes = directions.shape
        x = np.empty((*shape, self.count_v, axes + 1))
        x[..., :-1], x[..., -1] = directions[..., None, :], self.v
        points = from_polar(x.reshape(-1, axes + 1), manifold)
        e = kernels.projected_energy(*manifold.packed, kernels.pack_rows(U_s), points) / len(U_s)
        return e.reshape(*shape, self.count_v)

    def channels(self, e: Float[ndarray, "*s j"]) -> Float[ndarray, "*s c"]:
        """Return the inputs of the network at each direction: e, and the logarithm of 1 − e, where e is near 1.

        With elevation, they are followed by u, w, u², w² and u·w.
        """
        seen = [e, np.log10(1 + FLOOR - np.clip(e, 0.0, 1.0))]
        if self.half_w is not None:
            u, w = np.moveaxis(self.directions, -1, 0)
            place = np.stack([u, w, u * u, w * w, u * w], axis=-1)
            seen.append(np.broadcast_to(place, (*e.shape[:-1], 5)))
        return np.concatenate(seen, axis=-1).astype(np.float32)


def cosines(theta: Float[ndarray, "*s d"]) -> Float[ndarray, "*s a"]:
    """Return (u,) or (u, w) of sources [rad, m]."""
    if theta.shape[-1] == 2:
        return np.sin(theta[..., :1])
    phi, psi = theta[..., 0], theta[..., 1]
    return np.stack([np.cos(psi) * np.sin(phi), np.sin(psi)], axis=-1)


def to_polar(theta: Float[ndarray, "*s d"], manifold: Manifold) -> Float[ndarray, "*s d"]:
    """Return (u, v) or (u, w, v) of sources [rad, m]."""
    x = cosines(theta)
    v = manifold.wavelength_m * _foreshortening(x, manifold) / theta[..., -1]
    return np.concatenate([x, v[..., None]], axis=-1)


def from_polar(x: Float[ndarray, "*s d"], manifold: Manifold) -> Float[ndarray, "*s d"]:
    """Return the sources [rad, m] of (u, v) or (u, w, v), the nearest direction where u² + w² > 1.

    Where v is not positive, the range is very large.
    """
    direction = np.clip(x[..., :-1], -1.0, 1.0)
    shortened = _foreshortening(direction, manifold)
    v = np.maximum(x[..., -1], shortened / INFINITE)
    r = manifold.wavelength_m * np.divide(shortened, v, out=np.full(v.shape, INFINITE), where=v > 0)
    u = direction[..., 0]
    if direction.shape[-1] == 1:
        return np.stack([np.arcsin(u), r], axis=-1)
    w = direction[..., 1]
    across = np.maximum(np.sqrt(1 - w * w), math.ulp(1.0))
    return np.stack([np.arcsin(np.clip(u / across, -1.0, 1.0)), np.arcsin(w), r], axis=-1)


def _foreshortening(x: Float[ndarray, "*s a"], manifold: Manifold) -> Float[ndarray, "*s"]:
    """cos²φ, by which the aperture of a line is shorter seen from the source.

    1 for the wavefront "paper", and with elevation, where it is another one along y and z.
    """
    u = x[..., 0]
    return np.ones_like(u) if manifold.wavefront == "paper" or x.shape[-1] > 1 else 1 - u**2
