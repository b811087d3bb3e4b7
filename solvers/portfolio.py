"""A portfolio of several solvers that share one budget."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import numpy as np

from nfbench import (
    Gt,
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

__all__ = ["Portfolio"]


@dataclass(frozen=True)
class Portfolio(Solver):
    """Runs several solvers one after another, each on a slice of the budget; the best point of all is the result.

    The solvers run independently of each other, and each sees its slice as its budget. The remaining budget is divided
    by weight among the current solver and those after it; the budget that a solver does not use is therefore available
    to the later ones. If the last solver leaves some of the budget, another round divides it in the same way among the
    solvers that used their whole slice, which are then restarted.
    Every start has its own random generator, ``rng.spawn(1)[0]``. The slices divide the evaluations and, if the budget
    has a limit in seconds, also the time. The population that is kept is that of the solver that ran last.

    solvers: list of tables such as ``{ kind = "cmaes", sigma0 = 0.3 }``, in the order in which the solvers run.
    weights: relative sizes of the slices, one positive number per solver; None: equal slices.
    """

    solvers: tuple[NestedSolver, ...] = field(
        default_factory=lambda: (nested_solver("cmaes"), nested_solver("scipy-de"))
    )
    weights: tuple[Annotated[float, Gt(0.0)], ...] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, composed=True, reference="Huberman, Lukose & Hogg 1997, doi:10.1126/science.275.5296.51"
    )

    def validate(self) -> None:
        if not self.solvers:
            raise OptionError("Portfolio", [("solvers", "expected one or more solvers, got none")])
        if self.weights is not None and len(self.weights) != len(self.solvers):
            text = f"expected {len(self.solvers)} numbers, one for each solver, got {len(self.weights)}"
            raise OptionError("Portfolio", [("weights", text)])
        infos = [solver_of(nested).info for nested in self.solvers]
        info = replace(
            combined_info(type(self).info, map(solver_of, self.solvers)),
            needs_evaluations=any(info.needs_evaluations for info in infos),
            plans_evaluations=any(info.plans_evaluations for info in infos),
        )
        object.__setattr__(self, "info", info)

    def warm_up(self) -> None:
        for nested in self.solvers:
            solver_of(nested).warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        active = list(zip(map(solver_of, self.solvers), self.weights or [1.0] * len(self.solvers), strict=True))
        while active:
            stopped = []  # solvers that used their whole slice
            for i, (solver, weight) in enumerate(active):
                part = problem.part(weight / sum(other for _, other in active[i:]))
                if not run_part(solver, part, rng):
                    stopped.append((solver, weight))
            active = stopped
