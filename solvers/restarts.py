"""Restarts of one solver until the budget is used up."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
    """Restarts a stochastic solver whenever it ends, until the budget is used up; the best point of all is the result.

    Every start has its own random generator, ``rng.spawn(1)[0]``, and is independent of the earlier ones. The
    population that is kept is that of the last start.

    solver: table such as ``{ kind = "de", population = 20, generations = 60 }``; the default is CMA-ES without its own
        restarts.
    evaluations: maximum number of evaluations per start, which the solver sees as its budget; None: the whole remaining
        budget, so that only a solver that ends by itself is restarted.
    """

    solver: NestedSolver = field(default_factory=lambda: nested_solver("cmaes", restarts="none"))
    evaluations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, composed=True, reference="Luby, Sinclair & Zuckerman 1993, doi:10.1016/0020-0190(93)90029-9"
    )

    def validate(self) -> None:
        solver = solver_of(self.solver)
        if not solver.info.stochastic:
            text = f"expected a stochastic solver, because others would repeat the same run, got {self.solver.kind!r}"
            raise OptionError("Restarts", [("solver.kind", text)])
        needs = solver.info.needs_evaluations and self.evaluations is None
        plans = solver.info.plans_evaluations and self.evaluations is None
        info = combined_info(type(self).info, [solver])
        object.__setattr__(self, "info", replace(info, needs_evaluations=needs, plans_evaluations=plans))

    def warm_up(self) -> None:
        solver_of(self.solver).warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        solver = solver_of(self.solver)
        while True:  # until BudgetExhausted is raised
            part = problem.part(evaluations=self.evaluations)
            run_part(solver, part, rng)
            if not part.evaluations:  # another start would not evaluate anything either
                return
