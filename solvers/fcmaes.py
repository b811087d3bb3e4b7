"""CMA-ES, CR-FM-NES, PGPE, differential evolution and BiteOpt, from the library fcmaes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import AskTellSolver, Ge, Gt, Le, MeteredProblem, SolverInfo

from ._finite import Finite
from ._wrapped import from_unit, planned

__all__ = ["Fcmaes"]


@dataclass(frozen=True)
class Fcmaes(AskTellSolver):
    """An algorithm of fcmaes (C++), run in the unit box from a uniform random point.

    The run ends when the budget is used up or the library reports that the algorithm has ended.

    algorithm: "ACMA" is active CMA-ES; "CRFMNES" is the fast moving natural evolution strategy CR-FM-NES; "PGPE" uses
        policy gradients; "DE" is differential evolution with temporal locality; "Bite" is BiteOpt.
    sigma0: initial standard deviation, as a fraction of the width of the box; DE and Bite do not use it.
    population: number of points per generation; None: the library's default.
    horizon: number of evaluations to plan for if the budget does not limit them; only ACMA and Bite use it.
    """

    algorithm: Literal["ACMA", "CRFMNES", "PGPE", "DE", "Bite"] = "DE"
    sigma0: Annotated[float, Gt(0.0), Le(1.0)] = 0.3
    population: Annotated[int, Ge(4)] | None = None
    horizon: Annotated[int, Ge(1)] = 100_000

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        reference="Wolz (fcmaes); CR-FM-NES: Nomura & Ono 2022",
        extra="fcmaes",
        requires=("fcmaes",),
    )

    def warm_up(self) -> None:
        _classes()

    def start(self, problem: MeteredProblem, rng: np.random.Generator) -> _Running:
        from scipy.optimize import Bounds

        n = problem.dimension
        settings: dict[str, Any] = {"bounds": Bounds(np.zeros(n), np.ones(n)), "rg": rng, "x0": rng.random(n)}
        if self.algorithm == "DE":
            del settings["x0"]  # DE starts from its own random population
        elif self.algorithm != "Bite":
            settings["input_sigma"] = self.sigma0
        if self.algorithm in ("ACMA", "Bite"):
            settings["max_evaluations"] = min(planned(problem, self.horizon), 2**31 - 1)
        if self.population is not None:
            settings["popsize"] = self.population
        return _Running(_classes()[self.algorithm](n, **settings), problem)


@final
class _Running:
    """The ask/tell state of a fcmaes algorithm on the unit box."""

    def __init__(self, state: Any, problem: MeteredProblem) -> None:
        self.state, self.problem = state, problem
        self.finite = Finite(start=0.0)
        self.ended = False

    def ask(self) -> Float[ndarray, "p n"]:
        U = None if self.ended else self.state.ask()
        if U is None:
            return np.empty((0, self.problem.dimension))
        return from_unit(self.problem, np.atleast_2d(U))

    def tell(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        self.ended = self.state.tell(self.finite.many(values)) != 0


def _classes() -> dict[str, Any]:
    from fcmaes.bitecpp import Bite_C
    from fcmaes.cmaescpp import ACMA_C
    from fcmaes.crfmnescpp import CRFMNES_C
    from fcmaes.decpp import DE_C
    from fcmaes.pgpecpp import PGPE_C

    return {"ACMA": ACMA_C, "CRFMNES": CRFMNES_C, "PGPE": PGPE_C, "DE": DE_C, "Bite": Bite_C}
