"""Local refinement of estimates, in coordinates in which the objective has a similar scale at all ranges."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, minimize

from nfbench import Problem

from ..wavefronts import Manifold

__all__ = ["refine", "resolution"]

ROUNDS = 10  # L-BFGS-B may end on a narrow ridge after a tiny step; a restart from there makes further progress


def resolution(manifold: Manifold) -> tuple[float, float]:
    """Return the beamwidth λ/D [rad] at broadside and the depth of focus 4λ/D² in inverse range [1/m].

    D = 2·max‖q_m − q̄‖ is the aperture. A change of the angle by the beamwidth changes the linear part of the phase
    between the centre of the aperture and its edge by half a turn; a change of the inverse range by the depth of focus
    changes the quadratic part by the same amount.
    """
    spread = manifold.positions - manifold.positions.mean(axis=0)
    aperture = 2 * float(np.sqrt(np.sum(spread**2, axis=1).max()))
    return manifold.wavelength_m / aperture, 4 * manifold.wavelength_m / aperture**2


def refine(problem: Problem, x: Float[ndarray, " n"], manifold: Manifold) -> Float[ndarray, " n"]:
    """Return a local minimizer within the box, found by L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995) from x.

    The result is never worse than x. Angles are measured in beamwidths, and ranges as inverse ranges in depths of
    focus. In these units a minimum is equally wide at all ranges, and the first step, of length one, stays in the
    valley in which it starts.

    problem: problem with a gradient, RLS or SubspaceFit.
    x: starting point [rad, m], shape (n,), which consists of n/d sources one after another, inside the box.
    manifold: array and wavefront model.
    """
    beamwidth, depth = resolution(manifold)
    angles, d = manifold.dimension - 1, manifold.dimension
    unit = np.tile([beamwidth] * angles + [depth], len(x) // d)
    is_range = np.arange(len(x)) % d == angles

    def invert(v: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        inverted = v.copy()
        inverted[is_range] = 1 / v[is_range]
        return inverted

    def locate(z: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        return np.clip(invert(z * unit), problem.lower, problem.upper)

    start = problem.value(x)
    scale = start if start > 0 else 1.0

    def scaled(z: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        theta = locate(z)
        value, gradient = problem.value_and_gradient(theta)
        return value / scale, gradient * np.where(is_range, -(theta**2), 1.0) * unit / scale

    ends = np.sort([invert(problem.lower) / unit, invert(problem.upper) / unit], axis=0)
    z, value = invert(x) / unit, start / scale
    for _ in range(ROUNDS):
        found = minimize(
            scaled,
            z,
            jac=True,
            method="L-BFGS-B",
            bounds=Bounds(*ends),
            options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 1000, "maxfun": 5000},
        )
        z, gain, value = found.x, value - found.fun, found.fun
        if gain <= 1e-12:
            break
    refined = locate(z)
    return refined if problem.value(refined) < start else x
