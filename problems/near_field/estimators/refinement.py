"""Local refinement of estimates, in coordinates in which the objective has a similar scale at all ranges."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.optimize import Bounds, minimize

from nfbench import Problem, Solution

from ..objectives.conditional_fit import ConditionalFit
from ..objectives.factors import factor
from ..objectives.sum_of_fits import SumOfFits
from ..search import BandFit, resolution, search_bands_locally, search_locally, standard_errors
from ..subspace import decompose
from ..wavefronts import Manifold

__all__ = ["refine", "refine_jointly", "resolution"]

ROUNDS = 10  # L-BFGS-B may end on a narrow ridge after a tiny step; a restart from there makes further progress


def refine(problem: Problem, x: Float[ndarray, " n"], manifold: Manifold) -> Float[ndarray, " n"]:
    """Return a local minimizer within the box, found from x; the result is never worse than x.

    A problem that is a misfit ‖(I − P_A)F‖² and nothing else, which has F as its attribute ``factor``, is minimized by
    Levenberg–Marquardt (``search_locally``); ConditionalFit too, with the other sources held. Any other problem, such
    as RLS with repulsion, is minimized by L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995). So is a sum of
    misfits of several frequency bins. Both measure angles in beamwidths and ranges as inverse ranges in depths of
    focus, so that a minimum is equally wide at all ranges.

    problem: problem with a gradient, RLS, SubspaceFit, ConditionalFit or SumOfFits.
    x: starting point [rad, m], shape (n,), which consists of n/d sources one after another, inside the box.
    manifold: array and wavefront model.
    """
    parts = problem.parts if isinstance(problem, SumOfFits) else (problem,)
    factors: list[Complex[ndarray, "m c"] | None] = [getattr(part, "factor", None) for part in parts]
    fits = [BandFit(F, at) for F, at in zip(factors, _manifolds(problem, manifold), strict=True) if F is not None]
    if len(fits) < len(parts):
        return _refine_by_quasi_newton(problem, x, manifold)
    d = manifold.dimension
    others = parts[0].others if isinstance(parts[0], ConditionalFit) else np.empty((0, d))
    start, box = np.concatenate([others.ravel(), x]), (problem.lower[:d], problem.upper[:d])
    if len(fits) == 1:
        refined = search_locally(fits[0].F, manifold, *box, start, fixed=len(others)).x[others.size :]
    else:
        refined = search_bands_locally(fits, *box, start, fixed=len(others)).x[others.size :]
    return refined if problem.value(refined) <= problem.value(x) else x


def refine_jointly(
    Y: Complex[ndarray, "m t"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, "k d"],
) -> Solution:
    """Return a local minimizer of weighted subspace fitting (WSF) over all sources, and its standard errors.

    Y: received data, shape (M, T).
    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m].
    upper: upper bounds of one source [rad, m].
    theta: sources from which the search starts [rad, m], shape (K, d); they are clipped to the box.
    """
    if len(theta) == 0:
        return Solution(theta)
    F, noise = factor(Y, len(theta), "wsf"), decompose(Y, len(theta)).noise
    start = np.clip(theta, lower, upper).ravel()
    refined = search_locally(F, manifold, lower, upper, start).x.reshape(theta.shape)
    return Solution(refined, standard_errors(refined, manifold, lower, upper, F, noise, Y.shape[1]))


def _manifolds(problem: Problem, manifold: Manifold) -> list[Manifold]:
    """Return the manifold of each frequency bin of the problem."""
    return [part.manifold for part in problem.parts] if isinstance(problem, SumOfFits) else [manifold]


def _refine_by_quasi_newton(problem: Problem, x: Float[ndarray, " n"], manifold: Manifold) -> Float[ndarray, " n"]:
    """Refine by L-BFGS-B; the first step, of length one in the units of ``refine``, stays in the valley of x."""
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
