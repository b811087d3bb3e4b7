"""Crowding differential evolution: a population that keeps many minima at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from nfbench import Ge, Le, MeteredProblem, Solver, SolverInfo, Tune

from ._adaptive import binomial, midpoint

__all__ = ["CrowdingDE"]


@dataclass(frozen=True)
class CrowdingDE(Solver):
    """DE/rand/1/bin in which a trial vector competes with the individual nearest to it, not with its parent.

    So each minimum keeps the individuals around it. Distances are Euclidean, with each coordinate in units of the width
    of the box. The trial vectors of a generation are made and evaluated together and then compete one by one.

    population: N_p, the number of individuals. Each generation spends N_p evaluations.
    F: scaling factor of the difference vector, in [0, 2].
    CR: C_r, crossover probability, in [0, 1].
    neighbors: m, the number of other individuals nearest to the parent from which r_1, r_2, r_3 are chosen. This is the
        neighborhood mutation of Qu, Suganthan & Liang 2012 (NCDE), which refines many minima sooner; they use 5 to 20.
        None: all others.

    A coordinate outside the box is set halfway between the bound that it passed and its parent's coordinate.
    """

    population: Annotated[int, Ge(4), Tune(20, 400, log=True)] = 100
    F: Annotated[float, Ge(0.0), Le(2.0), Tune(0.2, 1.0)] = 0.5
    CR: Annotated[float, Ge(0.0), Le(1.0)] = 0.9
    neighbors: Annotated[int, Ge(3)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        batched=True,
        accepts_start=True,
        converges=False,  # it spreads its evaluations over all minima
        reference="Thomsen 2004, doi:10.1109/CEC.2004.1331058; NCDE: Qu, Suganthan & Liang 2012, "
        "doi:10.1109/TEVC.2011.2161873",
    )

    def validate(self) -> None:
        if self.neighbors is not None and self.neighbors >= self.population:
            raise ValueError(
                f"neighbors: expected fewer than the population of {self.population}, got {self.neighbors}"
            )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        N = self.population
        x, f = problem.first_population(N, rng)
        problem.keep_population(x, f)
        while True:
            r1, r2, r3 = self._partners(problem.to_unit(x), rng)
            v = x[r1] + self.F * (x[r2] - x[r3])  # v_i = x_r1 + F·(x_r2 − x_r3)
            v = midpoint(v, x, problem)
            u = binomial(x, v, self.CR, rng)  # u_ij = v_ij if rand_j ≤ C_r or j = j_rand, else x_ij
            compete(x, f, u, problem.evaluate(u), problem.upper - problem.lower)

    def _partners(self, U: Float[ndarray, "N n"], rng: np.random.Generator) -> Int[ndarray, "3 N"]:
        """r_1, r_2, r_3 of each individual, distinct and other than i; every choice is equally likely."""
        N = len(U)
        m = self.neighbors or N - 1
        if m == N - 1:
            others = (np.arange(N)[:, None] + np.arange(1, N)) % N
        else:
            distance = squared_distances(U, U)
            np.fill_diagonal(distance, -1.0)  # so that each individual comes first itself
            others = np.argpartition(distance, m, axis=1)[:, : m + 1]
            others = others[others != np.arange(N)[:, None]].reshape(N, m)
        places = np.argsort(rng.random((N, m)), axis=1)[:, :3]
        return np.take_along_axis(others, places, axis=1).T


def compete(
    x: Float[ndarray, "N n"],
    f: Float[ndarray, " N"],
    u: Float[ndarray, "N n"],
    fu: Float[ndarray, " N"],
    width: Float[ndarray, " n"],
) -> None:
    """Each trial vector in turn takes the place of the individual nearest to it, unless it is worse."""
    distance = squared_distances(u / width, x / width)
    for k in range(len(u)):
        near = int(distance[k].argmin())
        if fu[k] <= f[near]:
            x[near], f[near] = u[k], fu[k]
            distance[k + 1 :, near] = (((u[k + 1 :] - u[k]) / width) ** 2).sum(axis=1)


def squared_distances(A: Float[ndarray, "a n"], B: Float[ndarray, "b n"]) -> Float[ndarray, "a b"]:
    """‖A_i − B_j‖², without the cancellation of expanding the square."""
    return np.asarray(sum((A[:, None, j] - B[None, :, j]) ** 2 for j in range(A.shape[1])))
