"""Restarts: a solver again and again, as long as the budget lasts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from nfbench import (
    Ge,
    MeteredProblem,
    NestedSolver,
    OptionError,
    Solver,
    SolverInfo,
    combined_info,
    nested_solver,
    run_part,
    solver_of,
)

__all__ = ["Restarts"]


@dataclass(frozen=True)
class Restarts(Solver):
    """Starts a stochastic solver anew whenever it has ended, until the budget ends; the best point of all counts.

    Every start has a generator of its own, ``rng.spawn(1)[0]``, and knows nothing of those before. The population kept
    is that of the last start.

    solver: a table such as ``{ kind = "de", population = 20, generations = 60 }``; by default CMA-ES without its own
        restarts.
    evaluations: what each start may spend, which the solver sees as its budget; None: all that is left, so that
        only a solver that ends by itself is started anew.
    """

    solver: NestedSolver = field(default_factory=lambda: nested_solver("cmaes", restarts="none"))
    evaluations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, composed=True, reference="Luby, Sinclair & Zuckerman 1993, doi:10.1016/0020-0190(93)90029-9"
    )

    def validate(self) -> None:
        solver = solver_of(self.solver)
        if not solver.info.stochastic:
            text = f"expected one that is random, as others repeat themselves, got {self.solver.kind!r}"
            raise OptionError("Restarts", [("solver.kind", text)])
        object.__setattr__(self, "info", combined_info(type(self).info, [solver]))

    def warm_up(self) -> None:
        solver_of(self.solver).warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        solver = solver_of(self.solver)
        while True:  # the budget ends it
            part = problem.part(evaluations=self.evaluations)
            run_part(solver, part, rng)
            if not part.evaluations:  # nor would it do anything in another start
                return
