"""Differential evolution, DE/rand/1/bin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numba import types
from numpy import ndarray

from nfbench import Ge, Le, MeteredProblem, Solver, SolverInfo
from nfbench.compiled import compiled, load

__all__ = ["DE"]

BLOCK = 16  # generations whose random numbers are drawn together: small enough to stay in the cache
RULES = ("clip", "midpoint", "reflect", "resample")

Draws: TypeAlias = Float[ndarray, "N draws"]


@dataclass(frozen=True)
class DE(Solver):
    """Differential evolution DE/rand/1/bin with synchronous generations.

    population: N_p, individuals; each generation spends as many evaluations.
    F: scaling factor of the difference vector, in [0, 2].
    CR: C_r, crossover probability, in [0, 1].
    bounds: what becomes of a mutant's coordinate outside the box, on which the original is silent. "clip": the bound it
        passed; "midpoint": halfway between that bound and the target vector's coordinate; "reflect": mirrored at the
        bound, as often as needed; "resample": uniform in the box.
    generations: G, the initial population being the first, so G·N_p evaluations in all; None: until the budget ends.

    The initial population is uniform in the box. r_1, r_2, r_3 are distinct and also differ from i (Storn and Price's
    condition), each such triple equally likely.

    Draw order, from which another implementation can be fed the same numbers: ``random((N, n))`` for the population,
    then for every block of 16 generations ``random((16, N, 4 + n))``, with "resample" ``random((16, N, 4 + 2n))``: for
    each individual one number each for r_1, r_2, r_3 and j_rand, n for rand_j, and n for resampled coordinates. The
    first three deal individual i cards: from the list i+1, i+2, …, i+N-1 (mod N), and what is left of it, each takes
    the card at ⌊number · cards left⌋, counted from 0.
    """

    population: Annotated[int, Ge(4)] = 50
    F: Annotated[float, Ge(0.0), Le(2.0)] = 0.5
    CR: Annotated[float, Ge(0.0), Le(1.0)] = 0.8
    bounds: Literal["clip", "midpoint", "reflect", "resample"] = "clip"
    generations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(batched=True, reference="Storn & Price 1997, doi:10.1023/A:1008202821328")

    def warm_up(self) -> None:
        _warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N, n = self.population, problem.dimension
        rule = RULES.index(self.bounds)
        x = problem.from_unit(rng.random((N, n)))
        f = problem.evaluate(x)
        u = np.empty_like(x)
        more = None if self.generations is None else self.generations - 1
        for draws in islice(self._draws(rng, N, n), more):
            make_trials(x, self.F, self.CR, rule, problem.lower, problem.upper, draws, u)
            fu = problem.evaluate(u)
            select(x, f, u, fu)

    def _draws(self, rng: np.random.Generator, N: int, n: int) -> Iterator[Draws]:
        """The random numbers of each generation."""
        draws = np.empty((BLOCK, N, 4 + 2 * n if self.bounds == "resample" else 4 + n))
        while True:
            yield from rng.random(out=draws)


@compiled()
def make_trials(
    x: Float[ndarray, "N n"],
    F: float,
    CR: float,
    rule: int,
    lower: Float[ndarray, " n"],
    upper: Float[ndarray, " n"],
    draws: Draws,
    u: Float[ndarray, "N n"],
) -> None:
    """The trial vectors ``u``, one for each target vector."""
    N, n = x.shape
    for i in range(N):
        r1, r2, r3 = pick_three(i, N, draws[i])
        j_rand = int(draws[i, 3] * n)
        for j in range(n):
            v = x[r1, j] + F * (x[r2, j] - x[r3, j])  # mutation
            u[i, j] = v if (draws[i, 4 + j] <= CR) | (j == j_rand) else x[i, j]  # crossover
            if not lower[j] <= u[i, j] <= upper[j]:
                u[i, j] = bring_back(v, x[i, j], lower[j], upper[j], rule, draws[i, -n + j])


@compiled()
def pick_three(i: int, N: int, draws: Float[ndarray, " draws"]) -> tuple[int, int, int]:
    """Three distinct individuals other than i, as steps k from it, each moved past the ones taken before."""
    k1, k2, k3 = 1 + int(draws[0] * (N - 1)), 1 + int(draws[1] * (N - 2)), 1 + int(draws[2] * (N - 3))
    k2 += k2 >= k1
    k3 += k3 >= min(k1, k2)
    k3 += k3 >= max(k1, k2)
    r1, r2, r3 = i + k1, i + k2, i + k3
    return r1 - N * (r1 >= N), r2 - N * (r2 >= N), r3 - N * (r3 >= N)


@compiled()
def bring_back(v: float, target: float, lower: float, upper: float, rule: int, draw: float) -> float:
    """A coordinate outside the box, back in it by one of RULES."""
    bound = lower if v < lower else upper
    if rule == 0:
        v = bound
    elif rule == 1:
        v = 0.5 * (target + bound)
    elif rule == 2:  # a mirror at both ends has period 2·width
        t = (v - lower) % (2.0 * (upper - lower))
        v = lower + min(t, 2.0 * (upper - lower) - t)
    else:
        v = lower + draw * (upper - lower)
    return min(max(v, lower), upper)


@compiled()
def select(
    x: Float[ndarray, "N n"], f: Float[ndarray, " N"], u: Float[ndarray, "N n"], fu: Float[ndarray, " N"]
) -> None:
    """A trial vector that is no worse takes its target's place."""
    for i in range(len(f)):
        if fu[i] <= f[i]:
            f[i] = fu[i]
            for j in range(x.shape[1]):
                x[i, j] = u[i, j]


_VECTOR, _MATRIX = types.float64[::1], types.float64[:, ::1]
_BOUND = types.Array(types.float64, 1, "C", readonly=True)


@cache
def _warm_up() -> None:
    signatures = [
        (select, (_MATRIX, _VECTOR, _MATRIX, _VECTOR)),
        (make_trials, (_MATRIX, *(types.float64,) * 2, types.int64, _BOUND, _BOUND, _MATRIX, _MATRIX)),
    ]
    load(signatures, "compiling differential evolution (once a machine, some 3 s)")
