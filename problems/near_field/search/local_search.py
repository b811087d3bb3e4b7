"""The local search: Levenberg–Marquardt on the variable projection, for every misfit J = ‖(I − P_A)F‖²."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..wavefronts import Manifold
from . import general, kernels

__all__ = ["LocalMinimum", "resolution", "search_locally", "unit_of"]


class LocalMinimum(NamedTuple):
    """Where a local search ended.

    x: sources one after another [rad, m], shape (n,).
    value: J at x, computed from F − AC, so that it has its digits where it is far below ‖F‖².
    H: half of the Hessian of J in the Gauss–Newton approximation, shape (n, n), where angles are measured in beamwidths
        and the range as inverse range in depths of focus (``unit_of``).
    steps: number of steps that were tried, each of which evaluated J once.
    pivot: least pivot of Cholesky's factorization of AᴴA, relative to M: the squared distance of a response from the
        span of others. Below about 1e-3 two sources have run together, and the minimizer hangs on rounding.
    """

    x: Float[ndarray, " n"]
    value: float
    H: Float[ndarray, "n n"]
    steps: int
    pivot: float


@lru_cache(maxsize=64)
def resolution(manifold: Manifold) -> tuple[float, float]:
    """Return the beamwidth λ/D [rad] at broadside and the depth of focus 4λ/D² in inverse range [1/m].

    D = 2·max‖q_m − q̄‖ is the aperture. A change of the angle by the beamwidth changes the linear part of the phase
    between the centre of the aperture and its edge by half a turn; a change of the inverse range by the depth of focus
    changes the quadratic part by the same amount.
    """
    spread = manifold.positions - manifold.positions.mean(axis=0)
    aperture = 2 * float(np.sqrt(np.sum(spread**2, axis=1).max()))
    return manifold.wavelength_m / aperture, 4 * manifold.wavelength_m / aperture**2


@lru_cache(maxsize=64)
def unit_of(manifold: Manifold) -> Float[ndarray, " d"]:
    """Return the units of the coordinates of one source: beamwidths [rad], and the depth of focus [1/m]."""
    beamwidth, depth = resolution(manifold)
    unit = np.array([beamwidth] * (manifold.dimension - 1) + [depth])
    unit.flags.writeable = False
    return unit


def search_locally(
    F: Complex[ndarray, "m c"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    x: Float[ndarray, " n"],
    fixed: int = 0,
) -> LocalMinimum:
    """Return a local minimizer of J = ‖(I − P_A)F‖² within the box, and what is known there; J is never above J(x).

    A step of Levenberg (1944) and Marquardt (1963) minimizes the Gauss–Newton model of the variable projection (Golub &
    Pereyra 1973, doi:10.1137/0710036; Kaufman 1975, doi:10.1007/BF01932995), damped in proportion to its diagonal.
    Angles are measured in beamwidths and ranges as inverse ranges in depths of focus; no step is longer than a quarter
    in any of these, so that the search stays in the valley in which it starts. It ends when the model promises a
    decrease below 1e-13·J.

    F: factor to fit, shape (M, c); finite.
    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    x: starting point [rad, m], shape (K·d,), inside the box.
    fixed: number of sources at the beginning of x that keep their positions.
    """
    kernels.warm_up()
    held = fixed * manifold.dimension
    if not manifold.has_unit_modulus:
        return LocalMinimum(*general.local_search(manifold, F, lower, upper, unit_of(manifold), x, held))
    return LocalMinimum(*kernels.local_search(*manifold.packed, F, lower, upper, unit_of(manifold), x, held))
