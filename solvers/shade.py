"""SHADE: success-history based adaptive differential evolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Ge, MeteredProblem, Solver, SolverInfo, Tune

from ._adaptive import Memory, Population, draw_crossover_rates, draw_factors, lehmer, shares

__all__ = ["SHADE"]


@dataclass(frozen=True)
class SHADE(Solver):
    """JADE with a memory of means of F and CR; each is over the successes of one generation, weighted by their gains.

    population: N, the number of individuals, and also the size of the archive.
    memory: H, the number of means in the memory.
    """

    population: Annotated[int, Ge(4), Tune(10, 200, log=True)] = 100
    memory: Annotated[int, Ge(1), Tune(2, 200, log=True)] = 100

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, accepts_start=True, reference="Tanabe & Fukunaga 2013, doi:10.1109/CEC.2013.6557555"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N = self.population
        M = Memory(self.memory, F=0.5, CR=0.5)
        P = Population(N, 1.0, problem, rng)
        while True:
            r = rng.integers(self.memory, size=N)
            CR = draw_crossover_rates(M.CR[r], rng)  # randn(M_CR,r, 0.1)
            F = draw_factors(M.F[r], rng)  # randc(M_F,r, 0.1)
            p = rng.uniform(min(2 / N, 0.2), 0.2, size=N)  # p_i = rand[2/N, 0.2]
            best = np.maximum((p * N + 0.5).astype(int), 2)
            pbest = P.ranking()[rng.integers(best)]
            S_F, S_CR, gain = P.evolve(pbest, F, CR)
            if len(gain):
                w = shares(gain)
                M.overwrite(F=lehmer(S_F, w), CR=float(w @ S_CR))  # mean_WL(S_F), mean_WA(S_CR)
