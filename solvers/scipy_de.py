"""SciPy's differential evolution, with all its strategies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import Bounds, differential_evolution
from scipy.stats import qmc

from nfbench import Ge, Le, MeteredProblem, Solver, SolverInfo, Tune

from ._wrapped import rehearse

__all__ = ["ScipyDE"]

F: TypeAlias = Annotated[float, Ge(0.0), Le(2.0)]


@dataclass(frozen=True)
class ScipyDE(Solver):
    """``scipy.optimize.differential_evolution``, vectorized, with synchronous ("deferred") generations.

    population: number of individuals. It is an absolute number, whereas SciPy's own ``popsize`` is per unknown.
    strategy: mutation and crossover strategy, by SciPy's name.
    mutation: differential weight F in [0, 2], or an interval (low, high) from which each generation draws F.
    recombination: crossover probability, in [0, 1].
    init: distribution of the initial population in the box.
    tol: the run ends when the standard deviation of the population's values is at most tol times the magnitude of their
        mean. With 0 the run ends only if all values are equal, and otherwise when the budget is used up.
    polish: whether to refine the best point by L-BFGS-B, with the rest of the budget, when ``tol`` ends the run.
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
        batched=True,
        accepts_start=True,
        reference="Storn & Price 1997, doi:10.1023/A:1008202821328; Virtanen et al. 2020 (SciPy)",
    )

    def validate(self) -> None:
        if isinstance(self.mutation, tuple) and self.mutation[0] > self.mutation[1]:
            raise ValueError(f"mutation: expected (low, high) with low <= high, got {self.mutation}")

    def warm_up(self) -> None:
        rehearse(self)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        shape = (self.population, n)
        known: list[Float[ndarray, " N"]] = []  # values of the initial population, if it was evaluated before
        initial = (
            qmc.LatinHypercube(n, rng=rng).random(shape[0]) if self.init == "latin-hypercube" else rng.random(shape)
        )

        if problem.start is not None:
            x, f = problem.first_population(self.population, rng)
            initial, known = np.clip(problem.to_unit(x), 0.0, 1.0), [f]

        def objective(U: Float[ndarray, "n ..."], /) -> Any:
            if known:
                return known.pop()
            X = problem.from_unit(U.T)
            return problem(X) if X.ndim == 1 else problem.evaluate(X)  # the polishing step evaluates single points

        with np.errstate(all="ignore"):  # the polishing step computes inf - inf where the problem is +inf
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
