"""Population-based and direct-search algorithms of pygmo (pagmo)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Incompatible, MeteredProblem, Solver, SolverInfo

from ._finite import Finite
from ._wrapped import from_unit, planned, rehearse

__all__ = ["Pygmo"]

COUNT_MAX = 2**31 - 1
ANTS = 63  # size of the kernel of individuals from which gaco draws
TOLERANT = ("cmaes", "de", "de1220", "sade", "xnes")  # by default they end when the population has contracted


@dataclass(frozen=True)
class Pygmo(Solver):
    """An algorithm of pygmo, run in the unit box from a uniform random population until the budget is used up.

    The stopping rules by tolerance are switched off. simulated_annealing and compass_search improve the best individual
    repeatedly, and end when they make no further evaluations.

    algorithm: algorithm by pygmo's name. compass_search is a local search.
    population: number of individuals; gaco needs at least 63.
    horizon: number of evaluations to plan for if the budget does not limit them; ihs adapts its parameters to it.
    """

    algorithm: Literal[
        "bee_colony",
        "cmaes",
        "compass_search",
        "de",
        "de1220",
        "gaco",
        "gwo",
        "ihs",
        "pso",
        "pso_gen",
        "sade",
        "sea",
        "sga",
        "simulated_annealing",
        "xnes",
    ] = "sade"
    population: Annotated[int, Ge(8)] = 64
    horizon: Annotated[int, Ge(1)] = 100_000

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True,
        reference="Biscani & Izzo 2020, doi:10.21105/joss.02338; jDE: Brest et al. 2006, doi:10.1109/TEVC.2006.872133",
        extra="pygmo",
        requires=("pygmo",),
    )

    def validate(self) -> None:
        object.__setattr__(self, "info", replace(type(self).info, plans_evaluations=self.algorithm == "ihs"))

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        import pygmo

        seeds = rng.integers(2**31 - 1, size=2).tolist()
        user_algorithm = getattr(pygmo, self.algorithm)(**self.settings(problem, seeds[0]))
        evaluates_batches = hasattr(user_algorithm, "set_bfe")
        evaluator = pygmo.bfe(pygmo.member_bfe())
        if evaluates_batches:
            user_algorithm.set_bfe(evaluator)
        algorithm = pygmo.algorithm(user_algorithm)
        box = pygmo.problem(_Box(problem))
        if problem.start is None:
            population = pygmo.population(box, self.population, b=evaluator, seed=seeds[1])
        else:
            population = pygmo.population(box, 0, seed=seeds[1])
            for x, value in zip(*problem.first_population(self.population, rng), strict=True):
                population.push_back(problem.to_unit(x).clip(0.0, 1.0), [value])
        before = -1
        while before < problem.evaluations:
            before = problem.evaluations
            population = algorithm.evolve(population)

    def settings(self, problem: MeteredProblem, seed: int) -> dict[str, Any]:
        """Return the arguments with which the algorithm is constructed."""
        budget = min(planned(problem, self.horizon), COUNT_MAX)
        if self.algorithm == "compass_search":
            return {"max_fevals": budget, "stop_range": 1e-12}
        if self.algorithm == "simulated_annealing":
            return {"seed": seed}
        if self.algorithm == "gaco" and self.population < ANTS:
            raise Incompatible(f"population: expected at least {ANTS} for gaco, got {self.population}")
        settings: dict[str, Any] = {"gen": budget, "seed": seed}
        if self.algorithm in TOLERANT:
            settings |= {"ftol": 0.0, "xtol": 0.0}
        if self.algorithm in ("cmaes", "xnes"):
            settings["force_bounds"] = True
        return settings


@final
class _Box:
    """The problem with the interface that pygmo requires; a copy, which pygmo makes, refers to the same meter."""

    def __init__(self, problem: MeteredProblem) -> None:
        self.problem = problem
        self.finite = Finite(start=0.0)

    def __deepcopy__(self, memo: dict[int, Any]) -> _Box:
        return self

    def get_bounds(self) -> tuple[list[float], list[float]]:
        return [0.0] * self.problem.dimension, [1.0] * self.problem.dimension

    def fitness(self, u: Float[ndarray, " n"]) -> list[float]:
        return [self.finite.one(self.problem(from_unit(self.problem, u)))]

    def batch_fitness(self, points: Float[ndarray, " pn"]) -> Float[ndarray, " p"]:
        U = points.reshape(-1, self.problem.dimension)
        return self.finite.many(self.problem.evaluate(from_unit(self.problem, U)))
