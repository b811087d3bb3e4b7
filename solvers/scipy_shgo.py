"""Simplicial homology global optimization of SciPy."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, shgo

from nfbench import Ge, Incompatible, MeteredProblem, Solver, SolverInfo

__all__ = ["ScipySHGO"]

DELAUNAY_DIMENSIONS = 3  # beyond, the triangulation of a few hundred points takes minutes


@dataclass(frozen=True)
class ScipySHGO(Solver):
    """``scipy.optimize.shgo``, refined round by round until the budget ends.

    Each round adds points to a simplicial complex and searches locally from those lower than all their neighbours.

    points: new points in a round; "sobol" rounds it up to a power of two. Each round looks at all points again, so
        that many small rounds take far longer than the evaluations do.
    sampling: "simplicial": a regular subdivision of the box; "sobol", "halton": low-discrepancy points and their
        Delaunay triangulation, for at most 3 unknowns.
    local: the local search; its gradients by differences count as evaluations.
    """

    points: Annotated[int, Ge(1)] = 1024
    sampling: Literal["simplicial", "sobol", "halton"] = "simplicial"
    local: Literal["L-BFGS-B", "SLSQP"] = "SLSQP"

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False, reference="Endres, Sandrock & Focke 2018, doi:10.1007/s10898-018-0645-y"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        if self.sampling != "simplicial" and n > DELAUNAY_DIMENSIONS:
            raise Incompatible(
                f"sampling={self.sampling!r} triangulates its points, feasible in at most {DELAUNAY_DIMENSIONS} "
                f'dimensions, and the problem has {n}; use sampling="simplicial"'
            )

        def objective(u: Float[ndarray, " n"]) -> float:
            return problem(problem.from_unit(u))

        with np.errstate(all="ignore"):  # the local search meets +inf with inf - inf
            shgo(
                objective,
                Bounds(np.zeros(n), np.ones(n)),
                n=self.points,
                sampling_method=self.sampling,
                minimizer_kwargs={"method": self.local},
                options={"maxev": sys.maxsize},  # any limit given makes it go round until that limit
            )
