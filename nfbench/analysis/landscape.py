"""The landscape of an objective: its local minima as a multistart finds them, their basins, and its shape."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.optimize import minimize

from nfbench.core import Problem

from .intervals import share_interval

__all__ = ["Minima", "chao1", "condition", "distance_correlation", "find_minima", "landscape_facts"]

SAME = 5e-3  # of the width of the box: ends that are as close in every coordinate and in value are one minimum
EQUAL = 1e-6  # of the spread of the values at the starts: values that do not differ
STEP = 1e-5  # of the width of the box, for the derivatives of the Hessian
EDGE = 1e-6  # of the width of the box: a minimum that is as close to a face lies on it
PRECISE = {"ftol": 1e-14, "gtol": 1e-9, "maxiter": 500, "maxls": 40}


@final
@dataclass(frozen=True, eq=False)
class Minima:
    """What local searches from random points found.

    places: the distinct minima in the order of their values, shape (m, n).
    values: their values, shape (m,).
    counts: number of searches from random points that ended in each of them, shape (m,).
    starts: starting points, shape (s, n). start_values: their values, shape (s,).
    """

    places: Float[ndarray, "m n"]
    values: Float[ndarray, " m"]
    counts: Int[ndarray, " m"]
    starts: Float[ndarray, "s n"]
    start_values: Float[ndarray, " s"]

    @property
    def best(self) -> ndarray:
        """Which of the minima are global: those whose value does not differ from the smallest, (m,)."""
        found: ndarray = self.values <= self.values[0] + self.tolerance
        return found

    @property
    def tolerance(self) -> float:
        """The difference up to which values count as equal."""
        return EQUAL * float(np.ptp(self.start_values))


def find_minima(
    problem: Problem, starts: int, rng: np.random.Generator, known: Float[ndarray, "k n"] | None = None
) -> Minima:
    """Return the distinct minima that L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995) reaches from uniform random points.

    Coordinates are measured in widths of the box. Minima on its faces count. Two ends are one minimum if they are
    closer than 0.5 % of the width in every coordinate. From the ``known`` points, such as the true positions, further
    searches start, which are not counted.
    """
    width = problem.upper - problem.lower
    U = rng.random((starts, problem.dimension))
    X = problem.lower + U * width
    values = problem.evaluate(X)
    scale = float(np.ptp(values)) or 1.0

    def value(u: ndarray) -> float:
        return problem.value(problem.lower + u * width) / scale

    def value_and_gradient(u: ndarray) -> tuple[float, ndarray]:
        f, g = problem.value_and_gradient(problem.lower + u * width)
        return f / scale, g * width / scale

    box = [(0.0, 1.0)] * problem.dimension
    near = np.empty((0, problem.dimension)) if known is None else np.clip((known - problem.lower) / width, 0.0, 1.0)
    every = np.vstack([U, near])
    ends, found = np.empty_like(every), np.empty(len(every))
    for i, u in enumerate(every):
        search: dict[str, Any] = {"bounds": box, "method": "L-BFGS-B", "options": PRECISE}
        end = (
            minimize(value_and_gradient, u, jac=True, **search)
            if problem.has_gradient
            else minimize(value, u, **search)
        )
        ends[i], found[i] = np.clip(end.x, 0.0, 1.0), end.fun * scale
    kept, counts = _distinct(ends, found, counted=starts)
    return Minima(problem.lower + ends[kept] * width, found[kept], counts, X, values)


def _distinct(ends: Float[ndarray, "s n"], values: Float[ndarray, " s"], counted: int) -> tuple[ndarray, ndarray]:
    """Return the index of the lowest end of each minimum, and how many of the first ``counted`` ends are its own."""
    kept: list[int] = []
    counts: list[int] = []
    for i in np.argsort(values, kind="stable").tolist():
        distances = np.abs(ends[kept] - ends[i]).max(axis=1) if kept else np.empty(0)
        if len(distances) and distances.min() <= SAME:
            counts[int(np.argmin(distances))] += i < counted
        else:
            kept.append(i)
            counts.append(int(i < counted))
    return np.array(kept), np.array(counts)


def chao1(counts: Int[ndarray, " m"]) -> float:
    """Return an estimate of how many minima there are, seen or not (Chao 1984; the bias-corrected form).

    counts: number of searches that ended in each minimum. It is a lower bound for many rare minima.
    """
    once, twice = int(np.sum(counts == 1)), int(np.sum(counts == 2))
    return int(np.sum(counts > 0)) + once * (once - 1) / (2 * (twice + 1))


def distance_correlation(problem: Problem, found: Minima) -> float:
    """Return the fitness–distance correlation (Jones & Forrest 1995): of random points' values and distances.

    The distance is that to the nearest global minimum, in widths of the box. 1: the farther, the worse.
    """
    width = problem.upper - problem.lower
    best = found.places[found.best]
    differences = (found.starts[:, None] - best[None]) / width
    distances = np.sqrt((differences**2).sum(axis=2)).min(axis=1)
    if np.ptp(distances) == 0 or np.ptp(found.start_values) == 0:
        return math.nan
    return float(np.corrcoef(distances, found.start_values)[0, 1])


def condition(problem: Problem, x: Float[ndarray, " n"]) -> float:
    """Return the condition number of the Hessian at a minimum, in coordinates measured in widths of the box.

    Coordinates on a face of the box are left out. inf if the Hessian is not positive definite, NaN if no coordinate is
    left.
    """
    width = problem.upper - problem.lower
    u = (x - problem.lower) / width
    free = np.flatnonzero((u > EDGE) & (u < 1 - EDGE))
    if not len(free):
        return math.nan
    H = _hessian(problem, x, width, free)
    eigenvalues = np.linalg.eigvalsh(H)
    return float(eigenvalues[-1] / eigenvalues[0]) if eigenvalues[0] > 0 else math.inf


def _hessian(problem: Problem, x: ndarray, width: ndarray, free: ndarray) -> ndarray:
    """The Hessian of the free coordinates by central differences: of gradients where the problem has them."""
    step = (STEP if problem.has_gradient else 10 * STEP) * width
    n, E = len(free), np.diag(step)[free]
    if problem.has_gradient:
        rows = [problem.value_and_gradient(x + e)[1] - problem.value_and_gradient(x - e)[1] for e in E]
        H = np.array(rows)[:, free] * width[free] / (2 * step[free] / width[free])[:, None]
    else:
        H = np.empty((n, n))
        for i, j in np.ndindex(n, n):
            points = np.array([x + E[i] + E[j], x + E[i] - E[j], x - E[i] + E[j], x - E[i] - E[j]])
            f = problem.evaluate(points)
            H[i, j] = (f[0] - f[1] - f[2] + f[3]) / (4 * (step / width)[free[i]] * (step / width)[free[j]])
    return np.asarray((H + H.T) / 2)


def landscape_facts(
    problem: Problem, starts: int, rng: np.random.Generator, known: Float[ndarray, "k n"] | None = None
) -> dict[str, float]:
    """Return what a multistart shows of a landscape, by column name.

    known: points near which the global minimum may be, such as the true positions, from which searches start as well,
        shape (k, n). The minima that only they find are no part of the numbers of minima.

    dimension: number of unknowns.
    starts: number of local searches from uniform random points.
    minima: number of distinct local minima that they found.
    minima_values: number of different values of these; smaller where minima are equivalent, as if sources can be
        exchanged.
    minima_chao1: estimate of the number of minima, including those that were not found.
    global_share: share of the searches that ended in a minimum whose value does not differ from the smallest known one:
        the size of the global basin.
    global_share_low, global_share_high: ends of its 95 % interval.
    fdc: fitness–distance correlation of the starting points.
    condition: condition number of the Hessian at the best minimum, in coordinates scaled to the box.
    best: value at the best minimum.
    """
    found = find_minima(problem, starts, rng, known)
    seen = found.values[found.counts > 0]
    hits = int(found.counts[found.best].sum())
    low, high = share_interval(hits, starts)
    values = 1 + int(np.sum(np.diff(seen) > found.tolerance))
    return {
        "dimension": problem.dimension,
        "starts": starts,
        "minima": len(seen),
        "minima_values": values,
        "minima_chao1": chao1(found.counts),
        "global_share": hits / starts,
        "global_share_low": low,
        "global_share_high": high,
        "fdc": distance_correlation(problem, found),
        "condition": condition(problem, found.places[0]),
        "best": float(found.values[0]),
    }
