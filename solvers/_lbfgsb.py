"""What the solvers around SciPy's L-BFGS-B share: the objective in the unit box with a gradient."""

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
    """Value and gradient in the unit box; ``own``: the problem's gradient, else forward differences by ``step``.

    Differences are one batch of n + 1 points, none outside the box. A gradient that is no number is zero: a search that
    starts on a plateau of +inf ends there.
    """
    width = problem.upper - problem.lower

    def analytic(u: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        value, gradient = problem.value_and_gradient(problem.from_unit(u))
        return value, _flat_where_infinite(gradient * width)

    def difference(u: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        h = np.where(u + step <= 1.0, step, -step)  # look inwards at the upper bound
        values = problem.evaluate(problem.from_unit(np.vstack([u, u + np.diag(h)])))
        return float(values[0]), _flat_where_infinite((values[1:] - values[0]) / h)

    return analytic if own else difference


def _flat_where_infinite(gradient: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    return np.where(np.isfinite(gradient), gradient, 0.0)
