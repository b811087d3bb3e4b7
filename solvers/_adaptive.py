"""What JADE and its descendants share: their mutation, crossover, rates, archive and memory."""

from __future__ import annotations

import sys
from typing import final

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from nfbench import Incompatible, MeteredProblem

__all__ = [
    "Archive",
    "Memory",
    "best_count",
    "binomial",
    "current_to_pbest",
    "draw_crossover_rates",
    "draw_factors",
    "lehmer",
    "maximum_evaluations",
    "midpoint",
    "planned_size",
    "shares",
    "spent",
]

Population = Float[ndarray, "N n"]
Values = Float[ndarray, " N"]


def draw_factors(mean: Values, rng: np.random.Generator) -> Values:
    """F_i from Cauchy(mean, 0.1): drawn again while F_i ≤ 0, cut to 1 above it."""
    F = mean + 0.1 * rng.standard_cauchy(len(mean))
    while (low := np.flatnonzero(F <= 0.0)).size:
        F[low] = mean[low] + 0.1 * rng.standard_cauchy(len(low))
    return np.minimum(F, 1.0)


def draw_crossover_rates(mean: Values, rng: np.random.Generator) -> Values:
    """CR_i from Normal(mean, 0.1), cut to [0, 1]; 0 where the mean is the terminal value ⊥, here NaN."""
    CR = mean + 0.1 * rng.standard_normal(len(mean))
    return np.where(np.isnan(mean), 0.0, np.clip(CR, 0.0, 1.0))


def current_to_pbest(
    x: Population,
    pbest: Int[ndarray, " N"],
    F: Values,
    archive: Population,
    rng: np.random.Generator,
    weight: float = 1.0,
) -> Population:
    """DE/current-to-pbest/1: v_i = x_i + w·F_i·(x_pbest − x_i) + F_i·(x_r1 − x̃_r2), w the ``weight``.

    r1 ≠ i is one of the population; r2, neither i nor r1, one of population and archive.
    """
    N = len(x)
    i = np.arange(N)
    r1 = rng.integers(N - 1, size=N)
    r1 += r1 >= i
    r2 = rng.integers(N + len(archive) - 2, size=N)
    r2 += r2 >= np.minimum(i, r1)
    r2 += r2 >= np.maximum(i, r1)
    union = np.vstack([x, archive])
    return x + (weight * F)[:, None] * (x[pbest] - x) + F[:, None] * (x[r1] - union[r2])


def best_count(p: float, N: int) -> int:
    """How many of N individuals a share p of them is, at least two."""
    return max(int(p * N + 0.5), 2)


def binomial(x: Population, v: Population, CR: Values, rng: np.random.Generator) -> Population:
    """u_i: coordinate j of v_i where rand_j ≤ CR_i or j = j_rand, else of x_i."""
    N, n = x.shape
    crossed = rng.random((N, n)) <= CR[:, None]
    crossed[np.arange(N), rng.integers(n, size=N)] = True
    return np.where(crossed, v, x)


def midpoint(u: Population, x: Population, problem: MeteredProblem) -> Population:
    """A coordinate outside the box comes back halfway between the bound it passed and its parent's."""
    u = np.where(u < problem.lower, 0.5 * (problem.lower + x), u)
    return np.where(u > problem.upper, 0.5 * (problem.upper + x), u)


def shares(gain: Values) -> Values:
    """w_k = Δf_k/Σ Δf; infinite gains share alike and leave nothing to others."""
    infinite = np.isinf(gain)
    gain = infinite.astype(float) if infinite.any() else gain / gain.max()  # so that no sum overflows
    return gain / gain.sum()


def lehmer(values: Values, weights: Values) -> float:
    """The weighted Lehmer mean Σ w·v²/Σ w·v."""
    return float(weights @ values**2 / (weights @ values))


@final
class Archive:
    """A: parents that a better trial vector has replaced, at most ``size`` of them, kept at random."""

    def __init__(self, size: int, n: int) -> None:
        self.size = size
        self.members: Population = np.empty((0, n))

    def add(self, parents: Population, rng: np.random.Generator) -> None:
        """Each finds a free place or, where there is none, takes that of a random member."""
        free = self.size - len(self.members)
        self.members = np.vstack([self.members, parents[:free]])
        if self.size:
            late = parents[free:]
            self.members[rng.integers(self.size, size=len(late))] = late

    def add_all(self, parents: Population, rng: np.random.Generator) -> None:
        """All of them; where there are then too many, random members go, these among them."""
        self.members = np.vstack([self.members, parents])
        self.resize(self.size, rng)

    def resize(self, size: int, rng: np.random.Generator) -> None:
        """Random members go where there are more than ``size``."""
        self.size = size
        if len(self.members) > size:
            self.members = self.members[rng.permutation(len(self.members))[:size]]


@final
class Memory:
    """The H means M_F and M_CR of what succeeded lately, overwritten in turn; ⊥ in M_CR is NaN."""

    def __init__(self, H: int, F: float, CR: float) -> None:
        self.F, self.CR = np.full(H, F), np.full(H, CR)
        self.k = 0

    def overwrite(self, F: float, CR: float) -> None:
        """Put new means in the next place."""
        self.F[self.k], self.CR[self.k] = F, CR
        self.k = (self.k + 1) % len(self.F)


def maximum_evaluations(problem: MeteredProblem, given: int | None) -> int:
    """MAX_NFE, the evaluations over which an algorithm plans: as given, or what the budget has left.

    Raises Incompatible where neither limits them.
    """
    if given is not None:
        return given
    if problem.remaining > sys.maxsize // 2:
        raise Incompatible(
            "the population shrinks with the share of evaluations spent, and the budget has no limit on these; "
            "give it one, or set the option evaluations"
        )
    return problem.remaining


def spent(problem: MeteredProblem, max_nfe: int) -> float:
    """The share NFE/MAX_NFE of the evaluations that is spent, at most 1."""
    return min(problem.evaluations / max_nfe, 1.0)


def planned_size(first: int, last: int, spent: float) -> int:
    """Linear population size reduction: from ``first`` to ``last`` as the share ``spent`` goes from 0 to 1."""
    return int((last - first) * spent + first + 0.5)
