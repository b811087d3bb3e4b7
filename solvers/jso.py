"""jSO: L-SHADE with rates that depend on how far the search has come."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo

from ._adaptive import (
    Archive,
    Memory,
    best_count,
    binomial,
    current_to_pbest,
    draw_crossover_rates,
    draw_factors,
    lehmer,
    maximum_evaluations,
    midpoint,
    planned_size,
    shares,
    spent,
)

__all__ = ["JSO"]

N_MIN = 4  # what current-to-pbest/1 needs


@dataclass(frozen=True)
class JSO(Solver):
    """iL-SHADE with a weighted mutation, DE/current-to-pbest-w/1/bin; the paper's settings are the defaults.

    population: N_init, individuals at the start and also the size of the archive; None: 25·ln n·√n (n = 1: as n = 2).
    p: p_max, the share of the population that counts as best at the start, half as much at the end; at least two do.
    memory: H, the means remembered; the last place always holds F = CR = 0.9.
    evaluations: MAX_NFE, those over which rates change and the population shrinks to 4; None: the budget's. Where the
        budget has no limit in evaluations either, the problem is declined.
    """

    population: Annotated[int, Ge(4)] | None = None
    p: Annotated[float, Gt(0.0), Le(1.0)] = 0.25
    memory: Annotated[int, Ge(2)] = 5
    evaluations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, reference="Brest, Maučec & Bošković 2017, doi:10.1109/CEC.2017.7969456"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        max_nfe = maximum_evaluations(problem, self.evaluations)
        N_init = N = self.population or round(25 * math.log(max(n, 2)) * math.sqrt(max(n, 2)))
        M = Memory(self.memory, F=0.3, CR=0.8)
        A = Archive(N, n)
        x = problem.from_unit(rng.random((N, n)))
        f = problem.evaluate(x)
        while True:
            problem.keep_population(x, f)
            t = spent(problem, max_nfe)
            r = rng.integers(self.memory, size=N)
            last = r == self.memory - 1
            CR = draw_crossover_rates(np.where(last, 0.9, M.CR[r]), rng)
            CR = np.maximum(CR, 0.7 if t < 0.25 else 0.6 if t < 0.5 else 0.0)
            F = draw_factors(np.where(last, 0.9, M.F[r]), rng)
            F = np.minimum(F, 0.7 if t < 0.6 else 1.0)
            best = best_count(self.p * (1 - 0.5 * t), N)
            pbest = _choose(np.argsort(f, kind="stable")[:best], N, t < 0.5, rng)
            weight = 0.7 if t < 0.2 else 0.8 if t < 0.4 else 1.2  # F_w = weight·F
            v = midpoint(current_to_pbest(x, pbest, F, A.members, rng, weight), x, problem)
            u = binomial(x, v, CR, rng)
            fu = problem.evaluate(u)

            won = fu < f
            A.add(x[won], rng)
            if won.any():
                w = shares(f[won] - fu[won])
                terminal = np.isnan(M.CR[M.k]) or CR[won].max() == 0.0  # once ⊥, for ever ⊥
                new_CR = np.nan if terminal else (lehmer(CR[won], w) + M.CR[M.k]) / 2
                M.overwrite(F=(lehmer(F[won], w) + M.F[M.k]) / 2, CR=new_CR)
            as_good = fu <= f
            x[as_good], f[as_good] = u[as_good], fu[as_good]

            N = planned_size(N_init, N_MIN, spent(problem, max_nfe))
            kept = np.sort(np.argsort(f, kind="stable")[:N])  # the worst go
            x, f = x[kept], f[kept]
            A.resize(N, rng)


def _choose(best: Int[ndarray, " b"], N: int, others: bool, rng: np.random.Generator) -> Int[ndarray, " N"]:
    """One of the best for each individual; with ``others``, another than itself."""
    pbest = best[rng.integers(len(best), size=N)]
    while others and (same := np.flatnonzero(pbest == np.arange(N))).size:
        pbest[same] = best[rng.integers(len(best), size=len(same))]
    return pbest
