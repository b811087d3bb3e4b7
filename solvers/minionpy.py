"""Adaptive differential evolution, particle swarms and CMA-ES, from the library MinionPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from nfbench import Ge, MeteredProblem, Solver, SolverInfo

from ._finite import Finite
from ._wrapped import Stop, from_unit, planned, rehearse

__all__ = ["MinionPy"]


@dataclass(frozen=True)
class MinionPy(Solver):
    """An algorithm of MinionPy (C++), run in the unit box.

    The run ends when the budget is used up or the library considers the algorithm converged. The library plans for the
    whole budget: most of its algorithms shrink their population towards the end. RDEX and RCMAES are not offered
    because they leave the box. DA and L_BFGS_B are not offered because they print messages when they are stopped; use
    SciPy's versions instead.

    algorithm: algorithm by MinionPy's name. NelderMead is a local search.
    population: initial number of individuals; None: the library's default.
    horizon: number of evaluations to plan for if the budget does not limit them.
    """

    algorithm: Literal[
        "ARRDE",
        "DE",
        "JADE",
        "LSHADE",
        "LSHADE_cnEpSin",
        "jSO",
        "j2020",
        "NLSHADE_RSP",
        "LSRTDE",
        "IMODE",
        "AGSK",
        "ABC",
        "PSO",
        "SPSO2011",
        "DMSPSO",
        "CMAES",
        "ACMAES",
        "BIPOP_aCMAES",
        "NelderMead",
    ] = "ARRDE"
    population: Annotated[int, Ge(4)] | None = None
    horizon: Annotated[int, Ge(1)] = 100_000

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        plans_evaluations=True,
        accepts_start=True,
        reference="Muzakka (MinionPy); L-SHADE: Tanabe & Fukunaga 2014, doi:10.1109/CEC.2014.6900380",
        extra="minionpy",
        requires=("minionpy",),
    )

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        from minionpy import Minimizer

        n = problem.dimension
        stop, finite = Stop(), Finite(start=0.0)

        def objective(points: list[list[float]]) -> list[float]:
            return finite.many(problem.evaluate(from_unit(problem, np.array(points)))).tolist()

        minimizer = Minimizer(
            stop.guard(objective),
            [(0.0, 1.0)] * n,
            x0=[problem.first_point(rng).tolist()],
            algo=self.algorithm,
            maxevals=planned(problem, self.horizon),
            seed=int(rng.integers(2**31 - 1)),
            options=None if self.population is None else {"population_size": self.population},
        )
        try:
            stop.run(minimizer.optimize)
        finally:
            minimizer.optimizer = None  # the garbage collector cannot see its reference to the objective
