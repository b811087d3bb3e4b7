"""CMA-ES with restarts, from the library pycma."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import AskTellSolver, Ge, Gt, Le, MeteredProblem, SolverInfo, Tune

from ._finite import Finite
from ._wrapped import rehearse

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # pycma warns if matplotlib is not installed
    import cma

__all__ = ["CMAES"]


@dataclass(frozen=True)
class CMAES(AskTellSolver):
    """Covariance matrix adaptation evolution strategy (pycma), started at uniform random points.

    The search runs in the unit box, and pycma's BoundTransform maps points outside it back into it. A run ends when its
    steps are smaller than 1e-12 of the width of the box, when the values of a generation differ by less than 1e-12 of
    the range of values in the run, or when pycma detects stagnation.

    sigma0: initial standard deviation, as a fraction of the width of the box.
    population: population size λ of the first run; None: 4 + ⌊3 ln n⌋ for n unknowns.
    restarts: "ipop" doubles λ in each new run; "bipop" alternates such runs with runs of small λ and small initial
        steps, so that both kinds use about the same number of evaluations; "none" makes one run only.
    """

    sigma0: Annotated[float, Gt(0.0), Le(1.0), Tune(0.02, 1.0, log=True)] = 0.25
    population: Annotated[int, Ge(2), Tune(4, 100, log=True)] | None = None
    restarts: Literal["none", "ipop", "bipop"] = "bipop"

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        accepts_start=True,
        reference="Hansen & Ostermeier 2001, doi:10.1162/106365601750190398; "
        "IPOP: Auger & Hansen 2005, doi:10.1109/CEC.2005.1554902; BIPOP: Hansen 2009, doi:10.1145/1570256.1570333",
    )

    def warm_up(self) -> None:
        rehearse(self)

    def start(self, problem: MeteredProblem, rng: np.random.Generator) -> _Runs:
        return _Runs(self, problem, rng)


@final
class _Runs:
    """Successive runs of CMA-ES."""

    def __init__(self, solver: CMAES, problem: MeteredProblem, rng: np.random.Generator) -> None:
        self.solver, self.problem, self.rng = solver, problem, rng
        self.default = solver.population or 4 + int(3 * math.log(problem.dimension))
        self.population = self.default
        self.doublings = 0
        self.small = False  # regime of the current run
        self.spent = {True: 0, False: 0}  # evaluations of all small (True) and large (False) runs except the first
        self.large = 0  # evaluations of the last large run
        self.evaluations = 0  # evaluations of the current run
        self.limit = math.inf  # maximum of self.evaluations
        self.begin(solver.sigma0, problem.first_point(rng))

    def begin(self, sigma: float, mean: Float[ndarray, " n"]) -> None:
        n = self.problem.dimension
        options = {
            "popsize": self.population,
            "bounds": [0.0, 1.0],
            "seed": np.nan,  # makes pycma leave the global generator unchanged
            "randn": lambda *shape: self.rng.standard_normal(shape),
            "tolx": 1e-12,
            "tolfun": 0.0,
            "tolfunhist": 0.0,
            "tolfunrel": 1e-12,
            "verbose": -9,
            "signals_filename": "",
        }
        if n == 1:
            options["maxstd_boundrange"] = math.inf  # otherwise pycma raises when a step exceeds a third of the width
        with warnings.catch_warnings():  # pycma also adds warning filters
            warnings.simplefilter("ignore")
            self.es: Any = cma.CMAEvolutionStrategy(mean, sigma, options)
        self.finite = Finite(start=0.0)
        self.evaluations = 0

    def ask(self) -> Float[ndarray, "p n"]:
        if self.es is None:
            return np.empty((0, self.problem.dimension))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.U = self.es.ask()
        return self.problem.from_unit(np.array(self.U))

    def tell(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        self.evaluations += len(values)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            self.es.tell(self.U, self.finite.many(values))
            if not self.es.stop() and self.evaluations < self.limit:
                return
        self.restart()

    def restart(self) -> None:
        """Choose the regime of the next run and start it."""
        if self.solver.restarts == "none":
            self.es = None
            return
        if self.doublings:  # the first run belongs to neither regime
            self.spent[self.small] += self.evaluations
        if not self.small:
            self.large = self.evaluations
        self.small = self.solver.restarts == "bipop" and self.spent[True] < self.spent[False]
        if self.small:
            ratio = 0.5 * 2.0**self.doublings
            self.population = int(self.default * ratio ** (self.rng.random() ** 2))
            self.limit = 0.5 * self.large
            sigma = self.solver.sigma0 * 10.0 ** (-2.0 * self.rng.random())
            self.begin(sigma, self.rng.random(self.problem.dimension))
        else:
            self.doublings += 1
            self.population = self.default * 2**self.doublings
            self.limit = math.inf
            self.begin(self.solver.sigma0, self.rng.random(self.problem.dimension))
