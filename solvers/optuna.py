"""The samplers of Optuna."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from nfbench import Ge, Incompatible, MeteredProblem, Solver, SolverInfo

from ._finite import Finite
from ._wrapped import from_unit, rehearse

__all__ = ["Optuna"]


@dataclass(frozen=True)
class Optuna(Solver):
    """A sampler of Optuna, run point by point in the unit box until the budget is used up.

    Optuna is intended for objectives that are expensive to evaluate. It takes a fraction of a millisecond per point;
    with "tpe" this time grows with the number of points. GPSampler is not offered because it requires PyTorch.

    algorithm: "cmaes" is CMA-ES, for at least 2 unknowns; "tpe" is the tree-structured Parzen estimator; "nsgaii" is a
        genetic algorithm; "qmc" draws scrambled Sobol' points; "random" draws uniform points.
    population: population size of "cmaes" and "nsgaii"; None: Optuna's default. The other algorithms do not accept it.
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
            text = f"expected none, because {self.algorithm} has no such option, got {self.population}"
            raise ValueError(f"population: {text}")

    def warm_up(self) -> None:
        rehearse(self, evaluations=15)  # TPE models the objective from the tenth point on

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        import optuna

        n = problem.dimension
        if self.algorithm == "cmaes" and n < 2:
            raise Incompatible('algorithm="cmaes": expected a problem with at least 2 unknowns, got 1')
        finite = Finite(start=0.0)
        unit = {f"u{j}": optuna.distributions.FloatDistribution(0.0, 1.0) for j in range(n)}
        with _silent(optuna.logging):
            study = optuna.create_study(sampler=self.sampler(optuna.samplers, int(rng.integers(2**31 - 1))))
            while True:  # until BudgetExhausted is raised
                trial = study.ask(unit)
                u = np.array([trial.params[name] for name in unit])
                study.tell(trial, finite.one(problem(from_unit(problem, u))))

    def sampler(self, samplers: Any, seed: int) -> Any:
        """Construct the sampler with the given seed."""
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
    """Suppress Optuna's messages, which it otherwise logs for every study, and its warnings."""
    level = logging.get_verbosity()
    logging.set_verbosity(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about experimental samplers
            yield
    finally:
        logging.set_verbosity(level)
