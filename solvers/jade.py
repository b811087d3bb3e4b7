"""JADE: adaptive differential evolution with optional external archive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo, Tune

from ._adaptive import (
    Archive,
    best_count,
    binomial,
    current_to_pbest,
    draw_crossover_rates,
    draw_factors,
    lehmer,
    midpoint,
)

__all__ = ["JADE"]


@dataclass(frozen=True)
class JADE(Solver):
    """DE/current-to-pbest/1/bin whose F and CR adapt to what succeeded; "eq." are the paper's.

    population: NP; None: the paper's 30 for n ≤ 10, 100 for n ≤ 30, 400 beyond.
    p: the greediness, the share of the population that counts as best; at least two do.
    c: the rate of adaptation; 1/c is the life span of a successful parameter in generations.
    archive: keep up to NP parents that were replaced, to draw differences from.
    """

    population: Annotated[int, Ge(4), Tune(10, 200, log=True)] | None = None
    p: Annotated[float, Gt(0.0), Le(1.0), Tune(0.02, 0.5, log=True)] = 0.05
    c: Annotated[float, Ge(0.0), Le(1.0), Tune(0.01, 0.5, log=True)] = 0.1
    archive: bool = True

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, reference="Zhang & Sanderson 2009, doi:10.1109/TEVC.2009.2014613"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        NP = self.population or (30 if n <= 10 else 100 if n <= 30 else 400)
        mu_CR = mu_F = 0.5
        A = Archive(NP if self.archive else 0, n)
        x = problem.from_unit(rng.random((NP, n)))
        f = problem.evaluate(x)
        best = best_count(self.p, NP)
        problem.keep_population(x, f)
        while True:
            CR = draw_crossover_rates(np.full(NP, mu_CR), rng)
            F = draw_factors(np.full(NP, mu_F), rng)
            pbest = np.argsort(f, kind="stable")[rng.integers(best, size=NP)]
            v = midpoint(current_to_pbest(x, pbest, F, A.members, rng), x, problem)  # eq. 6 and 7
            u = binomial(x, v, CR, rng)
            fu = problem.evaluate(u)

            won = fu < f
            A.add_all(x[won], rng)
            x[won], f[won] = u[won], fu[won]
            if won.any():
                mu_CR = (1 - self.c) * mu_CR + self.c * CR[won].mean()  # eq. 9
                mu_F = (1 - self.c) * mu_F + self.c * lehmer(F[won], np.ones(won.sum()))  # eq. 11 and 12
