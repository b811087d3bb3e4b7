"""Compass search: a solver of nfbench in a package of its own."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import AskTellSolver, Gt, Le, SolverInfo

__all__ = ["Compass"]


@dataclass(frozen=True)
class Compass(AskTellSolver):
    """Compass search from random points: a step each way along each axis, halved where none is better.

    step: initial step size, as a fraction of the width of the box.
    least_step: step size below which the search restarts.
    """

    info: ClassVar[SolverInfo] = SolverInfo(batched=True, reference="Kolda, Lewis & Torczon 2003")

    step: Annotated[float, Gt(0.0), Le(0.5)] = 0.25
    least_step: Annotated[float, Gt(0.0), Le(0.5)] = 1e-7

    def start(self, problem, rng):
        return _Search(self, problem, rng)


class _Search:
    def __init__(self, solver, problem, rng):
        self.solver, self.problem, self.rng = solver, problem, rng
        self.step = 0.0

    def ask(self):
        n = self.problem.dimension
        if self.step < self.solver.least_step:
            self.step, self.value = self.solver.step, np.inf
            self.U = self.rng.random((1, n))
        else:
            ways = self.step * np.vstack([np.eye(n), -np.eye(n)])
            self.U = np.clip(self.u + ways, 0.0, 1.0)
        return self.problem.from_unit(self.U)

    def tell(self, X, values):
        best = int(np.argmin(values))
        if values[best] < self.value or len(values) == 1:
            self.u, self.value = self.U[best], values[best]
        else:
            self.step /= 2.0
