"""Planes through the objectives at the true sources, for figures of the landscape."""

from __future__ import annotations

import math

from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Cut

from .objectives.rls import RLS
from .objectives.subspace_fitting import SubspaceFit
from .subspace import signal_subspace
from .wavefronts import Manifold

__all__ = ["landscape_cuts"]

_LABELS, _FLAT = ("Azimuth [°]", "Elevation [°]", "Range [m]"), ("Azimuth [°]", "Range [m]")
_UNITS = (180 / math.pi, 180 / math.pi, 1.0)
_RLS = "Residual least squares: the energy of the received data that one source at this place leaves unexplained."
_ESF = "Eigen-subspace fitting: the part of the signal subspace that sources at these places leave unexplained."
_MUSIC = "How well a source at this place fits the signal subspace."


def landscape_cuts(
    Y: Complex[ndarray, "m t"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, "k d"],
) -> tuple[Cut, ...]:
    """Return cuts in azimuth and range, and in 3D also in azimuth and elevation, all through the first source.

    These are RLS, which NEMO minimizes first, ESF with the other sources at their true positions, and the spectrum of
    MUSIC. Without as many snapshots as sources, there is only RLS.

    Y: received data. manifold: array and wavefront model. lower, upper: box of one source [rad, m]. theta: true sources
    [rad, m].
    """
    K = len(theta)
    found = list(_cuts("RLS", _RLS, RLS(Y, manifold, lower, upper), theta[0], theta))
    if Y.shape[1] < K or manifold.elements <= K:
        return tuple(found)
    U_s = signal_subspace(Y, K)
    esf = SubspaceFit(U_s, manifold, lower, upper, sources=K)
    found += _cuts("ESF" if K == 1 else "ESF, source 1", _ESF, esf, theta.ravel(), theta)
    # ‖(I − P_a)U_s‖² = K − ‖U_sᴴa‖²/M, so RLS of the subspace less K − 1 is the denominator of the spectrum
    found += _cuts("MUSIC spectrum", _MUSIC, RLS(U_s, manifold, lower, upper), theta[0], theta, spectrum=True)
    return tuple(found)


def _cuts(
    name: str,
    about: str,
    problem: RLS | SubspaceFit,
    through: Float[ndarray, " n"],
    theta: Float[ndarray, "k d"],
    spectrum: bool = False,
) -> list[Cut]:
    d = theta.shape[1]
    labels, units = (_FLAT, _UNITS[1:]) if d == 2 else (_LABELS, _UNITS)
    inside = theta if d == 2 else theta[:1]  # the sources in the planes
    found = []
    for i, j in [(0, 1)] if d == 2 else [(0, 2), (0, 1)]:
        axes, scale = (labels[i], labels[j]), (units[i], units[j])
        found.append(Cut(name, problem, through, (i, j), axes, scale, inside[:, [i, j]], spectrum, about))
    return found
