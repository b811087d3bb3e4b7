"""Local search from many random starts: L-BFGS-B of SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, minimize

from nfbench import Ge, Gt, Lt, MeteredProblem, Solver, SolverInfo

__all__ = ["MultistartLBFGSB"]


@dataclass(frozen=True)
class MultistartLBFGSB(Solver):
    """L-BFGS-B in the unit box, started again at a uniform random point whenever it has converged.

    starts: local searches; None: until the budget ends.
    gradient: "auto": the problem's own where it has one, else forward differences; "difference": always differences.
        A gradient by differences is one batch of n + 1 points, all counted, none outside the box.
    step: of the differences, as a fraction of the box's width.
    corrections: m, the pairs from which L-BFGS-B builds the Hessian.
    ftol: a search ends when the value falls by less than ftol·max(|f|, 1) in an iteration.
    gtol: a search ends when no component of the projected gradient, per width of the box, exceeds gtol.
    """

    starts: Annotated[int, Ge(1)] | None = None
    gradient: Literal["auto", "difference"] = "auto"
    step: Annotated[float, Gt(0.0), Lt(0.5)] = 1e-8
    corrections: Annotated[int, Ge(1)] = 10
    ftol: Annotated[float, Ge(0.0)] = 1e-12
    gtol: Annotated[float, Ge(0.0)] = 1e-8

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, uses_gradient=True, reference="Zhu, Byrd, Lu & Nocedal 1997, doi:10.1145/279232.279236"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        width = problem.upper - problem.lower

        def analytic(u: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
            value, gradient = problem.value_and_gradient(problem.from_unit(u))
            return value, _flat_where_infinite(gradient * width)

        def difference(u: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
            h = np.where(u + self.step <= 1.0, self.step, -self.step)  # look inwards at the upper bound
            values = problem.evaluate(problem.from_unit(np.vstack([u, u + np.diag(h)])))
            return float(values[0]), _flat_where_infinite((values[1:] - values[0]) / h)

        n = problem.dimension
        own = problem.has_gradient and self.gradient == "auto"
        started = 0
        while self.starts is None or started < self.starts:
            started += 1
            with np.errstate(all="ignore"):  # a plateau of +inf is met with inf - inf
                minimize(
                    analytic if own else difference,
                    rng.random(n),
                    jac=True,
                    method="L-BFGS-B",
                    bounds=Bounds(np.zeros(n), np.ones(n)),
                    options={
                        "maxcor": self.corrections,
                        "ftol": self.ftol,
                        "gtol": self.gtol,
                        "maxiter": 2**31 - 1,
                        "maxfun": 2**31 - 1,
                    },
                )


def _flat_where_infinite(gradient: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """The gradient, zero where it is no number: a search that starts on a plateau of +inf ends there."""
    return np.where(np.isfinite(gradient), gradient, 0.0)
