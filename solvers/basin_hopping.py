"""SciPy's basin hopping with L-BFGS-B as the local search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, basinhopping

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo

from ._lbfgsb import objective
from ._wrapped import rehearse

__all__ = ["BasinHopping"]


@dataclass(frozen=True)
class BasinHopping(Solver):
    """``scipy.optimize.basinhopping`` in the unit box: random hops, each followed by a local search with L-BFGS-B.

    The local search uses the problem's gradient if it has one, and forward differences otherwise. A value together with
    its gradient counts as one evaluation.

    step: largest hop along each coordinate, as a fraction of the width of the box; hops are uniform, and are mirrored
        at the faces of the box.
    temperature: temperature T of the Metropolis acceptance rule, in the unit of the objective; with 0 only a minimum
        that is not worse is accepted.
    patience: number of successive hops without a better minimum after which the search restarts at a uniform random
        point.
    """

    step: Annotated[float, Gt(0.0), Le(1.0)] = 0.25
    temperature: Annotated[float, Ge(0.0)] = 0.0
    patience: Annotated[int, Ge(1)] = 50

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        accepts_start=True,
        uses_gradient=True,
        reference="Wales & Doye 1997, doi:10.1021/jp970984n; Leary 2000, doi:10.1023/A:1026500301312",
    )

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension

        def hop(u: Float[ndarray, " n"]) -> Any:
            moved = np.abs(u + rng.uniform(-self.step, self.step, n))
            return np.where(moved > 1.0, 2.0 - moved, moved)

        searched: Any = objective(problem, own=problem.has_gradient)  # SciPy's type stubs lack jac=True
        local: Any = {
            "method": "L-BFGS-B",
            "jac": True,
            "bounds": Bounds(np.zeros(n), np.ones(n)),
            "options": {"ftol": 1e-12, "gtol": 1e-8, "maxiter": 2**31 - 1, "maxfun": 2**31 - 1},
        }
        first = problem.first_point(rng)
        while True:
            with np.errstate(all="ignore"):  # SciPy computes inf - inf on a plateau of +inf
                basinhopping(
                    searched,
                    first,
                    niter=2**31 - 1,
                    niter_success=self.patience,
                    T=self.temperature,
                    minimizer_kwargs=local,
                    take_step=hop,
                    rng=rng,
                )
            first = rng.random(n)
