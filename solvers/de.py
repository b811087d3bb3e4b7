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

BEST, SELF = -1, -2
MUTATIONS = {  # base and differences, in r_1, r_2, … (0, 1, …), the best and the target vector
    "rand/1": (0, 1, 2),
    "best/1": (BEST, 0, 1),
    "rand/2": (0, 1, 2, 3, 4),
    "best/2": (BEST, 0, 1, 2, 3),
    "current-to-best/1": (SELF, BEST, SELF, 0, 1),
    "rand-to-best/1": (0, BEST, 0, 1, 2),
}

Draws: TypeAlias = Float[ndarray, "N draws"]


@dataclass(frozen=True)
class DE(Solver):
    """Differential evolution with synchronous generations, by default DE/rand/1/bin.

    population: N_p, individuals; each generation spends as many evaluations.
    strategy: mutation/number of differences/crossover. The mutant v of target vector x_i, with the best x_b,
        which may be x_i or one of the x_r, and distinct r_1, r_2, … other than i:
        rand/1: x_r1 + F(x_r2 − x_r3); rand/2: x_r1 + F(x_r2 − x_r3) + F(x_r4 − x_r5);
        best/1: x_b + F(x_r1 − x_r2); best/2: x_b + F(x_r1 − x_r2) + F(x_r3 − x_r4);
        current-to-best/1: x_i + F(x_b − x_i) + F(x_r1 − x_r2);
        rand-to-best/1: x_r1 + F(x_b − x_r1) + F(x_r2 − x_r3), as of Price, Storn & Lampinen 2005; elsewhere
        current-to-best/1 goes by this name.
        Of v the trial vector takes coordinate j_rand and, with "bin", each other one whose rand_j ≤ C_r; with "exp",
        those that follow j_rand cyclically, up to the first whose rand_j > C_r.
    F: scaling factor of the difference vector, in [0, 2].
    CR: C_r, crossover probability, in [0, 1].
    bounds: what becomes of a mutant's coordinate outside the box, on which the original is silent. "clip": the bound it
        passed; "midpoint": halfway between that bound and the target vector's coordinate; "reflect": mirrored at the
        bound, as often as needed; "resample": uniform in the box.
    generations: G, the initial population being the first, so G·N_p evaluations in all; None: until the budget ends.

    The initial population is uniform in the box. The r are distinct and also differ from i (Storn and Price's
    condition), each such choice equally likely.

    Draw order, from which another implementation can be fed the same numbers: ``random((N, n))`` for the population,
    then for every block of 16 generations ``random((16, N, R + 1 + n))``, or with "resample" ``(16, N, R + 1 + 2n)``, R
    being how many r the strategy has, 3 by default: for each individual one number each for r_1, …, r_R and j_rand, n
    for rand_j, and n for resampled coordinates. The first R deal individual i cards: from the list i+1, i+2, …, i+N-1
    (mod N), and what is left of it, each takes the card at ⌊number · cards left⌋, counted from 0.
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

    info: ClassVar[SolverInfo] = SolverInfo(batched=True, reference="Storn & Price 1997, doi:10.1023/A:1008202821328")

    def validate(self) -> None:
        least = self._vectors().max() + 2
        if self.population < least:
            raise ValueError(f"population: expected at least {least} for {self.strategy}, got {self.population}")

    def warm_up(self) -> None:
        _warm_up()

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N, n = self.population, problem.dimension
        rule, vectors, exponential = RULES.index(self.bounds), self._vectors(), self.strategy.endswith("exp")
        x = problem.from_unit(rng.random((N, n)))
        f = problem.evaluate(x)
        problem.keep_population(x, f)
        best = int(f.argmin())
        u = np.empty_like(x)
        more = None if self.generations is None else self.generations - 1
        for draws in islice(self._draws(rng, vectors.max() + 1, n), more):
            make_trials(x, best, vectors, exponential, self.F, self.CR, rule, problem.lower, problem.upper, draws, u)
            fu = problem.evaluate(u)
            best = select(x, f, u, fu)

    def _vectors(self) -> Int[ndarray, " 2d+1"]:
        """Base and differences of the mutation."""
        return np.array(MUTATIONS[self.strategy.rpartition("/")[0]])

    def _draws(self, rng: np.random.Generator, R: int, n: int) -> Iterator[Draws]:
        """The random numbers of each generation."""
        draws = np.empty((BLOCK, self.population, R + 1 + (2 * n if self.bounds == "resample" else n)))
        while True:
            yield from rng.random(out=draws)


@compiled()
def make_trials(
    x: Float[ndarray, "N n"],
    best: int,
    vectors: Int[ndarray, " 2d+1"],
    exponential: bool,
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
    R = vectors.max() + 1
    r, a = np.empty(5, np.int64), np.zeros(5, np.int64)
    two = len(vectors) == 5
    for i in range(N):
        r[0], r[1], r[2] = pick_three(i, N, draws[i])  # of which two may do
        for c in range(3, R):
            r[c] = pick_next(i, N, draws[i, c], r[:c])
        for d, vector in enumerate(vectors):
            a[d] = r[vector] if vector >= 0 else best if vector == BEST else i
        base, plus, minus, plus2, minus2 = a
        j_rand = int(draws[i, R] * n)
        run = run_length(j_rand, draws[i, R + 1 : R + 1 + n], CR) if exponential else 0
        for j in range(n):
            v = x[base, j] + F * (x[plus, j] - x[minus, j])  # mutation
            if two:
                v += F * (x[plus2, j] - x[minus2, j])
            if exponential:
                crossed = j - j_rand + (n if j < j_rand else 0) < run
            else:
                crossed = (draws[i, R + 1 + j] <= CR) | (j == j_rand)
            u[i, j] = v if crossed else x[i, j]  # crossover
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
def pick_next(i: int, N: int, draw: float, taken: Int[ndarray, " c"]) -> int:
    """An individual other than i and those taken."""
    c = len(taken)
    k, passed = 1 + int(draw * (N - 1 - c)), 0
    for _ in range(c):
        least = N  # the least step taken that is not passed yet
        for r in taken:
            step = r - i + N * (r < i)
            if passed < step < least:
                least = step
        k += k >= least
        passed = least
    return i + k - N * (i + k >= N)


@compiled()
def run_length(j_rand: int, rand: Float[ndarray, " n"], CR: float) -> int:
    """How many coordinates exponential crossover takes, j_rand being the first."""
    n = len(rand)
    length = 1
    while length < n and rand[(j_rand + length) % n] <= CR:
        length += 1
    return length


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
) -> int:
    """A trial vector that is no worse takes its target's place. Returns the best individual, of equals the first."""
    best = 0
    for i in range(len(f)):
        if fu[i] <= f[i]:
            f[i] = fu[i]
            for j in range(x.shape[1]):
                x[i, j] = u[i, j]
        if f[i] < f[best]:
            best = i
    return best


_VECTOR, _MATRIX, _INDICES = types.float64[::1], types.float64[:, ::1], types.int64[::1]
_BOUND = types.Array(types.float64, 1, "C", readonly=True)


@cache
def _warm_up() -> None:
    trials = _MATRIX, types.int64, _INDICES, types.boolean, *(types.float64,) * 2, types.int64, _BOUND, _BOUND
    signatures = [
        (select, (_MATRIX, _VECTOR, _MATRIX, _VECTOR)),
        (make_trials, (*trials, _MATRIX, _MATRIX)),
    ]
    load_kernels(signatures, "compiling differential evolution (once a machine, some 3 s)")
