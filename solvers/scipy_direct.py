"""SciPy's implementation of DIRECT (dividing rectangles)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, direct

from nfbench import Ge, Gt, MeteredProblem, Solver, SolverInfo

from ._wrapped import rehearse

__all__ = ["ScipyDirect"]

RESERVED_S = 1e-6  # an evaluation through SciPy and the meter takes longer [s]


@dataclass(frozen=True)
class ScipyDirect(Solver):
    """``scipy.optimize.direct``: DIRECT or its locally biased variant, run until the budget is used up.

    eps: minimum improvement, as a fraction of the best value, that a rectangle must promise in order to be divided.
    locally_biased: whether to use DIRECT_L, which divides only one rectangle of each size, instead of DIRECT.
    max_evaluations: number of evaluations for which SciPy reserves memory in advance; the run ends soon after this
        number of evaluations. With a budget of t seconds, it reserves memory for at most t/1e-6 evaluations.
    """

    eps: Annotated[float, Gt(0.0)] = 1e-4
    locally_biased: bool = True
    max_evaluations: Annotated[int, Ge(1)] = 1_000_000

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False,
        reference="Jones, Perttunen & Stuckman 1993, doi:10.1007/BF00941892; "
        "Gablonsky & Kelley 2001, doi:10.1023/A:1017930332101",
    )

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension

        def objective(u: Float[ndarray, " n"]) -> float:
            return problem(problem.from_unit(u))

        # SciPy allocates memory for both limits; a division takes at least two evaluations
        limit = min(problem.remaining + 1, self.max_evaluations)
        if problem.remaining_s < RESERVED_S * limit:  # reserving memory for a million takes 20 ms
            limit = max(int(problem.remaining_s / RESERVED_S), 1000)
        direct(
            objective,
            Bounds(np.zeros(n), np.ones(n)),
            eps=self.eps,
            locally_biased=self.locally_biased,
            maxfun=limit,
            maxiter=limit,
            vol_tol=0.0,
            len_tol=0.0,
            f_min_rtol=0.0,
        )
