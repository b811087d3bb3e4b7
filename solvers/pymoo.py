"""The single-objective algorithms of pymoo."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, MeteredProblem, Solver, SolverInfo

from ._finite import Finite
from ._wrapped import from_unit, global_random, rehearse

__all__ = ["Pymoo"]

WITH_POPULATION = ("DE", "GA", "NicheGA", "PSO", "EPPSO", "G3PCX", "NRBO")
WITH_OFFSPRING = ("ES", "SRES", "ISRES")
MODULES = {
    "DE": "de",
    "GA": "ga",
    "NicheGA": "ga_niching",
    "PSO": "pso",
    "EPPSO": "pso_ep",
    "ES": "es",
    "SRES": "sres",
    "ISRES": "isres",
    "G3PCX": "g3pcx",
    "NRBO": "nrbo",
    "CMAES": "cmaes",
    "BIPOPCMAES": "cmaes",
    "NelderMead": "nelder",
}


@dataclass(frozen=True)
class Pymoo(Solver):
    """A single-objective algorithm of pymoo, run in the unit box until the budget is used up or the algorithm ends.

    Two algorithms are not offered: PatternSearch, because its runs are not reproducible from a seed, and DIRECT,
    because it takes minutes where those of SciPy and NLopt take seconds.

    algorithm: algorithm by pymoo's name, with pymoo's default settings. NelderMead is a local search.
    population: number of individuals, or of offspring for ES, SRES and ISRES; None: pymoo's default. CMAES, BIPOPCMAES
        and NelderMead do not accept it.
    """

    algorithm: Literal[
        "DE",
        "GA",
        "NicheGA",
        "PSO",
        "EPPSO",
        "ES",
        "SRES",
        "ISRES",
        "G3PCX",
        "NRBO",
        "CMAES",
        "BIPOPCMAES",
        "NelderMead",
    ] = "DE"
    population: Annotated[int, Ge(8)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        reference="Blank & Deb 2020, doi:10.1109/ACCESS.2020.2990567",
        extra="pymoo",
        requires=("pymoo",),
    )

    def validate(self) -> None:
        if self.population is not None and self.algorithm not in (*WITH_POPULATION, *WITH_OFFSPRING):
            text = f"expected none, because {self.algorithm} has no such option, got {self.population}"
            raise ValueError(f"population: {text}")

    def warm_up(self) -> None:
        rehearse(self)

    def load(self) -> Any:
        """Import and return the class of the algorithm."""
        module = importlib.import_module(f"pymoo.algorithms.soo.nonconvex.{MODULES[self.algorithm]}")
        return getattr(module, self.algorithm)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination

        finite = Finite(start=0.0)

        class Box(Problem):  # type: ignore[misc]  # pymoo has no types
            def _evaluate(self, U: Float[ndarray, "p n"], out: dict[str, Any], *_: Any, **__: Any) -> None:
                out["F"] = finite.many(problem.evaluate(from_unit(problem, U)))[:, None]

        settings: dict[str, Any] = {}
        if self.population is not None:
            settings["n_offsprings" if self.algorithm in WITH_OFFSPRING else "pop_size"] = self.population
        algorithm = self.load()(**settings)
        box = Box(n_var=problem.dimension, n_obj=1, xl=0.0, xu=1.0)
        seed = int(rng.integers(2**31 - 1))
        algorithm.setup(box, termination=NoTermination(), seed=seed, verbose=False)
        with np.errstate(all="ignore"), global_random(seed):  # pymoo's CMA-ES uses NumPy's global generator
            while algorithm.has_next():
                algorithm.next()
