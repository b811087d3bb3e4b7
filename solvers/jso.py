"""jSO: L-SHADE with rates that depend on the share of the evaluations spent."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo

from ._adaptive import (
    N_MIN,
    Memory,
    Population,
    best_count,
    draw_crossover_rates,
    draw_factors,
    lehmer_means,
    maximum_evaluations,
    planned_size,
    spent,
)

__all__ = ["JSO"]


@dataclass(frozen=True)
class JSO(Solver):
    """iL-SHADE with a weighted mutation, DE/current-to-pbest-w/1/bin; the paper's settings are the defaults.

    population: N_init, the number of individuals at the start; the archive is always as large as the population. None:
        25·ln n·√n, and for n = 1 the same as for n = 2.
    p: p_max, the greediness at the start: x_pbest is one of the 100p % best individuals, of which there are at least
        two. It falls linearly to p_max/2 at the end.
    memory: H, the number of means in the memory; the last place always holds F = CR = 0.9.
    evaluations: MAX_NFE, the evaluations over which the rates change and the population shrinks to 4; None: those of
        the budget. The problem is declined if the budget does not limit evaluations either.
    """

    population: Annotated[int, Ge(4)] | None = None
    p: Annotated[float, Gt(0.0), Le(1.0)] = 0.25
    memory: Annotated[int, Ge(2)] = 5
    evaluations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        needs_evaluations=True,
        accepts_start=True,
        reference="Brest, Maučec & Bošković 2017, doi:10.1109/CEC.2017.7969456",
    )

    def validate(self) -> None:
        if self.evaluations is not None:
            object.__setattr__(self, "info", replace(type(self).info, needs_evaluations=False))

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        max_nfe, n = maximum_evaluations(problem, self.evaluations), max(problem.dimension, 2)
        N_init = self.population or round(25 * math.log(n) * math.sqrt(n))
        M = Memory(self.memory, F=0.3, CR=0.8)
        P = Population(N_init, 1.0, problem, rng)
        while True:
            N, t = len(P), spent(problem, max_nfe)
            r = rng.integers(self.memory, size=N)
            last = r == self.memory - 1  # M_F = M_CR = 0.9
            CR = draw_crossover_rates(np.where(last, 0.9, M.CR[r]), rng)
            CR = np.maximum(CR, 0.7 if t < 0.25 else 0.6 if t < 0.5 else 0.0)
            F = draw_factors(np.where(last, 0.9, M.F[r]), rng)
            F = np.minimum(F, 0.7 if t < 0.6 else 1.0)
            best = P.ranking()[: best_count(self.p * (1 - 0.5 * t), N)]  # p = p_max − (p_max − p_min)·t
            pbest = _choose(best, N, t < 0.5, rng)
            weight = 0.7 if t < 0.2 else 0.8 if t < 0.4 else 1.2  # F_w = weight·F
            S_F, S_CR, gain = P.evolve(pbest, F, CR, weight)
            if len(gain):
                mean_F, mean_CR = lehmer_means(S_F, S_CR, gain)
                M.overwrite(F=(mean_F + M.F[M.k]) / 2, CR=(mean_CR + M.CR[M.k]) / 2)  # ⊥, here NaN, stays ⊥
            P.shrink(planned_size(N_init, N_MIN, spent(problem, max_nfe)))


def _choose(best: Int[ndarray, " b"], N: int, others: bool, rng: np.random.Generator) -> Int[ndarray, " N"]:
    """One of the best for each individual; with ``others``, never the individual itself."""
    pbest = best[rng.integers(len(best), size=N)]
    while others and (same := np.flatnonzero(pbest == np.arange(N))).size:
        pbest[same] = best[rng.integers(len(best), size=len(same))]
    return pbest
