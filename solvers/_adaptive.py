"""The parts that JADE and its descendants share: rates, mutation, crossover, archive, memory and population."""

from __future__ import annotations

import sys
from typing import final

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from nfbench import Incompatible, MeteredProblem

__all__ = [
    "N_MIN",
    "Archive",
    "Memory",
    "Population",
    "best_count",
    "binomial",
    "current_to_pbest",
    "draw_crossover_rates",
    "draw_factors",
    "lehmer",
    "lehmer_means",
    "maximum_evaluations",
    "midpoint",
    "planned_size",
    "shares",
    "spent",
    "trial_vectors",
]

N_MIN = 4  # individuals that current-to-pbest/1 needs

Points = Float[ndarray, "N n"]
Values = Float[ndarray, " N"]
Indices = Int[ndarray, " N"]


def draw_factors(mean: Values, rng: np.random.Generator) -> Values:
    """F_i from Cauchy(mean_i, 0.1), redrawn while F_i ≤ 0 and set to 1 if F_i > 1."""
    F = mean + 0.1 * rng.standard_cauchy(len(mean))
    while (low := np.flatnonzero(F <= 0.0)).size:
        F[low] = mean[low] + 0.1 * rng.standard_cauchy(len(low))
    return np.minimum(F, 1.0)


def draw_crossover_rates(mean: Values, rng: np.random.Generator) -> Values:
    """CR_i from Normal(mean_i, 0.1), clipped to [0, 1]; it is 0 if the mean is the terminal value ⊥, here NaN."""
    CR = mean + 0.1 * rng.standard_normal(len(mean))
    return np.where(np.isnan(mean), 0.0, np.clip(CR, 0.0, 1.0))


def current_to_pbest(
    x: Points,
    pbest: Indices,
    F: Values,
    archive: Points,
    rng: np.random.Generator,
    weight: float = 1.0,
) -> Points:
    """DE/current-to-pbest/1: v_i = x_i + w·F_i·(x_pbest − x_i) + F_i·(x_r1 − x̃_r2), where w is the ``weight``.

    x_r1 is from the population and x̃_r2 from the population and the archive; r1 ≠ i, and r2 is neither i nor r1.
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
    """The number of individuals in a share p of N, rounded, but at least two."""
    return max(int(p * N + 0.5), 2)


def midpoint(v: Points, x: Points, problem: MeteredProblem) -> Points:
    """Set each coordinate outside the box halfway between the bound that it passed and its parent's coordinate."""
    v = np.where(v < problem.lower, 0.5 * (problem.lower + x), v)
    return np.where(v > problem.upper, 0.5 * (problem.upper + x), v)


def binomial(x: Points, v: Points, CR: Values | float, rng: np.random.Generator) -> Points:
    """u_ij = v_ij if rand_j ≤ CR_i or j = j_rand, else x_ij."""
    N, n = x.shape
    crossed = rng.random((N, n)) <= np.reshape(CR, (-1, 1))
    crossed[np.arange(N), rng.integers(n, size=N)] = True
    return np.where(crossed, v, x)


def trial_vectors(
    x: Points,
    pbest: Indices,
    F: Values,
    CR: Values,
    archive: Points,
    problem: MeteredProblem,
    rng: np.random.Generator,
    weight: float = 1.0,
) -> Points:
    """The trial vectors of DE/current-to-pbest/1/bin, one for each individual, inside the box."""
    v = current_to_pbest(x, pbest, F, archive, rng, weight)
    v = midpoint(v, x, problem)
    return binomial(x, v, CR, rng)


def shares(gain: Values) -> Values:
    """w_k = Δf_k/Σ Δf. Infinite gains share the weight equally and leave none to the finite ones."""
    infinite = np.isinf(gain)
    gain = infinite.astype(float) if infinite.any() else gain / gain.max()  # so that no sum overflows
    return gain / gain.sum()


def lehmer(values: Values, weights: Values) -> float:
    """The weighted Lehmer mean Σ w·v²/Σ w·v."""
    return float(weights @ values**2 / (weights @ values))


def lehmer_means(S_F: Values, S_CR: Values, gain: Values) -> tuple[float, float]:
    """mean_WL(S_F) and mean_WL(S_CR), weighted by the gains; the latter is ⊥, here NaN, if every CR in S_CR is 0."""
    w = shares(gain)
    return lehmer(S_F, w), lehmer(S_CR, w) if S_CR.max() > 0.0 else np.nan


@final
class Archive:
    """A: at most ``size`` parents that better trial vectors have replaced."""

    def __init__(self, size: int, n: int) -> None:
        self.size = size
        self.members: Points = np.empty((0, n))

    def add(self, parents: Points, rng: np.random.Generator) -> None:
        """Add each parent in a free place or, if there is none, in the place of a random member."""
        free = self.size - len(self.members)
        self.members = np.vstack([self.members, parents[:free]])
        if self.size:
            late = parents[free:]
            self.members[rng.integers(self.size, size=len(late))] = late

    def add_all(self, parents: Points, rng: np.random.Generator) -> None:
        """Add all parents, then remove random members, which may be new ones, until ``size`` are left."""
        self.members = np.vstack([self.members, parents])
        self.resize(self.size, rng)

    def resize(self, size: int, rng: np.random.Generator) -> None:
        """Remove random members until at most ``size`` are left."""
        self.size = size
        if len(self.members) > size:
            self.members = self.members[rng.permutation(len(self.members))[:size]]


@final
class Memory:
    """M_F and M_CR: the means of the F and CR that succeeded in the last H successful generations; ⊥ is NaN."""

    def __init__(self, H: int, F: float, CR: float) -> None:
        self.F, self.CR = np.full(H, F), np.full(H, CR)
        self.k = 0

    def overwrite(self, F: float, CR: float) -> None:
        """Replace the oldest means, those at place k, by new ones."""
        self.F[self.k], self.CR[self.k] = F, CR
        self.k = (self.k + 1) % len(self.F)


@final
class Population:
    """P: the individuals x and their values f, with the archive A of size round(archive_rate·N)."""

    def __init__(self, N: int, archive_rate: float, problem: MeteredProblem, rng: np.random.Generator) -> None:
        self.archive_rate = archive_rate
        self.problem, self.rng = problem, rng
        self.x: Points
        self.f: Values
        self.x, self.f = problem.first_population(N, rng)
        self.A = Archive(round(archive_rate * N), problem.dimension)
        problem.keep_population(self.x, self.f)

    def __len__(self) -> int:
        return len(self.x)

    def ranking(self) -> Indices:
        """The individuals from the best to the worst; equal ones keep their order."""
        return np.argsort(self.f, kind="stable")

    def evolve(self, pbest: Indices, F: Values, CR: Values, weight: float = 1.0) -> tuple[Values, Values, Values]:
        """Make one generation; return S_F, S_CR and the gains Δf of the trial vectors that are better."""
        x, f = self.x, self.f
        u = trial_vectors(x, pbest, F, CR, self.A.members, self.problem, self.rng, weight)
        fu = self.problem.evaluate(u)
        better, as_good = fu < f, fu <= f
        gain = f[better] - fu[better]
        self.A.add(x[better], self.rng)
        x[as_good], f[as_good] = u[as_good], fu[as_good]
        return F[better], CR[better], gain

    def shrink(self, N: int) -> None:
        """Keep the best N individuals, in their order, and an archive in proportion."""
        kept = np.sort(self.ranking()[:N])
        self.x, self.f = self.x[kept], self.f[kept]
        self.A.resize(round(self.archive_rate * N), self.rng)
        self.problem.keep_population(self.x, self.f)


def maximum_evaluations(problem: MeteredProblem, given: int | None) -> int:
    """MAX_NFE, the number of evaluations that an algorithm plans for: as given, or else those left in the budget.

    Raises Incompatible if neither limits the evaluations.
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
    """The share NFE/MAX_NFE of the evaluations spent so far, at most 1."""
    return min(problem.evaluations / max_nfe, 1.0)


def planned_size(N_init: int, N_min: int, spent: float) -> int:
    """Linear population size reduction: round[(N_min − N_init)·NFE/MAX_NFE + N_init], halves rounded up."""
    return int((N_min - N_init) * spent + N_init + 0.5)
