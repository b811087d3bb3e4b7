"""T7: the smallest value of RLS over one source, proven to a stated gap.

RLS is ‖Y‖² − p with p = ‖Lᴴâ‖². At a maximizer that is free to move in all directions of a box, √p has no slope, so
from the centre of the box it is higher by ½s₁n₂β² at most, s₁ = ‖L‖ and n₂ >= ‖â''‖. A maximizer on an edge of Θ is
free along that edge only, so the edges (and faces) are searched by themselves, and the corners evaluated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..objectives.kernels import pack_rows
from ..wavefronts import Manifold
from . import kernels
from .balls import Charted, ball_bounds, charted, whitening
from .cells import Cells, cells_of, change, metric, unsheared
from .chart import Chart

__all__ = ["OneSource", "certify_one_source"]

Measures: TypeAlias = tuple[ndarray, ndarray, ndarray, ndarray]

MOST = 200_000  # evaluations
RADII = 0.3 * 0.8 ** np.arange(12)  # of the ball around the maximizer that are tried
LENGTH = 0.45  # largest √F_ii·h_i of a part of an edge [rad]


@final
@dataclass(frozen=True, eq=False)
class OneSource:
    """A source and what is proven about it.

    theta: the source [rad, m], shape (d,). J: ‖(I − P_a)L‖² of the source that was to be certified. certified: whether
    J − min J is proven to be at most ``gap``. evaluations: of J.
    """

    theta: Float[ndarray, " d"]
    J: float
    certified: bool
    gap: float
    evaluations: int


def certify_one_source(
    L: Complex[ndarray, "m c"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, " d"],
    gap: float = 1e-6,
) -> OneSource:
    """Try to prove that ``theta`` minimizes RLS up to ``gap`` times the energy that it explains.

    If a better point is found on the way, nothing is certified, and ``theta`` of the result is that point, from which
    a local search may start again. Raises Incompatible as
    ``certify`` does.

    L: data, or any factor of it, shape (M, c).
    lower, upper: the box of the source [rad, m].
    theta: a local minimizer in the box [rad, m], shape (d,).
    """
    kernels.warm_up()
    cells = cells_of(manifold, lower, upper)
    chart, rows, s1 = cells.chart, pack_rows(L), float(np.linalg.norm(L, 2))
    c = chart.from_theta(theta[None])
    found = charted(chart, c)
    p = float(np.linalg.norm(found.a @ L.conj()) ** 2)
    energy = float(np.vdot(L, L).real)
    ball, beyond = _ball(found, L, s1)
    best, evaluations, inside, where = math.sqrt(p), 0, True, c[0].copy()
    for shear, centres, halves, measures in _families(cells):
        box = np.array([chart.lower, chart.upper])
        model = (*manifold.packed, rows, chart.is_sine, shear, box)
        value, count = kernels.bound_energy(*model, (centres, halves), measures, ball, s1, best, gap, MOST, where)
        evaluations += abs(count)
        inside &= count >= 0 and value <= math.sqrt(p) * (1 + 1e-9)
        best = max(best, value)
    corners = chart.to_theta(np.array(list(product(*zip(chart.lower, chart.upper, strict=True)))))
    highest = float(np.max(np.linalg.norm(manifold.response(corners).conj() @ L, axis=1) ** 2)) / manifold.elements
    inside &= highest <= p * (1 + gap)
    bound = max(best**2 * (1 + gap / 2) ** 2, highest, p + beyond)
    proven = bound - p if inside else max(energy, 0.0)
    if not inside:  # a start for another search, if one was found
        theta = chart.to_theta(np.clip(where, chart.lower, chart.upper)[None])[0]
    return OneSource(theta, max(energy - p, 0.0), bool(inside), float(proven), evaluations + len(corners))


def _ball(found: Charted, L: ndarray, s1: float) -> tuple[tuple[ndarray, ndarray, float], float]:
    """Return a ball around the source in which p is nowhere larger than at its centre by more than the number returned.

    With λ the least curvature of −p and |p'''| <= T, p <= p̂ + ‖g_F‖²/2m for m = λ − ρT/3 > 0. The radius is 0 where
    that does not hold for any.
    """
    q, q1, q2 = found.a[0] @ L.conj(), found.first[0] @ L.conj(), found.second[0] @ L.conj()
    gradient = 2 * (q1 @ q.conj()).real
    H = 2 * (q1 @ q1.conj().T + q2 @ q.conj()).real
    chart, S = found.chart, found.S[0]
    slope = np.linalg.solve(S.T, gradient)  # by the coordinates
    slope[((found.C[0] <= chart.lower) & (slope <= 0)) | ((found.C[0] >= chart.upper) & (slope >= 0))] = 0
    free = S.T @ slope
    inverse = np.ascontiguousarray(np.linalg.inv(S))
    for rho in RADII:
        bounds = ball_bounds(found, np.array([rho]), L[:, :0])
        n1, n2, n3 = (float(n[0]) for n in (bounds.n1, bounds.n2, bounds.n3))
        m = -np.linalg.eigvalsh(H)[-1] - rho * s1**2 * (6 * n1 * n2 + 2 * n3) / 3
        if m > 1e-6 * s1**2:
            return (found.C[0], inverse, float(rho)), float(free @ free) / (2 * m)
    return (found.C[0], inverse, -1.0), 0.0


def _families(cells: Cells) -> list[tuple[float, ndarray, ndarray, Measures]]:
    """Return the boxes of the interior, and of each face and edge: shear, centres, half-widths and their metrics."""
    if cells.families is None:
        chart, d = cells.chart, cells.chart.dimension
        found = [(chart.shear, cells.centres, cells.halves, _measures(chart, chart.shear, cells.centres, cells.halves))]
        for kinds in product((None, 0, 1), repeat=d):  # of each coordinate: free, at its lower or at its upper end
            fixed = [i for i, kind in enumerate(kinds) if kind is not None]
            if fixed and len(fixed) < d:
                centres, halves = _divide(chart, kinds)
                found.append((0.0, centres, halves, _measures(chart, 0.0, centres, halves)))
        object.__setattr__(cells, "families", found)
        return found
    return cells.families


def _divide(chart: Chart, kinds: tuple[int | None, ...]) -> tuple[ndarray, ndarray]:
    """Divide a face of Θ until its parts are about as small as the cells."""
    ends = np.array([chart.lower, chart.upper])
    c = np.array([ends[:, i].mean() if kind is None else ends[kind, i] for i, kind in enumerate(kinds)])
    h = np.array([chart.width[i] / 2 if kind is None else 0.0 for i, kind in enumerate(kinds)])
    waiting, done = [(c, h)], []
    while waiting:
        centres, halves = (np.array(side) for side in zip(*waiting, strict=True))
        sizes = np.sqrt(np.einsum("bii->bi", metric(chart, centres, 0.0))) * halves
        waiting = []
        for c, h, size in zip(centres, halves, sizes, strict=True):
            i = int(np.argmax(size))
            if size[i] <= LENGTH:
                done.append((c, h))
                continue
            for sign in (-1, 1):
                part_c, part_h = c.copy(), h.copy()
                part_h[i] /= 2
                part_c[i] += sign * part_h[i]
                waiting.append((part_c, part_h))
    centres, halves = (np.array(side) for side in zip(*done, strict=True))
    return centres, halves


def _measures(chart: Chart, shear: float, centres: ndarray, halves: ndarray) -> Measures:
    """Return F, R, the metric of t, and n₂ on a ball that holds the box, for each box."""
    n2, Q = np.empty(len(centres)), np.empty((len(centres), centres.shape[1], centres.shape[1]))
    turn = np.eye(centres.shape[1])
    turn[0, -1] = shear
    for first in range(0, len(centres), 256):
        part = slice(first, first + 256)
        plain = unsheared(chart, centres[part], shear)
        sources = charted(chart, plain, whitening(chart, plain))
        back = np.linalg.inv(sources.S) @ turn  # from the coordinates of the boxes to t
        Q[part] = back.swapaxes(1, 2) @ back
        rho = np.sqrt(np.einsum("bij,bi,bj->b", np.abs(Q[part]), halves[part], halves[part]))
        n2[part] = ball_bounds(sources, rho, np.zeros((sources.a.shape[1], 0), complex)).n2
    return metric(chart, centres, shear), change(chart, centres, halves, shear), Q, n2
