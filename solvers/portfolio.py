"""A portfolio: several solvers share one budget."""

from __future__ import annotations

from dataclasses import dataclass, field
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
    """Runs several solvers one after another on slices of the budget; the best point of all counts.

    A solver knows nothing of the others, and sees its slice as its budget. Each slice is a solver's share, by weight,
    among itself and those after it, of what is left; so what a solver leaves that ends early goes to the later ones.
    What the last leaves is shared in the same way in another round, in which those that had used their whole slice
    begin anew.
    Every start has a generator of its own, ``rng.spawn(1)[0]``. Slices are of evaluations, and of seconds where
    the budget has them. The population kept is that of the solver that ran last.

    solvers: tables such as ``{ kind = "cmaes", sigma0 = 0.3 }``, in the order they run.
    weights: of the slices, one for each solver; None: equal ones.
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
            raise OptionError("Portfolio", [("solvers", "expected one or more, got none")])
        if self.weights is not None and len(self.weights) != len(self.solvers):
            text = f"expected {len(self.solvers)} numbers, one for each solver, got {len(self.weights)}"
            raise OptionError("Portfolio", [("weights", text)])
        object.__setattr__(self, "info", combined_info(type(self).info, map(solver_of, self.solvers)))

    def warm_up(self) -> None:
        for named in self.solvers:
            solver_of(named).warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        turns = list(zip(map(solver_of, self.solvers), self.weights or [1.0] * len(self.solvers), strict=True))
        while turns:
            cut = []  # those stopped by the end of their slice
            for i, (solver, weight) in enumerate(turns):
                part = problem.part(weight / sum(other for _, other in turns[i:]))
                if not run_part(solver, part, rng):
                    cut.append((solver, weight))
            turns = cut
