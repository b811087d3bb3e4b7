"""L-SHADE: SHADE with linear population size reduction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo, Tune

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

__all__ = ["LSHADE"]


@dataclass(frozen=True)
class LSHADE(Solver):
    """SHADE with a population that shrinks linearly over its evaluations; the paper's settings are the defaults.

    population: N_init, the number of individuals at the start; None: 18·n.
    archive_rate: r_arc, the size of the archive divided by that of the population.
    p: the greediness: x_pbest is one of the 100p % best individuals, of which there are at least two.
    memory: H, the number of means in the memory.
    terminal: how a mean of CR is treated that has become the terminal value ⊥, which stands for CR = 0: "kept" for
        ever, as in the paper, or "overwritten" in its turn, as in the authors' C++ program.
    evaluations: MAX_NFE, the evaluations over which the population shrinks to 4, where it stays; None: those of the
        budget. The problem is declined if the budget does not limit evaluations either.
    """

    population: Annotated[int, Ge(4), Tune(10, 400, log=True)] | None = None
    archive_rate: Annotated[float, Ge(0.0), Tune(0.0, 4.0)] = 2.6
    p: Annotated[float, Gt(0.0), Le(1.0), Tune(0.02, 0.5, log=True)] = 0.11
    memory: Annotated[int, Ge(1), Tune(2, 50, log=True)] = 6
    terminal: Literal["kept", "overwritten"] = "kept"
    evaluations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        needs_evaluations=True,
        accepts_start=True,
        reference="Tanabe & Fukunaga 2014, doi:10.1109/CEC.2014.6900380",
    )

    def validate(self) -> None:
        if self.evaluations is not None:
            object.__setattr__(self, "info", replace(type(self).info, needs_evaluations=False))

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        max_nfe = maximum_evaluations(problem, self.evaluations)
        N_init = self.population or 18 * problem.dimension
        M = Memory(self.memory, F=0.5, CR=0.5)
        P = Population(N_init, self.archive_rate, problem, rng)
        while True:
            N = len(P)
            r = rng.integers(self.memory, size=N)
            CR = draw_crossover_rates(M.CR[r], rng)  # randn(M_CR,r, 0.1)
            F = draw_factors(M.F[r], rng)  # randc(M_F,r, 0.1)
            pbest = P.ranking()[rng.integers(best_count(self.p, N), size=N)]
            S_F, S_CR, gain = P.evolve(pbest, F, CR)
            if len(gain):
                mean_F, mean_CR = lehmer_means(S_F, S_CR, gain)
                locked = self.terminal == "kept" and np.isnan(M.CR[M.k])
                M.overwrite(F=mean_F, CR=np.nan if locked else mean_CR)
            P.shrink(planned_size(N_init, N_MIN, spent(problem, max_nfe)))
