"""Random search, the baseline that every solver should beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import AskTellSolver, Ge, MeteredProblem, SolverInfo

__all__ = ["RandomSearch"]


@dataclass(frozen=True)
class RandomSearch(AskTellSolver):
    """Evaluates independent random points, uniform in the box, until the budget is used up.

    batch: number of points per evaluation call; it changes the speed, but not the points.
    """

    batch: Annotated[int, Ge(1)] = 256

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, accepts_start=True, converges=False, reference="Brooks 1958, doi:10.1287/opre.6.2.244"
    )

    def start(self, problem: MeteredProblem, rng: np.random.Generator) -> _Uniform:
        return _Uniform(problem, rng, self.batch)


@final
class _Uniform:
    """Draws uniform points and ignores their values."""

    def __init__(self, problem: MeteredProblem, rng: np.random.Generator, batch: int) -> None:
        self.problem, self.rng, self.batch = problem, rng, batch

    def ask(self) -> Float[ndarray, "p n"]:
        return self.problem.from_unit(self.rng.random((self.batch, self.problem.dimension)))

    def tell(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        pass
