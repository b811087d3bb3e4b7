"""Differential evolution, DE/rand/1/bin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from nfbench import Ge, Le, MeteredProblem, Solver, SolverInfo

__all__ = ["DE"]

BLOCK = 16  # generations whose random numbers are drawn together: small enough to stay in the cache

Draws: TypeAlias = tuple[Int[ndarray, "3 N"], Bool[ndarray, "N n"]]


@dataclass(frozen=True)
class DE(Solver):
    """Differential evolution DE/rand/1/bin with synchronous generations.

    population: N_p, individuals; each generation spends as many evaluations.
    F: scaling factor of the difference vector, in [0, 2].
    CR: C_r, crossover probability, in [0, 1].
    bounds: what becomes of a trial coordinate outside the box, on which the original is silent. "clip": the bound it
        passed; "midpoint": halfway between that bound and the target vector's coordinate; "reflect": mirrored at the
        bound, as often as needed; "resample": uniform in the box.
    generations: G, the initial population being the first, so G·N_p evaluations in all; None: until the budget ends.

    The initial population is uniform in the box. r_1, r_2, r_3 are distinct and also differ from i (Storn and Price's
    condition), each such triple equally likely.

    Draw order, from which another implementation can be fed the same numbers: ``random((N, n))`` for the population,
    then for every block of 16 generations ``integers(1, N, (16, N))``, ``integers(1, N - 1, (16, N))``,
    ``integers(1, N - 2, (16, N))`` for r_1, r_2, r_3, ``random((16, N, n))`` for rand_j and ``integers(0, n, (16, N))``
    for j_rand. The first three numbers of individual i deal it cards: from the list i+1, i+2, …, i+N-1 (mod N) they
    take the card at that place, counted from 1, out of those still there. "resample" draws ``random(count)`` for the
    coordinates outside, row by row, when the generation is made.
    """

    population: Annotated[int, Ge(4)] = 50
    F: Annotated[float, Ge(0.0), Le(2.0)] = 0.5
    CR: Annotated[float, Ge(0.0), Le(1.0)] = 0.8
    bounds: Literal["clip", "midpoint", "reflect", "resample"] = "clip"
    generations: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(batched=True, reference="Storn & Price 1997, doi:10.1023/A:1008202821328")

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N, n = self.population, problem.dimension
        lower, upper = problem.lower, problem.upper
        x = problem.from_unit(rng.random((N, n)))
        f = problem.evaluate(x)
        more = None if self.generations is None else self.generations - 1
        for r, cross in islice(self._draws(rng, N, n), more):
            x1, x2, x3 = x.take(r, axis=0)
            v = x1 + self.F * (x2 - x3)  # mutation
            u = np.where(cross, v, x)  # crossover
            if self.bounds == "clip":
                np.minimum(np.maximum(u, lower, out=u), upper, out=u)
            else:
                self._repair(u, x, lower, upper, rng)
            fu = problem.evaluate(u)
            better = fu <= f  # selection
            np.copyto(x, u, where=better[:, None])
            np.copyto(f, fu, where=better)

    def _draws(self, rng: np.random.Generator, N: int, n: int) -> Iterator[Draws]:
        """Of each generation, the indices r_1, r_2, r_3 and where the trial takes the mutant's coordinate."""
        i = np.arange(N)
        while True:
            # k_1, k_2, k_3: distinct steps from i, each drawn among those left and moved past the ones taken
            k1 = rng.integers(1, N, (BLOCK, N))
            k2 = rng.integers(1, N - 1, (BLOCK, N))
            k3 = rng.integers(1, N - 2, (BLOCK, N))
            k2 += k2 >= k1
            k3 += k3 >= np.minimum(k1, k2)
            k3 += k3 >= np.maximum(k1, k2)
            r = (i + np.stack([k1, k2, k3], axis=1)) % N
            cross = rng.random((BLOCK, N, n)) <= self.CR
            j_rand = rng.integers(0, n, (BLOCK, N))
            np.put_along_axis(cross, j_rand[..., None], True, axis=2)
            yield from zip(r, cross, strict=True)

    def _repair(
        self,
        u: Float[ndarray, "N n"],
        x: Float[ndarray, "N n"],
        lower: Float[ndarray, " n"],
        upper: Float[ndarray, " n"],
        rng: np.random.Generator,
    ) -> None:
        """Bring the trials ``u`` of the targets ``x`` into the box, in place."""
        outside = (u < lower) | (u > upper)
        if not outside.any():
            return
        width = upper - lower
        if self.bounds == "midpoint":
            inside = 0.5 * (x + np.where(u < lower, lower, upper))
        elif self.bounds == "reflect":
            t = (u - lower) % (2.0 * width)  # a mirror at both ends has period 2·width
            inside = lower + np.minimum(t, 2.0 * width - t)
        else:
            inside = u.copy()
            inside[outside] = rng.random(int(outside.sum()))
            inside = lower + inside * width
        np.copyto(u, np.clip(inside, lower, upper), where=outside)
