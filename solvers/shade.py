"""SHADE: success-history based adaptive differential evolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Ge, MeteredProblem, Solver, SolverInfo, Tune

from ._adaptive import (
    Archive,
    Memory,
    binomial,
    current_to_pbest,
    draw_crossover_rates,
    draw_factors,
    lehmer,
    midpoint,
    shares,
)

__all__ = ["SHADE"]


@dataclass(frozen=True)
class SHADE(Solver):
    """JADE with a memory of means, each of the successes of one generation weighted by what they gained.

    population: N, also the size of the archive.
    memory: H, the means remembered.
    """

    population: Annotated[int, Ge(4), Tune(10, 200, log=True)] = 100
    memory: Annotated[int, Ge(1), Tune(2, 200, log=True)] = 100

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, reference="Tanabe & Fukunaga 2013, doi:10.1109/CEC.2013.6557555"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N, n = self.population, problem.dimension
        M = Memory(self.memory, F=0.5, CR=0.5)
        A = Archive(N, n)
        x = problem.from_unit(rng.random((N, n)))
        f = problem.evaluate(x)
        problem.keep_population(x, f)
        while True:
            r = rng.integers(self.memory, size=N)
            CR = draw_crossover_rates(M.CR[r], rng)
            F = draw_factors(M.F[r], rng)
            p = rng.uniform(min(2 / N, 0.2), 0.2, size=N)  # each individual has its own greediness
            best = np.maximum((p * N + 0.5).astype(int), 2)
            pbest = np.argsort(f, kind="stable")[rng.integers(best)]
            v = midpoint(current_to_pbest(x, pbest, F, A.members, rng), x, problem)
            u = binomial(x, v, CR, rng)
            fu = problem.evaluate(u)

            won = fu < f
            A.add(x[won], rng)
            if won.any():
                w = shares(f[won] - fu[won])
                M.overwrite(F=lehmer(F[won], w), CR=float(w @ CR[won]))
            as_good = fu <= f
            x[as_good], f[as_good] = u[as_good], fu[as_good]
