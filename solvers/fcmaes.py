"""CMA-ES, CR-FM-NES, PGPE, differential evolution and BiteOpt, from the library fcmaes."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import AskTellSolver, Ge, Gt, Le, MeteredProblem, SolverInfo

from ._finite import Finite
from ._wrapped import from_unit, planned, rehearse

__all__ = ["Fcmaes"]

ODD_DRAWS = {"ACMA": 3, "CRFMNES": 4, "PGPE": 2}  # population with which a run in 1 unknown draws 3 or 1 deviates


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

    def validate(self) -> None:
        object.__setattr__(
            self,
            "info",
            replace(
                type(self).info,
                plans_evaluations=self.algorithm in ("ACMA", "Bite"),
                accepts_start=self.algorithm != "DE",
            ),
        )

    def warm_up(self) -> None:
        rehearse(self)

    def start(self, problem: MeteredProblem, rng: np.random.Generator) -> _Running:
        from scipy.optimize import Bounds

        n = problem.dimension
        settings: dict[str, Any] = {
            "bounds": Bounds(np.zeros(n), np.ones(n)),
            "rg": rng,
            "x0": problem.first_point(rng),
        }
        if self.algorithm == "DE":
            del settings["x0"]  # DE starts from its own random population
        elif self.algorithm != "Bite":
            settings["input_sigma"] = self.sigma0
        if self.algorithm in ("ACMA", "Bite"):
            settings["max_evaluations"] = min(planned(problem, self.horizon), 2**31 - 1)
        if self.population is not None:
            settings["popsize"] = self.population
        _empty_cache(self.algorithm)
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


def _empty_cache(algorithm: str) -> None:
    """Discard the normal deviate that an earlier run may have left in the library.

    The C++ generator draws normal deviates in pairs and keeps the second one of a pair for the next call, even if the
    next call belongs to another run with another seed. Small runs with a fixed seed and an odd number of deviates show
    whether it keeps one: such a run begins with the kept deviate, if there is one, and changes whether one is kept.
    """
    if algorithm not in ODD_DRAWS:
        return
    from_empty = _from_empty_cache(algorithm)
    if _odd_run(algorithm, seed=0) == from_empty:  # the cache was empty, and now it is full
        _odd_run(algorithm, seed=0)


@functools.cache
def _from_empty_cache(algorithm: str) -> tuple[float, ...]:
    """Return the points of the small run with seed 0 that begins with an empty cache."""
    _odd_run(algorithm, seed=1)  # so that the cache does not hold a deviate of seed 0
    first, second, third = (_odd_run(algorithm, seed=0) for _ in range(3))
    return first if first == third else second


def _odd_run(algorithm: str, seed: int) -> tuple[float, ...]:
    """Draw an odd number of normal deviates, and return the points, which have one unknown."""
    from scipy.optimize import Bounds

    state = _classes()[algorithm](
        1,
        bounds=Bounds(np.zeros(1), np.ones(1)),
        x0=np.full(1, 0.5),
        input_sigma=0.1,
        popsize=ODD_DRAWS[algorithm],
        rg=np.random.default_rng(seed),
    )
    return tuple(np.ravel(state.ask()).tolist())


@functools.cache
def _classes() -> dict[str, Any]:
    with np.printoptions():  # restores the options, which fcmaes changes
        from fcmaes.bitecpp import Bite_C
        from fcmaes.cmaescpp import ACMA_C
        from fcmaes.crfmnescpp import CRFMNES_C
        from fcmaes.decpp import DE_C
        from fcmaes.pgpecpp import PGPE_C

    return {"ACMA": ACMA_C, "CRFMNES": CRFMNES_C, "PGPE": PGPE_C, "DE": DE_C, "Bite": Bite_C}
