"""Newton's method for the position of one source in a residual, as Newtonized OMP uses it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from ..search import BandFit, unit_of

__all__ = ["newton_step"]

DIFFERENCE = 1e-4  # over which slopes are compared for the Hessian, in beamwidths and depths of focus
FLAT = 1e-10  # curvature relative to the greatest, above which the Hessian counts as negative definite


def newton_step(
    fits: Sequence[BandFit], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], theta: Float[ndarray, " d"]
) -> Float[ndarray, " d"]:
    """Return the source after one Newton step of G(θ) = Σ_f ‖aᴴR‖²/‖a‖² within the box; G is never lower there.

    The coordinates z are angles in beamwidths and the inverse range in depths of focus. The step z − H⁻¹g is taken only
    if H is negative definite, so that it leads to a maximum, and if it raises G. A coordinate at an end of the box is
    held if G rises beyond it.

    fits: residual R of each frequency bin, in which the source is the only one left, with the array and wavefront.
    lower: lower bounds of the source [rad, m], shape (d,).
    upper: upper bounds of the source [rad, m], shape (d,).
    theta: source [rad, m], shape (d,).
    """
    unit = unit_of(fits[0].manifold)
    z, (low, high) = _inward(theta, unit), np.sort([_inward(lower, unit), _inward(upper, unit)], axis=0)
    h = np.full(len(z), DIFFERENCE)
    h[-1] = min(DIFFERENCE, z[-1] / 2)  # the inverse range stays positive
    Z = z + np.vstack([np.zeros(len(z)), np.diag(h), -np.diag(h)])
    G, slopes = _gain_and_slopes(fits, Z, unit)
    g, d = slopes[0], len(z)
    H = (slopes[1 : d + 1] - slopes[d + 1 :]) / (2 * h[:, None])
    H = (H + H.T) / 2
    free: Bool[ndarray, " d"] = ~(((z <= low) & (g <= 0)) | ((z >= high) & (g >= 0)))
    if fits[0].manifold.wavefront == "planar":
        free[-1] = False
    if not free.any() or not np.isfinite(H).all():
        return theta
    curvatures = np.linalg.eigvalsh(H[np.ix_(free, free)])
    if not curvatures[-1] < FLAT * curvatures[0]:
        return theta
    moved = z.copy()
    moved[free] -= np.linalg.solve(H[np.ix_(free, free)], g[free])
    moved = np.clip(moved, low, high)
    if not _gain_and_slopes(fits, moved[None], unit)[0][0] > G[0]:
        return theta
    return np.clip(_outward(moved, unit), lower, upper)


def _gain_and_slopes(
    fits: Sequence[BandFit], Z: Float[ndarray, "p d"], unit: Float[ndarray, " d"]
) -> tuple[Float[ndarray, " p"], Float[ndarray, "p d"]]:
    """Return G and ∂G/∂z of points z; ∂‖aᴴR‖² = 2·Re(∂aᴴR·Rᴴa)."""
    theta = _outward(Z, unit)
    scale = np.broadcast_to(unit, theta.shape).copy()
    scale[:, -1] *= -(theta[:, -1] ** 2)  # ∂r/∂z = −r²·unit
    G, slopes = np.zeros(len(Z)), np.zeros(Z.shape)
    for R, manifold in fits:
        a, derivatives = manifold.response_and_derivatives(theta)
        b, size = a.conj() @ R, np.vecdot(a, a).real
        gain = np.vecdot(b, b).real / size
        along = (
            np.vecdot(derivatives.conj() @ R, b[:, None]).real - gain[:, None] * np.vecdot(derivatives, a[:, None]).real
        )
        G += gain
        slopes += 2 * along / size[:, None] * scale
    return G, slopes


def _inward(theta: Float[ndarray, "*p d"], unit: Float[ndarray, " d"]) -> Float[ndarray, "*p d"]:
    """Return the angles in beamwidths and the inverse range in depths of focus."""
    z = theta / unit
    z[..., -1] = 1 / (theta[..., -1] * unit[-1])
    return z


def _outward(z: Float[ndarray, "*p d"], unit: Float[ndarray, " d"]) -> Float[ndarray, "*p d"]:
    """Return the angles [rad] and the range [m]."""
    theta = z * unit
    theta[..., -1] = 1 / theta[..., -1]
    return theta
