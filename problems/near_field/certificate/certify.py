"""The algorithm: find a configuration, prune the box to regions, and prove that J has no lower value there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..objectives.kernels import pack_rows
from ..wavefronts import Manifold
from . import kernels, phases
from .balls import Charted, ball_bounds, charted, cover, matrix_monomials, over_cover
from .cells import cells_of, unsheared
from .chart import Chart
from .couplings import couplings, gram_limits
from .minimum import Expansion, distance_expansion, distance_third, misfit_expansion, misfit_third
from .regions import Leaves, prune_box, prune_leaves

__all__ = ["STEPS", "Certificate", "certify", "unproven", "warm_up"]

STEPS = {
    0: "none: certified",
    1: "the best known value is 1 or more, so that no source is confined",
    2: "too much of the box may hold a source",
    3: "two sources may lie in one region, or two of the estimates do",
    4: "J may have another minimum in the product of the regions",
    5: "more regions than sources are left",
    6: "no bound of the phases is known for this array and this box",
}
ROUNDING = 1e-11  # of J, with a margin of ten
CONVEX = 1e-6  # least curvature m that counts as positive
STAGES: dict[int, tuple[tuple[float | None, bool], ...]] = {
    2: ((None, False), (None, True), (1 / 10, True), (1 / 16, True), (1 / 20, True)),
    3: ((None, False), (1 / 3, False), (1 / 5, True), (1 / 8, True)),
}  # what T5 and T6 try: β/α of the leaves, None for those that there are, and whether balls are covered by smaller ones
COVERING = 1 / 4  # β/α from which T4 covers the ball of a region by smaller balls
LOOPS = 16
PARTS = {2: 5, 3: 4}  # cubes along each axis of t that cover a ball, by dimension
COVERED = 0.1  # radius from which covering a ball is worth it
SCALES = (0.15, 0.3, 0.5, 0.75, 1.0)  # parts of a segment, to the end of which bounds hold
SHARES = {2: (1 / 4, 1 / 6, 1 / 10), 3: (1 / 2, 1 / 3, 1 / 4, 1 / 6)}  # β/α of the leaves that T4 tries, by dimension
MOST_REGIONS = 14
FLAT = 1e-6  # gradient by t that adds no more than about 1e-12 to the gap
SQUARED = 1e-13  # an upper bound of the error of the square of a norm of order one
APART = 1e-6  # least eigenvalue of G from which J is known to ROUNDING
BLOCK = 512  # leaves whose couplings are held at once


@final
@dataclass(frozen=True, eq=False)
class Certificate:
    """A configuration, and what is proven about it.

    theta: the sources [rad, m], shape (K, d). J: their misfit. certified: whether J is proven to be the global minimum
    up to ``gap``. gap: proven upper bound of J − min J. step: key of ``STEPS``, where the proof failed; 0 if it did
    not. regions: number of regions of the box that may hold a source. evaluations: of D.
    """

    theta: Float[ndarray, "k d"]
    J: float
    certified: bool
    gap: float
    step: int
    regions: int
    evaluations: int


def unproven(theta: Float[ndarray, "k d"], J: float) -> Certificate:
    """Return a configuration about which nothing is proven but J >= 0, because no bound of the phases is known."""
    return Certificate(theta, J, False, J, 6, 0, 0)


def warm_up() -> None:
    """Load the kernels of the certificate from the cache, or compile them and say so on stderr."""
    kernels.warm_up()
    phases.warm_up()


def certify(
    U: Complex[ndarray, "m k"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, "k d"],
) -> Certificate:
    """Try to prove that ``theta`` is the global minimum of J = ‖(I − P_A)U‖² over K sources in the box.

    Raises Incompatible where no bound is known: for a planar wavefront, or ranges that do not exceed the distance of
    every element from the origin.

    U: orthonormal columns, shape (M, K).
    lower, upper: the box of one source [rad, m].
    theta: a local minimizer in the box [rad, m], shape (K, d).
    """
    warm_up()
    return _Proof(U, manifold, lower, upper, theta).run()


@final
class _Proof:
    def __init__(self, U: ndarray, manifold: Manifold, lower: ndarray, upper: ndarray, theta: ndarray) -> None:
        self.U, self.rows = U, pack_rows(U)
        self.cells = cells_of(manifold, lower, upper)
        self.chart: Chart = self.cells.chart
        self.evaluations = self.regions = 0
        self.sources, self.misfit = _polished(charted(self.chart, self.chart.from_theta(theta)), U)
        self.f = self.misfit.value + ROUNDING
        self.lower_bound = 0.0

    def run(self) -> Certificate:
        step, gap = self.prove()
        J = self.misfit.value
        if step:
            gap = max(J - self.lower_bound, 0.0)
        theta = self.chart.to_theta(self.sources.C)
        return Certificate(theta, J, not step, gap, step, self.regions, self.evaluations)

    def prove(self) -> tuple[int, float]:
        """Return the step that failed, 0 if none did, and the gap if it is certified."""
        if not self.f < 1:
            return 1, math.inf
        if not _are_apart(self.sources):
            return 3, math.inf
        leaves: Leaves | None = None
        for share in SHARES[self.chart.dimension]:
            if leaves is None:
                leaves = prune_box(self.cells, self.rows, self.f, share)
            else:
                finer = prune_leaves(leaves, self.rows, np.full(leaves.regions, self.f), share)
                leaves = None if finer is None else finer.connected()
            if leaves is None:
                return 2, math.inf
            self.evaluations, self.regions = leaves.evaluations, leaves.regions
            self.lower_bound = max(self.lower_bound, float(leaves.lower_bounds().min()))
            mine = leaves.region_of(self.sources.C)
            if mine.min() < 0 or len(np.unique(mine)) < len(mine) or leaves.regions > MOST_REGIONS:
                continue
            others = np.setdiff1d(np.arange(leaves.regions), mine)
            numbered = leaves.only(np.append(mine, others))
            if self.no_region_holds_two(numbered, covering=share <= COVERING):
                return self.refine(numbered)
        return 3, math.inf

    def no_region_holds_two(self, leaves: Leaves, *, covering: bool) -> bool:
        """T4 for every region: each configuration with two sources in it has J > f*."""
        K = len(self.sources.C)
        if K == 1:
            return True
        others = [leaves.centre(k) for k in range(K, leaves.regions)]
        sources = charted(self.chart, np.vstack([self.sources.C, others])) if others else self.sources
        rho = np.array([each.max() for each in leaves.distances(sources)])
        parts = (1, PARTS[self.chart.dimension]) if covering else (1,)
        return any((two_sources(sources, rho, self.U, n) > self.f * (1 + 1e-9)).all() for n in parts)

    def refine(self, leaves: Leaves) -> tuple[int, float]:
        """T5 and T6, with finer leaves where they do not succeed at once."""
        K = len(self.sources.C)
        thresholds = np.full(leaves.regions, self.f)
        step = 4
        for share, covering in STAGES[self.chart.dimension]:
            if share is not None:
                finer = prune_leaves(leaves, self.rows, thresholds, share)
                if finer is None:
                    break
                self.evaluations, leaves = finer.evaluations, finer
            leaves, thresholds = self.discard(leaves, thresholds)
            self.regions = leaves.regions
            if leaves.regions > K:
                step = 5
                continue
            step = 4
            gap, thresholds = self.one_minimum(leaves, thresholds, covering=covering)
            if gap < math.inf:
                return 0, gap
        return step, math.inf

    def discard(self, leaves: Leaves, thresholds: ndarray) -> tuple[Leaves, ndarray]:
        """Return the regions that belong to a possible K-subset."""
        K, thresholds = len(self.sources.C), thresholds[: leaves.regions]  # the last regions may be empty now
        if leaves.regions == K:
            return leaves, thresholds
        bounds = leaves.lower_bounds()
        least = np.array([bounds[leaves.region == k].min(initial=2.0) for k in range(leaves.regions)])
        coupled = _leaf_couplings(leaves, self.chart)
        possible = np.zeros(leaves.regions, dtype=bool)
        for subset in combinations(range(leaves.regions), K):
            index = list(subset)
            weights = 1 / (1 + coupled[np.ix_(index, index)].sum(axis=1))
            if weights @ least[index] <= self.f:
                possible[index] = True
        possible[:K] = True
        kept = np.flatnonzero(possible)
        return leaves.only(kept), thresholds[kept]

    def one_minimum(self, leaves: Leaves, thresholds: ndarray, *, covering: bool) -> tuple[float, ndarray]:
        """T6 on the product of balls around the sources, which T5 shrinks until it holds; a gap of inf if it fails."""
        sources, U, f = self.sources, self.U, self.f
        K = len(sources.C)
        longest = leaves.distances(sources)
        least = leaves.lower_bounds()
        least_of = [least[leaves.region == k] for k in range(K)]
        rho, r = np.array([each.max() for each in longest]), math.inf
        expansions = distance_expansion(sources, U)
        curvature = float(np.linalg.eigvalsh(self.misfit.hessian)[0])
        free = _free(sources, self.misfit.gradient)
        scales: tuple[float, ...] = (1.0,)
        for _ in range(LOOPS):
            r = min(r, math.sqrt(np.sum(rho**2)))
            T, T_D, weights = self.thirds(expansions, rho, r, scales, covering=covering)
            r = min(r, _joint_radius(longest, least_of, weights, f))
            m = curvature - r * T / 3
            if m > CONVEX:
                return float(free @ free) / (2 * m) + ROUNDING, thresholds
            smaller, joint, slack, lows = self.shrink(sources, expansions, T_D, weights, rho)
            self.lower_bound = max(self.lower_bound, f - slack)
            thresholds = np.minimum(thresholds, lows + slack / weights)
            smaller, r = np.minimum(np.minimum(rho, smaller), r), min(r, joint)
            if (smaller > 0.98 * rho).all() and scales == SCALES:
                break
            rho, scales = smaller, SCALES
        return math.inf, thresholds

    def thirds(
        self, expansions: list[Expansion], rho: ndarray, r: float, scales: tuple[float, ...], *, covering: bool
    ) -> tuple[float, ndarray, ndarray]:
        """Return bounds of the averages of |J'''| and |D'''| on segments from the centres, and the weights of T5.

        The average has the weight 3(1 − s)², and what bounds the derivatives on balls of radius sρ holds up to s.
        """
        sources, D = self.sources, np.array([e.value for e in expansions])
        T, T_D, before, weights = 0.0, np.zeros(len(D)), 0.0, np.ones(len(D))
        for s in scales:
            near = s * rho
            parts = PARTS[self.chart.dimension] if covering and near.max() > COVERED else 1
            pieces, radii, first = cover(sources, near, parts)
            each = ball_bounds(pieces, radii, self.U)
            bounds, found = over_cover(each, first), couplings(pieces, radii, each, first, sources)
            share = (1 - before) ** 3 - (1 - s) ** 3
            T += share * misfit_third(bounds, found, gram_limits(sources, found), self.misfit.value, s * r)
            T_D += share * distance_third(bounds, D, near)
            before, weights = s, 1 / (1 + found.value.sum(axis=1))
        return T, T_D, weights

    def shrink(
        self, sources: Charted, expansions: list[Expansion], T: ndarray, weights: ndarray, rho: ndarray
    ) -> tuple[ndarray, float, float, ndarray]:
        """T5: the radii that are left, the joint radius, the slack, and lower bounds of D on the balls."""
        D = np.array([e.value for e in expansions])
        vertex, away, curvature = np.zeros(len(D)), np.zeros(len(D)), np.empty(len(D))
        for k, e in enumerate(expansions):
            H = e.hessian - rho[k] * T[k] / 3 * np.eye(len(e.gradient))
            curvature[k] = np.linalg.eigvalsh(H)[0]
            if curvature[k] <= CONVEX:
                continue
            g = _free_of(sources, k, e.gradient)
            t = -np.linalg.solve(H, g)
            vertex[k], away[k] = D[k] + g @ t / 2 - ROUNDING, np.linalg.norm(t)
        lows = np.maximum(vertex, 0.0)
        slack = max(self.f - float(weights @ lows), 0.0)
        if (curvature <= CONVEX).any():
            return rho, math.inf, slack, lows
        below = weights * (lows - vertex)  # the parabola that bounds D may start below 0
        radii = away + np.sqrt(2 * (slack + below) / (weights * curvature))
        joint = float(np.linalg.norm(away)) + math.sqrt(2 * (slack + below.sum()) / np.min(weights * curvature))
        return radii, joint, slack, lows


def two_sources(
    sources: Charted, rho: Float[ndarray, " b"], U: Complex[ndarray, "m k"], parts: int = 1
) -> Float[ndarray, " b"]:
    """T4: return a lower bound of J for any configuration with two sources in the ball of radius ρ around a centre.

    w = â(θ₂) − â(θ₁) lies in span A, so J >= ‖P⊥_U w‖²/‖w‖², and w = ∂â·δ + e at the midpoint, ‖e‖ <= n₃‖δ‖³/24. σ is a
    lower bound of ‖P⊥_U ∂â·δ‖/‖δ‖ on the balls that cover the ball.
    """
    pieces, radii, first = cover(sources, rho, parts)
    each = ball_bounds(pieces, radii, U)
    once = pieces.first - (pieces.first @ U.conj()) @ U.T  # P⊥_U ∂â
    least_of = np.linalg.eigvalsh((once @ once.conj().swapaxes(1, 2)).real)[:, 0]
    away = np.sqrt(np.maximum(least_of - SQUARED, 0.0))
    twice = matrix_monomials(pieces.second - (pieces.second @ U.conj()) @ U.T)
    curved = np.sqrt(np.linalg.eigvalsh((twice @ twice.conj().swapaxes(1, 2)).real)[:, -1])
    sigma = np.sqrt(np.maximum(np.maximum(each.v, 0.0) ** 2 - each.u1**2 - SQUARED, 0.0))
    sigma = np.maximum(sigma, away - radii * np.minimum(each.n2, curved + radii / 2 * each.n3))
    bounds = over_cover(each, first)
    sigma = np.minimum.reduceat(sigma, first)
    least: ndarray = (np.maximum(sigma - rho**2 * bounds.n3 / 6, 0.0) / bounds.n1) ** 2
    return least


def _joint_radius(longest: list[ndarray], least: list[ndarray], weights: Float[ndarray, " k"], f: float) -> float:
    """Return r: every x with Σ w_k D(θ_k) <= f* in the boxes has ‖t‖ <= r, from the best multiplier ν."""
    scale = max(float(np.sum([each.max() ** 2 for each in longest])) / f, 1e-300)
    best = math.inf
    for nu in scale * 2.0 ** np.arange(-6, 5):
        square = nu * f + sum(np.max(r**2 - nu * w * D) for r, D, w in zip(longest, least, weights, strict=True))
        best = min(best, max(float(square), 0.0))
    return math.sqrt(best)


def _leaf_couplings(leaves: Leaves, chart: Chart) -> Float[ndarray, "regions regions"]:
    """Return bounds of |â_kᴴâ_j| between regions: angles between responses change by both β at most."""
    a = chart.jets(unsheared(chart, leaves.centres))[0]
    n, order = leaves.regions, np.argsort(leaves.region, kind="stable")
    coupled = np.zeros((n, n))
    for first in range(0, len(order), BLOCK):
        rows = order[first : first + BLOCK]
        angle = np.arccos(np.minimum(np.abs(a[rows].conj() @ a.T), 1.0)) - leaves.beta[rows, None] - leaves.beta
        bound = np.cos(np.clip(angle, 0.0, math.pi / 2))
        for k in np.unique(leaves.region[rows]):
            largest = bound[leaves.region[rows] == k].max(axis=0)
            np.maximum.at(coupled[k], leaves.region, largest)
    coupled = np.maximum(coupled, coupled.T)
    np.fill_diagonal(coupled, 0.0)
    return coupled


def _polished(sources: Charted, U: ndarray) -> tuple[Charted, Expansion]:
    """Return the sources after up to three Newton steps on J inside the box, as long as J does not grow."""
    K, d = sources.C.shape
    chart = sources.chart
    if not _are_apart(sources):  # without derivatives
        A, empty = sources.a.T, np.zeros(sources.C.size)
        residual = U - A @ np.linalg.lstsq(A, U)[0]
        return sources, Expansion(float(np.vdot(residual, residual).real), empty, np.zeros((empty.size, empty.size)))
    misfit = misfit_expansion(sources, U)
    for _ in range(3):
        held = _held(sources, misfit.gradient)
        g, H = misfit.gradient.copy(), misfit.hessian.copy()
        if np.linalg.norm(_free(sources, g)) < FLAT or np.linalg.eigvalsh(H)[0] <= CONVEX:
            break
        # steps in t that leave the held coordinates θ_i = Σ_j S_ij t_j as they are
        rows = np.zeros((K * d, K * d))
        for k in range(K):
            rows[k * d : (k + 1) * d, k * d : (k + 1) * d] = sources.S[k]
        fixed = rows[held.ravel()]
        basis = np.eye(K * d) if not len(fixed) else np.linalg.svd(fixed)[2][len(fixed) :].T
        t = -basis @ np.linalg.solve(basis.T @ H @ basis, basis.T @ g) if basis.size else np.zeros(K * d)
        C = np.clip(sources.C + np.einsum("kij,kj->ki", sources.S, t.reshape(K, d)), chart.lower, chart.upper)
        moved = charted(chart, chart.snapped(C))
        if not _are_apart(moved):
            break
        trial = misfit_expansion(moved, U)
        if not trial.value <= misfit.value + 1e-15:
            break
        sources, misfit = moved, trial
    return sources, misfit


def _are_apart(sources: Charted) -> bool:
    """Return whether G is so well conditioned that J and its derivatives can be computed from its inverse."""
    return bool(np.linalg.eigvalsh(sources.a.conj() @ sources.a.T)[0] > APART)


def _held(sources: Charted, gradient: ndarray) -> ndarray:
    """Return which coordinates (K, d) are on an edge of the box into which J grows."""
    chart = sources.chart
    by_coordinate = _by_coordinate(sources, gradient)
    at_lower, at_upper = chart.lower >= sources.C, chart.upper <= sources.C
    return (at_lower & (by_coordinate >= 0)) | (at_upper & (by_coordinate <= 0))


def _by_coordinate(sources: Charted, gradient: ndarray) -> Float[ndarray, "k d"]:
    """Return the derivatives by the coordinates from those by t."""
    by_coordinate: ndarray = (sources.inverse.swapaxes(1, 2) @ gradient.reshape(len(sources.C), -1, 1))[..., 0]
    return by_coordinate


def _free(sources: Charted, gradient: ndarray) -> ndarray:
    """Return g_F: the gradient without the derivatives along which J grows into the box at an active edge."""
    by_coordinate = _by_coordinate(sources, gradient)
    by_coordinate[_held(sources, gradient)] = 0.0
    return (sources.S.swapaxes(1, 2) @ by_coordinate[..., None]).ravel()


def _free_of(sources: Charted, k: int, gradient: ndarray) -> ndarray:
    """The same for D of source k."""
    whole = np.zeros_like(sources.C)
    whole[k] = gradient
    return _free(sources, whole.ravel()).reshape(sources.C.shape)[k]
