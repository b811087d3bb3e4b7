"""Differential evolution: DE/rand/1/bin and its classic relatives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from numba import types
from numpy import ndarray

from nfbench import Ge, Le, MeteredProblem, Solver, SolverInfo, Tune, compiled, load_kernels

__all__ = ["DE"]

BLOCK = 16  # generations whose random numbers are drawn together: small enough to stay in the cache
RULES = ("clip", "midpoint", "reflect", "resample")

BEST, SELF = -2, -1  # the last two columns of the parents
MUTATIONS = {  # base and differences: r_1, r_2, … (0, 1, …), the best and the target vector
    "rand/1": (0, 1, 2),
    "best/1": (BEST, 0, 1),
    "rand/2": (0, 1, 2, 3, 4),
    "best/2": (BEST, 0, 1, 2, 3),
    "current-to-best/1": (SELF, BEST, SELF, 0, 1),
    "rand-to-best/1": (0, BEST, 0, 1, 2),
}

Population: TypeAlias = Float[ndarray, "N n"]
Values: TypeAlias = Float[ndarray, " N"]
Bound: TypeAlias = Float[ndarray, " n"]
Draws: TypeAlias = Float[ndarray, "N draws"]
Parents: TypeAlias = Int[ndarray, "N R+2"]
Terms: TypeAlias = Int[ndarray, " 1+2d"]


@dataclass(frozen=True)
class DE(Solver):
    """Differential evolution with synchronous generations; the default is DE/rand/1/bin.

    population: N_p, the number of individuals. Each generation spends N_p evaluations.
    strategy: mutation/number of differences/crossover. The mutant v of the target vector x_i is one of
        rand/1: x_r1 + F(x_r2 − x_r3); rand/2: x_r1 + F(x_r2 − x_r3) + F(x_r4 − x_r5);
        best/1: x_b + F(x_r1 − x_r2); best/2: x_b + F(x_r1 − x_r2) + F(x_r3 − x_r4);
        current-to-best/1: x_i + F(x_b − x_i) + F(x_r1 − x_r2);
        rand-to-best/1: x_r1 + F(x_b − x_r1) + F(x_r2 − x_r3), as in Price, Storn & Lampinen 2005; other authors use
        this name for current-to-best/1.
        Here r_1, r_2, … are distinct and differ from i, and x_b is the best individual, which may be x_i or one of the
        x_r. The trial vector always takes coordinate j_rand from v. With "bin" it also takes every coordinate whose
        rand_j ≤ C_r; with "exp" it takes the coordinates that follow j_rand cyclically, as long as rand_j ≤ C_r. It
        takes the other coordinates from x_i.
    F: scaling factor of the difference vector, in [0, 2].
    CR: C_r, crossover probability, in [0, 1].
    bounds: how a coordinate of the mutant outside the box is repaired; the paper does not say. "clip": set to the bound
        that it passed; "midpoint": set halfway between that bound and the target vector's coordinate; "reflect":
        mirrored at the bounds as often as needed; "resample": redrawn uniformly in the box.
    generations: G, including the initial population, so that a run takes G·N_p evaluations; None: until the budget
        ends.

    The initial population is uniform in the box. Every choice of distinct r_1, r_2, … other than i, which is Storn and
    Price's condition, is equally likely.

    The order of the random numbers is documented so that another implementation can use the same ones. The initial
    population takes ``random((N, n))``. Each block of 16 generations then takes ``random((16, N, R + 1 + n))``, or
    ``random((16, N, R + 1 + 2n))`` with "resample", where R is the number of r in the strategy, 3 by default. The
    numbers of one individual are: one for each of r_1, …, r_R; one for j_rand, which is ⌊number · n⌋; n for rand_j; and
    n for resampled coordinates. The r are dealt like cards: from the list i+1, i+2, …, i+N-1 (mod N), each r in turn
    removes the card at position ⌊number · cards left⌋, counted from 0.
    """

    population: Annotated[int, Ge(4), Tune(10, 200, log=True)] = 50
    strategy: Literal[
        "rand/1/bin",
        "rand/1/exp",
        "best/1/bin",
        "best/1/exp",
        "rand/2/bin",
        "rand/2/exp",
        "best/2/bin",
        "best/2/exp",
        "current-to-best/1/bin",
        "current-to-best/1/exp",
        "rand-to-best/1/bin",
        "rand-to-best/1/exp",
    ] = "rand/1/bin"
    F: Annotated[float, Ge(0.0), Le(2.0), Tune(0.2, 1.0)] = 0.5
    CR: Annotated[float, Ge(0.0), Le(1.0)] = 0.8
    bounds: Literal["clip", "midpoint", "reflect", "resample"] = "clip"
    generations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True, accepts_start=True, reference="Storn & Price 1997, doi:10.1023/A:1008202821328"
    )

    def validate(self) -> None:
        least = self._terms().max() + 2
        if self.population < least:
            raise ValueError(f"population: expected at least {least} for {self.strategy}, got {self.population}")

    def warm_up(self) -> None:
        _warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N, n, F, CR = self.population, problem.dimension, self.F, self.CR
        lower, upper, rule = problem.lower, problem.upper, RULES.index(self.bounds)
        terms = self._terms()
        R = int(terms.max()) + 1  # how many r the strategy has
        crossover = exponential if self.strategy.endswith("exp") else binomial
        parents = np.empty((N, R + 2), np.int64)
        x, f = problem.first_population(N, rng)
        v, u = np.empty_like(x), np.empty_like(x)
        best = int(f.argmin())
        problem.keep_population(x, f)
        more = None if self.generations is None else self.generations - 1
        for draws in islice(self._draws(rng, R, n), more):
            choose(draws, best, parents)  # r_1 ≠ r_2 ≠ r_3 ≠ i
            mutate(x, parents, terms, F, v)  # v_i = x_r1 + F·(x_r2 − x_r3)  (1)
            crossover(x, v, CR, draws, R, u)  # u_ij = v_ij if rand_j ≤ C_r or j = j_rand, else x_ij  (2)
            repair(u, x, lower, upper, rule, draws)
            best = select(x, f, u, problem.evaluate(u))  # (3)

    def _terms(self) -> Terms:
        """The columns of the parents that the mutation uses: the base, then two for each difference."""
        return np.array(MUTATIONS[self.strategy.rpartition("/")[0]])

    def _draws(self, rng: np.random.Generator, R: int, n: int) -> Iterator[Draws]:
        """The random numbers of each generation."""
        draws = np.empty((BLOCK, self.population, R + 1 + (2 * n if self.bounds == "resample" else n)))
        while True:
            yield from rng.random(out=draws)


@compiled()
def choose(draws: Draws, best: int, parents: Parents) -> None:
    """Choose r_1, …, r_R, distinct and other than i, for each individual i; add ``best`` and i as the last columns."""
    N, R = len(parents), parents.shape[1] - 2
    for i in range(N):
        # steps k from i, each moved past those taken before in ascending order; N stands for none
        k1 = 1 + int(draws[i, 0] * (N - 1))
        k2 = 1 + int(draws[i, 1] * (N - 2))
        k2 += k2 >= k1
        parents[i, 0], parents[i, 1] = after(i, k1, N), after(i, k2, N)
        s1, s2, s3, s4 = min(k1, k2), max(k1, k2), N, N
        for c in range(2, R):
            k = 1 + int(draws[i, c] * (N - 1 - c))
            k += k >= s1
            k += k >= s2
            k += k >= s3
            k += k >= s4
            parents[i, c] = after(i, k, N)
            s1, k = min(s1, k), max(s1, k)
            s2, k = min(s2, k), max(s2, k)
            s3, s4 = min(s3, k), max(s3, k)
        parents[i, R], parents[i, R + 1] = best, i


@compiled()
def after(i: int, k: int, N: int) -> int:
    """The individual k steps after i, cyclically."""
    return i + k - N * (i + k >= N)


@compiled()
def mutate(x: Population, parents: Parents, terms: Terms, F: float, v: Population) -> None:
    """The mutants ``v``: the base plus F times each difference."""
    N, n = x.shape
    for i in range(N):
        base, plus, minus = parents[i, terms[0]], parents[i, terms[1]], parents[i, terms[2]]
        for j in range(n):
            v[i, j] = x[base, j] + F * (x[plus, j] - x[minus, j])
        if len(terms) == 5:
            plus, minus = parents[i, terms[3]], parents[i, terms[4]]
            for j in range(n):
                v[i, j] += F * (x[plus, j] - x[minus, j])


@compiled()
def binomial(x: Population, v: Population, CR: float, draws: Draws, R: int, u: Population) -> None:
    """The trial vectors ``u``: u_ij = v_ij if rand_j ≤ C_r or j = j_rand, else x_ij."""
    N, n = x.shape
    for i in range(N):
        j_rand = int(draws[i, R] * n)
        for j in range(n):
            u[i, j] = v[i, j] if (draws[i, R + 1 + j] <= CR) | (j == j_rand) else x[i, j]


@compiled()
def exponential(x: Population, v: Population, CR: float, draws: Draws, R: int, u: Population) -> None:
    """The trial vectors ``u``: u_ij = v_ij for L successive j from j_rand on, cyclically, else x_ij."""
    N, n = x.shape
    for i in range(N):
        j, crossed = int(draws[i, R] * n), True  # j_rand is always crossed
        for _ in range(n):
            u[i, j] = v[i, j] if crossed else x[i, j]
            j = after(j, 1, n)
            crossed &= draws[i, R + 1 + j] <= CR


@compiled()
def repair(u: Population, x: Population, lower: Bound, upper: Bound, rule: int, draws: Draws) -> None:
    """Bring coordinates outside the box back into it by one of RULES."""
    N, n = u.shape
    for i in range(N):
        for j in range(n):
            if not lower[j] <= u[i, j] <= upper[j]:
                u[i, j] = bring_back(u[i, j], x[i, j], lower[j], upper[j], rule, draws[i, -n + j])


@compiled()
def bring_back(v: float, target: float, lower: float, upper: float, rule: int, draw: float) -> float:
    """One coordinate outside the box, brought back by one of RULES."""
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
def select(x: Population, f: Values, u: Population, fu: Values) -> int:
    """A trial vector that is no worse replaces its target. Return the index of the best, the first among equals."""
    best = 0
    for i in range(len(f)):
        if fu[i] <= f[i]:
            f[i] = fu[i]
            for j in range(x.shape[1]):
                x[i, j] = u[i, j]
        if f[i] < f[best]:
            best = i
    return best


_VECTOR, _MATRIX, _INDEX = types.float64[::1], types.float64[:, ::1], types.int64
_PARENTS, _TERMS = types.int64[:, ::1], types.int64[::1]
_BOUND = types.Array(types.float64, 1, "C", readonly=True)


@cache
def _warm_up() -> None:
    crossover = _MATRIX, _MATRIX, types.float64, _MATRIX, _INDEX, _MATRIX
    signatures = [
        (select, (_MATRIX, _VECTOR, _MATRIX, _VECTOR)),
        (choose, (_MATRIX, _INDEX, _PARENTS)),
        (mutate, (_MATRIX, _PARENTS, _TERMS, types.float64, _MATRIX)),
        (binomial, crossover),
        (exponential, crossover),
        (repair, (_MATRIX, _MATRIX, _BOUND, _BOUND, _INDEX, _MATRIX)),
    ]
    load_kernels(signatures, "compiling differential evolution (once per machine, about 3 s)")
