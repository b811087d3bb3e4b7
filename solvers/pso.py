"""Particle swarm optimization with constriction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from nfbench import Ge, Gt, Le, MeteredProblem, Solver, SolverInfo, Tune

__all__ = ["PSO"]


@dataclass(frozen=True)
class PSO(Solver):
    """The standard of Bratton & Kennedy 2007: v ← χ·(v + c₁·ε₁·(p_i − x) + c₂·ε₂·(p_g − x)), x ← x + v, synchronous.

    swarm: particles.
    topology: p_g is the best of all ("global") or of a particle and its two neighbours on a ring ("ring"), which
        converges more slowly and is fooled less.
    chi: χ, the constriction factor of Clerc & Kennedy 2002 for c₁ + c₂ = 4.1.
    c1: pull of the particle's own best point p_i.
    c2: pull of p_g.

    A particle outside the box flies on and is not evaluated until it returns. Particles start uniform in the box, with
    half the way to another uniform point as velocity, which the standard leaves open.
    """

    swarm: Annotated[int, Ge(2), Tune(10, 200, log=True)] = 50
    topology: Literal["global", "ring"] = "global"
    chi: Annotated[float, Gt(0.0), Le(1.0), Tune(0.4, 1.0)] = 0.72984
    c1: Annotated[float, Ge(0.0), Tune(0.0, 4.0)] = 2.05
    c2: Annotated[float, Ge(0.0), Tune(0.0, 4.0)] = 2.05

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        accepts_start=True,
        reference="Clerc & Kennedy 2002, doi:10.1109/4235.985692; Bratton & Kennedy 2007, doi:10.1109/SIS.2007.368035",
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        shape = self.swarm, problem.dimension
        x, f = problem.first_population(self.swarm, rng)
        v = 0.5 * (problem.from_unit(rng.random(shape)) - x)
        p = x.copy()
        problem.keep_population(p, f)
        while True:
            if self.topology == "global":
                g = np.full(self.swarm, f.argmin())
            else:
                around = (np.arange(self.swarm)[:, None] + [0, -1, 1]) % self.swarm
                g = around[np.arange(self.swarm), f[around].argmin(axis=1)]
            e1, e2 = rng.random(shape), rng.random(shape)
            v = self.chi * (v + self.c1 * e1 * (p - x) + self.c2 * e2 * (p[g] - x))
            x = x + v
            inside = np.flatnonzero(((problem.lower <= x) & (x <= problem.upper)).all(axis=1))
            values = problem.evaluate(x[inside])
            better = values < f[inside]
            p[inside[better]], f[inside[better]] = x[inside[better]], values[better]
