"""The objective with its gradient in the unit box, shared by the solvers that use SciPy's L-BFGS-B."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import MeteredProblem

__all__ = ["objective"]


def objective(
    problem: MeteredProblem, own: bool, step: float = 1e-8
) -> Callable[[Float[ndarray, " n"]], tuple[float, Float[ndarray, " n"]]]:
    """Return a function that computes the value and the gradient at a point of the unit box.

    Forward differences take one batch of n + 1 points, none of which lies outside the box. Components of the gradient
    that are NaN or infinite are set to 0, so that a search that starts on a plateau of +inf ends there.

    own: whether to use the problem's gradient; otherwise forward differences are used.
    step: step of the forward differences, as a fraction of the width of the box.
    """
    width = problem.upper - problem.lower

    def analytic(u: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        value, gradient = problem.value_and_gradient(problem.from_unit(u))
        return value, _flat_where_infinite(gradient * width)

    def difference(u: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        h = np.where(u + step <= 1.0, step, -step)  # step inwards at the upper bound
        values = problem.evaluate(problem.from_unit(np.vstack([u, u + np.diag(h)])))
        return float(values[0]), _flat_where_infinite((values[1:] - values[0]) / h)

    return analytic if own else difference


def _flat_where_infinite(gradient: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    return np.where(np.isfinite(gradient), gradient, 0.0)
