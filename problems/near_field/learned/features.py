"""What the network sees of a scene, and the coordinates in which it answers.

The coordinates of a source are u = sinφ and v = λ·cos²φ/r, or λ/r for the wavefront "paper", which has no cos²φ. In
these, the phase of a ULA along y is u·q − v·q²/2 up to higher orders (positions q in wavelengths), so that the response
of a source looks the same wherever it is, relative to its own coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..objectives import kernels
from ..wavefronts import Manifold

__all__ = ["PolarGrid", "from_polar", "to_polar"]

FLOOR = 0.01  # added to 1 − e before the logarithm
INFINITE = 1e9  # range [wavelengths] of a planar wave, v = 0


@final
@dataclass(frozen=True)
class PolarGrid:
    """A grid in u and v: u = i·step_u, |i| <= half_u, and v = j·step_v, 0 <= j < count_v."""

    step_u: float
    half_u: int
    step_v: float
    count_v: int

    @property
    def u(self) -> Float[ndarray, " n"]:
        return self.step_u * np.arange(-self.half_u, self.half_u + 1)

    @property
    def v(self) -> Float[ndarray, " j"]:
        return self.step_v * np.arange(self.count_v)

    def spectrum(self, U_s: Complex[ndarray, "m k"], manifold: Manifold) -> Float[ndarray, "n j"]:
        """Return e = ‖U_sᴴa‖²/M at all points, one row per u: a function of the projector U_s·U_sᴴ alone.

        The phases of the eigenvectors, and rotations among them, make no difference. Without noise, e = 1 at a source.
        """
        u, v = (axis.ravel() for axis in np.meshgrid(self.u, self.v, indexing="ij"))
        points = from_polar(np.stack([u, v], axis=1), manifold)
        e = kernels.projected_energy(*manifold.packed, kernels.pack_rows(U_s), points) / len(U_s)
        return e.reshape(len(self.u), len(self.v))

    def channels(self, e: Float[ndarray, "*s n j"]) -> Float[ndarray, "*s n c"]:
        """Return the inputs of the network at each u: e, and the logarithm of 1 − e, which shows where e is near 1."""
        return np.concatenate([e, np.log10(1 + FLOOR - np.clip(e, 0.0, 1.0))], axis=-1).astype(np.float32)


def to_polar(theta: Float[ndarray, "*s 2"], manifold: Manifold) -> Float[ndarray, "*s 2"]:
    """Return (u, v) of sources [rad, m]."""
    phi, r = theta[..., 0], theta[..., 1]
    return np.stack([np.sin(phi), manifold.wavelength_m * _foreshortening(np.sin(phi), manifold) / r], axis=-1)


def from_polar(x: Float[ndarray, "*s 2"], manifold: Manifold) -> Float[ndarray, "*s 2"]:
    """Return the sources [rad, m] of (u, v); where v is not positive, the range is very large."""
    u = np.clip(x[..., 0], -1.0, 1.0)
    v = np.maximum(x[..., 1], _foreshortening(u, manifold) / INFINITE)
    r = manifold.wavelength_m * np.divide(_foreshortening(u, manifold), v, out=np.full(u.shape, INFINITE), where=v > 0)
    return np.stack([np.arcsin(u), r], axis=-1)


def _foreshortening(u: ndarray, manifold: Manifold) -> ndarray:
    """cos²φ, by which the aperture is shorter seen from the source; 1 for the wavefront "paper"."""
    return np.ones_like(u) if manifold.wavefront == "paper" else 1 - u**2
