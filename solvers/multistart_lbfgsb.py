"""Local search from many random starts: L-BFGS-B of SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from scipy.optimize import Bounds, minimize

from nfbench import Ge, Gt, Lt, MeteredProblem, Solver, SolverInfo

from ._lbfgsb import objective

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
        n = problem.dimension
        searched = objective(problem, own=problem.has_gradient and self.gradient == "auto", step=self.step)
        started = 0
        while self.starts is None or started < self.starts:
            started += 1
            with np.errstate(all="ignore"):  # a plateau of +inf is met with inf - inf
                minimize(
                    searched,
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
