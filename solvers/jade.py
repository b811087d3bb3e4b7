"""JADE: adaptive differential evolution with optional external archive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo, Tune

from ._adaptive import Archive, best_count, draw_crossover_rates, draw_factors, lehmer, trial_vectors

__all__ = ["JADE"]


@dataclass(frozen=True)
class JADE(Solver):
    """DE/current-to-pbest/1/bin whose F and CR adapt to the values that succeeded; equation numbers are the paper's.

    population: NP; None: the paper's 30 for n ≤ 10, 100 for n ≤ 30 and 400 above.
    p: the greediness: x_pbest is one of the 100p % best individuals, of which there are at least two.
    c: the rate of adaptation; 1/c is the life span of a successful parameter in generations.
    archive: keep up to NP parents that were replaced and use them in differences.
    """

    population: Annotated[int, Ge(4), Tune(10, 200, log=True)] | None = None
    p: Annotated[float, Gt(0.0), Le(1.0), Tune(0.02, 0.5, log=True)] = 0.05
    c: Annotated[float, Ge(0.0), Le(1.0), Tune(0.01, 0.5, log=True)] = 0.1
    archive: bool = True

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, accepts_start=True, reference="Zhang & Sanderson 2009, doi:10.1109/TEVC.2009.2014613"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        NP = self.population or (30 if n <= 10 else 100 if n <= 30 else 400)
        mu_CR = mu_F = 0.5
        A = Archive(NP if self.archive else 0, n)
        x, f = problem.first_population(NP, rng)
        problem.keep_population(x, f)
        best = best_count(self.p, NP)
        while True:
            CR = draw_crossover_rates(np.full(NP, mu_CR), rng)  # (8)
            F = draw_factors(np.full(NP, mu_F), rng)  # (10)
            pbest = np.argsort(f, kind="stable")[rng.integers(best, size=NP)]
            u = trial_vectors(x, pbest, F, CR, A.members, problem, rng)  # (6), with the archive (7)
            fu = problem.evaluate(u)
            better = fu < f
            A.add_all(x[better], rng)
            x[better], f[better] = u[better], fu[better]
            if better.any():
                S_F, S_CR = F[better], CR[better]
                mu_CR = (1 - self.c) * mu_CR + self.c * S_CR.mean()  # (9)
                mu_F = (1 - self.c) * mu_F + self.c * lehmer(S_F, np.ones(len(S_F)))  # (11), (12)
