"""SciPy's simplicial homology global optimization (SHGO)."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, shgo

from nfbench import Ge, Incompatible, MeteredProblem, Solver, SolverInfo

from ._wrapped import rehearse

__all__ = ["ScipySHGO"]

DELAUNAY_DIMENSIONS = 3  # in more dimensions, triangulating a few hundred points takes minutes


@dataclass(frozen=True)
class ScipySHGO(Solver):
    """``scipy.optimize.shgo``, which refines its sampling in rounds until the budget is used up.

    Each round adds points to a simplicial complex and starts a local search from every point that is lower than all its
    neighbours.

    points: number of new points per round; "sobol" rounds it up to a power of two. Each round processes all points
        again, so that many small rounds take much longer than the evaluations themselves.
    sampling: "simplicial" subdivides the box regularly; "sobol" and "halton" use low-discrepancy points and their
        Delaunay triangulation, for at most 3 unknowns.
    local: algorithm of the local search; the finite differences for its gradient count as evaluations.
    """

    points: Annotated[int, Ge(1)] = 1024
    sampling: Literal["simplicial", "sobol", "halton"] = "simplicial"
    local: Literal["L-BFGS-B", "SLSQP"] = "SLSQP"

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False, reference="Endres, Sandrock & Focke 2018, doi:10.1007/s10898-018-0645-y"
    )

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        if self.sampling != "simplicial" and n > DELAUNAY_DIMENSIONS:
            raise Incompatible(
                f"sampling={self.sampling!r}: expected at most {DELAUNAY_DIMENSIONS} unknowns, because it triangulates "
                f'its points, got {n}; use sampling="simplicial"'
            )

        def objective(u: Float[ndarray, " n"]) -> float:
            return problem(problem.from_unit(u))

        with np.errstate(all="ignore"):  # the local search computes inf - inf where the problem is +inf
            shgo(
                objective,
                Bounds(np.zeros(n), np.ones(n)),
                n=self.points,
                sampling_method=self.sampling,
                minimizer_kwargs={"method": self.local},
                options={"maxev": sys.maxsize},  # SHGO repeats its rounds only if some limit is given
            )
