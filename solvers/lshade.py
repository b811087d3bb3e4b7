"""L-SHADE: SHADE with linear population size reduction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo, Tune

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

__all__ = ["LSHADE"]

N_MIN = 4  # what current-to-pbest/1 needs


@dataclass(frozen=True)
class LSHADE(Solver):
    """SHADE whose population shrinks linearly over the evaluations it has; the paper's settings are the defaults.

    population: N_init, individuals at the start; None: 18·n.
    archive_rate: r_arc, the archive's size over the population's.
    p: the share of the population that counts as best; at least two individuals do.
    memory: H, the means remembered.
    terminal: what becomes of a mean of CR that is the terminal value ⊥, CR = 0: "kept" for ever, as the paper says, or
        "overwritten" in its turn, as the authors' program in C++ does.
    evaluations: MAX_NFE, those over which the population shrinks to 4, where it stays; None: the budget's. Where the
        budget has no limit in evaluations either, the problem is declined.
    """

    population: Annotated[int, Ge(4), Tune(10, 400, log=True)] | None = None
    archive_rate: Annotated[float, Ge(0.0), Tune(0.0, 4.0)] = 2.6
    p: Annotated[float, Gt(0.0), Le(1.0), Tune(0.02, 0.5, log=True)] = 0.11
    memory: Annotated[int, Ge(1), Tune(2, 50, log=True)] = 6
    terminal: Literal["kept", "overwritten"] = "kept"
    evaluations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, reference="Tanabe & Fukunaga 2014, doi:10.1109/CEC.2014.6900380"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        n = problem.dimension
        max_nfe = maximum_evaluations(problem, self.evaluations)
        N_init = N = self.population or 18 * n
        M = Memory(self.memory, F=0.5, CR=0.5)
        A = Archive(round(self.archive_rate * N), n)
        x = problem.from_unit(rng.random((N, n)))
        f = problem.evaluate(x)
        while True:
            problem.keep_population(x, f)
            r = rng.integers(self.memory, size=N)
            CR = draw_crossover_rates(M.CR[r], rng)
            F = draw_factors(M.F[r], rng)
            best = best_count(self.p, N)
            pbest = np.argsort(f, kind="stable")[rng.integers(best, size=N)]
            v = midpoint(current_to_pbest(x, pbest, F, A.members, rng), x, problem)
            u = binomial(x, v, CR, rng)
            fu = problem.evaluate(u)

            won = fu < f
            A.add(x[won], rng)
            if won.any():
                w = shares(f[won] - fu[won])
                locked = self.terminal == "kept" and np.isnan(M.CR[M.k])
                terminal = locked or CR[won].max() == 0.0
                M.overwrite(F=lehmer(F[won], w), CR=np.nan if terminal else lehmer(CR[won], w))
            as_good = fu <= f
            x[as_good], f[as_good] = u[as_good], fu[as_good]

            N = planned_size(N_init, N_MIN, spent(problem, max_nfe))
            kept = np.sort(np.argsort(f, kind="stable")[:N])  # the worst go
            x, f = x[kept], f[kept]
            A.resize(round(self.archive_rate * N), rng)
