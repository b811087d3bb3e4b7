"""SciPy's dual annealing: generalized simulated annealing with local search."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, dual_annealing

from nfbench import Gt, Le, Lt, MeteredProblem, Solver, SolverInfo

from ._wrapped import rehearse

__all__ = ["ScipyDualAnnealing"]


@dataclass(frozen=True)
class ScipyDualAnnealing(Solver):
    """``scipy.optimize.dual_annealing``, which repeats the annealing until the budget is used up.

    initial_temp: temperature at the start of each annealing, in (0.01, 5e4].
    restart_temp_ratio: the annealing restarts when the temperature has fallen to this fraction of its initial value, in
        (0, 1).
    visit: tail parameter of the visiting distribution, in (1, 3]; a larger value makes longer jumps more frequent.
    accept: acceptance parameter, in (-1e4, -5]; a smaller value makes it less likely that a worse point is accepted.
    local_search: whether to refine points by L-BFGS-B; the finite differences for its gradient count as evaluations.
    """

    initial_temp: Annotated[float, Gt(0.01), Le(5e4)] = 5230.0
    restart_temp_ratio: Annotated[float, Gt(0.0), Lt(1.0)] = 2e-5
    visit: Annotated[float, Gt(1.0), Le(3.0)] = 2.62
    accept: Annotated[float, Gt(-1e4), Le(-5.0)] = -5.0
    local_search: bool = True

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True, reference="Xiang, Sun, Fan & Gong 1997, doi:10.1016/S0375-9601(97)00474-X"
    )

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension

        def objective(u: Float[ndarray, " n"]) -> float:
            return problem(problem.from_unit(u))

        try:
            with np.errstate(all="ignore"):  # the local search computes inf - inf where the problem is +inf
                dual_annealing(
                    objective,
                    Bounds(np.zeros(n), np.ones(n)),
                    x0=None if problem.start is None else problem.first_point(rng),
                    maxiter=sys.maxsize,
                    maxfun=math.inf,
                    initial_temp=self.initial_temp,
                    restart_temp_ratio=self.restart_temp_ratio,
                    visit=self.visit,
                    accept=self.accept,
                    no_local_search=not self.local_search,
                    rng=rng,
                )
        except ValueError:
            if problem.nonfinite <= 1000:  # otherwise SciPy found no starting point with a finite value
                raise
