"""Differential evolution of SciPy, with all its strategies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, differential_evolution
from scipy.stats import qmc

from nfbench import Ge, Le, MeteredProblem, Solver, SolverInfo, Tune

__all__ = ["ScipyDE"]

F: TypeAlias = Annotated[float, Ge(0.0), Le(2.0)]


@dataclass(frozen=True)
class ScipyDE(Solver):
    """``scipy.optimize.differential_evolution``, vectorized, with synchronous ("deferred") generations.

    population: individuals, an absolute number (SciPy's own ``popsize`` is per unknown).
    strategy: mutation and crossover, in SciPy's names.
    mutation: F, or (low, high) from which each generation draws F; in [0, 2].
    recombination: crossover probability, in [0, 1].
    init: how the initial population is spread.
    tol: ends when the standard deviation of the population's values is at most tol times their mean's magnitude; at 0
        only when all are equal, so that the budget ends it.
    polish: when ended by ``tol``, refine the best by L-BFGS-B with what is left of the budget.
    """

    population: Annotated[int, Ge(5), Tune(10, 200, log=True)] = 50
    strategy: Literal[
        "best1bin",
        "best1exp",
        "best2bin",
        "best2exp",
        "rand1bin",
        "rand1exp",
        "rand2bin",
        "rand2exp",
        "randtobest1bin",
        "randtobest1exp",
        "currenttobest1bin",
        "currenttobest1exp",
    ] = "best1bin"
    mutation: F | tuple[F, F] = (0.5, 1.0)
    recombination: Annotated[float, Ge(0.0), Le(1.0)] = 0.7
    init: Literal["latin-hypercube", "uniform"] = "latin-hypercube"
    tol: Annotated[float, Ge(0.0)] = 0.0
    polish: bool = True

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, reference="Storn & Price 1997, doi:10.1023/A:1008202821328; Virtanen et al. 2020 (SciPy)"
    )

    def validate(self) -> None:
        if isinstance(self.mutation, tuple) and self.mutation[0] > self.mutation[1]:
            raise ValueError(f"mutation: expected (low, high) with low <= high, got {self.mutation}")

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        shape = (self.population, n)
        initial = (
            qmc.LatinHypercube(n, rng=rng).random(shape[0]) if self.init == "latin-hypercube" else rng.random(shape)
        )

        def objective(U: Float[ndarray, "n ..."], /) -> Any:
            X = problem.from_unit(U.T)
            return problem(X) if X.ndim == 1 else problem.evaluate(X)  # the polish asks point by point

        with np.errstate(all="ignore"):  # the polish meets +inf with inf - inf
            differential_evolution(
                objective,
                Bounds(np.zeros(n), np.ones(n)),
                strategy=self.strategy,
                mutation=self.mutation,
                recombination=self.recombination,
                init=initial,
                maxiter=2**31 - 1,
                tol=self.tol,
                polish=self.polish,
                updating="deferred",
                vectorized=True,
                rng=rng,
            )
