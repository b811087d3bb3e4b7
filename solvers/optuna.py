"""Samplers of Optuna."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from nfbench import Ge, Incompatible, MeteredProblem, Solver, SolverInfo

from ._finite import Finite
from ._wrapped import from_unit

__all__ = ["Optuna"]


@dataclass(frozen=True)
class Optuna(Solver):
    """A sampler of Optuna, in the unit box, point by point, until the budget ends.

    Optuna is made for values that take long to evaluate: a point costs it a fraction of a millisecond, and with "tpe"
    the more the more points there were. GPSampler is left out, as it needs PyTorch.

    algorithm: "cmaes": CMA-ES, for at least 2 unknowns; "tpe": tree-structured Parzen estimators; "nsgaii": a genetic
        algorithm; "qmc": scrambled Sobol' points; "random": uniform points.
    population: of "cmaes" and "nsgaii"; None: Optuna's choice.
    """

    algorithm: Literal["cmaes", "tpe", "nsgaii", "qmc", "random"] = "cmaes"
    population: Annotated[int, Ge(4)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        reference="Akiba et al. 2019, doi:10.1145/3292500.3330701; TPE: Bergstra et al. 2011",
        extra="optuna",
        requires=("optuna", "cmaes"),
    )

    def validate(self) -> None:
        if self.population is not None and self.algorithm not in ("cmaes", "nsgaii"):
            raise ValueError(f"population: expected none, as {self.algorithm} has no population, got {self.population}")

    def warm_up(self) -> None:
        import cmaes  # noqa: F401
        import optuna.samplers  # noqa: F401

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        import optuna

        n = problem.dimension
        if self.algorithm == "cmaes" and n < 2:
            raise Incompatible("Optuna's CMA-ES needs at least 2 unknowns, and the problem has 1")
        finite = Finite(start=0.0)
        unit = {f"u{j}": optuna.distributions.FloatDistribution(0.0, 1.0) for j in range(n)}
        with _silent(optuna.logging):
            study = optuna.create_study(sampler=self.sampler(optuna.samplers, int(rng.integers(2**31 - 1))))
            while True:  # the budget ends it
                trial = study.ask(unit)
                u = np.array([trial.params[name] for name in unit])
                study.tell(trial, finite.one(problem(from_unit(problem, u))))

    def sampler(self, samplers: Any, seed: int) -> Any:
        """The sampler, made from one seed."""
        if self.algorithm == "cmaes":
            return samplers.CmaEsSampler(seed=seed, popsize=self.population)
        if self.algorithm == "nsgaii":
            return samplers.NSGAIISampler(seed=seed, population_size=self.population or 50)
        if self.algorithm == "qmc":
            return samplers.QMCSampler(seed=seed, scramble=True)
        if self.algorithm == "tpe":
            return samplers.TPESampler(seed=seed, multivariate=True)
        return samplers.RandomSampler(seed=seed)


@contextlib.contextmanager
def _silent(logging: Any) -> Iterator[None]:
    """Optuna's messages off within this context: it tells of every study it begins."""
    level = logging.get_verbosity()
    logging.set_verbosity(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # experimental samplers
            yield
    finally:
        logging.set_verbosity(level)
