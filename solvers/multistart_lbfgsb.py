"""Local searches by SciPy's L-BFGS-B from many random starting points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from scipy.optimize import Bounds, minimize

from nfbench import Ge, Gt, Lt, MeteredProblem, Solver, SolverInfo

from ._lbfgsb import objective
from ._wrapped import rehearse

__all__ = ["MultistartLBFGSB"]


@dataclass(frozen=True)
class MultistartLBFGSB(Solver):
    """L-BFGS-B in the unit box, restarted at a uniform random point whenever it has converged.

    starts: number of local searches; None: restart until the budget is used up.
    gradient: "auto" uses the problem's gradient if it has one, and forward differences otherwise; "difference" always
        uses forward differences. A gradient by differences takes one batch of n + 1 points for n unknowns. All of them
        count as evaluations, and none lies outside the box.
    step: step of the forward differences, as a fraction of the width of the box.
    corrections: number m of correction pairs from which L-BFGS-B approximates the Hessian.
    ftol: a search ends when an iteration lowers the value by no more than ftol·max(|f_k|, |f_k+1|, 1).
    gtol: a search ends when no component of the projected gradient, taken in the unit box, exceeds gtol.
    """

    starts: Annotated[int, Ge(1)] | None = None
    gradient: Literal["auto", "difference"] = "auto"
    step: Annotated[float, Gt(0.0), Lt(0.5)] = 1e-8
    corrections: Annotated[int, Ge(1)] = 10
    ftol: Annotated[float, Ge(0.0)] = 1e-12
    gtol: Annotated[float, Ge(0.0)] = 1e-8

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        accepts_start=True,
        uses_gradient=True,
        reference="Zhu, Byrd, Lu & Nocedal 1997, doi:10.1145/279232.279236",
    )

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        searched = objective(problem, own=problem.has_gradient and self.gradient == "auto", step=self.step)
        started = 0
        while self.starts is None or started < self.starts:
            first = rng.random(n) if started else problem.first_point(rng)
            started += 1
            with np.errstate(all="ignore"):  # SciPy computes inf - inf on a plateau of +inf
                minimize(
                    searched,
                    first,
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
