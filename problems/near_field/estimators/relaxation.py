"""Relaxation: each source in turn is found again with the others projected off, until nothing is gained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Minimize

from ..objectives.conditional_fit import ConditionalFit
from ..objectives.sum_of_fits import SumOfFits, together
from ..search import BandFit
from .refinement import refine

__all__ = ["TOLERANCE", "given", "place", "relax"]

TOLERANCE = 1e-9
"""The gain of a sweep, relative to the objective, below which relaxation ends.

When a coordinate of an estimate is off by its standard deviation, DML rises by about 1/(2(M − K)T) of its value, and
WSF by 1/(2(M − K)K). A gain of 1e-9 corresponds to less than 1 % of a standard deviation for the array of the paper."""


def place(
    problem: ConditionalFit | SumOfFits,
    minimize: Minimize,
    *,
    refining: bool,
    previous: Float[ndarray, " d"] | None = None,
) -> tuple[Float[ndarray, " d"], float]:
    """Return the position (d,) [rad, m] of one source given the others, and the objective there.

    The solver's minimizer is chosen unless the previous position is as good, so the objective never rises.

    problem: the misfit of the source given the others, see ``given``.
    minimize: the run's solver with its budget.
    refining: whether to refine both positions by a local search before they are compared.
    previous: the present position of the source (d,) [rad, m]; None: it has none yet.
    """
    candidates = [minimize(problem).x] if previous is None else [previous, minimize(problem).x]
    if refining:
        candidates = [refine(problem, theta, problem.manifold) for theta in candidates]
    values = [problem.value(theta) for theta in candidates]
    best = int(np.argmin(values))
    return candidates[best], values[best]


def given(
    fits: Sequence[BandFit],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    others: Float[ndarray, "k d"],
) -> ConditionalFit | SumOfFits:
    """Return the misfit of one source given the others, summed over the frequency bins."""
    return together([ConditionalFit(F, manifold, lower, upper, others) for F, manifold in fits])


def relax(
    fits: Sequence[BandFit],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, "k d"],
    minimize: Minimize,
    *,
    sweeps: int,
    tolerance: float = TOLERANCE,
    refining: bool,
) -> Float[ndarray, "k d"]:
    """Return sources (K, d) [rad, m] that fit the factor at least as well as ``theta``, in the same order.

    In each sweep every source in turn is found again given the others, as one problem for the solver (alternating
    projection, Ziskind & Wax 1988, doi:10.1109/29.7543; RELAX, Li & Stoica 1996, doi:10.1109/78.485924). A single
    source has no others and is returned as it is.

    fits: the data of each frequency bin, or any factor of them, with the array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    theta: sources from which relaxation starts [rad, m], shape (K, d).
    minimize: the run's solver with its budget, which each problem gets in full.
    sweeps: maximum number of sweeps.
    tolerance: relative gain of a sweep at or below which relaxation ends.
    refining: whether to refine each position by a local search; these evaluations do not count towards the budget.
    """
    if len(theta) < 2:
        return theta
    theta = theta.copy()
    for _ in range(sweeps):
        before = value = np.inf
        for k in range(len(theta)):
            problem = given(fits, lower, upper, np.delete(theta, k, axis=0))
            if k == 0:
                before = problem.value(theta[k])
            theta[k], value = place(problem, minimize, refining=refining, previous=theta[k].copy())
        if before - value <= tolerance * before:
            break
    return theta
