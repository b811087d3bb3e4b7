"""The search where the compiled kernels do not apply: responses of any modulus, in NumPy.

The algorithms are those of the kernels: a greedy choice on the grid, Levenberg–Marquardt on the variable projection,
and the standard errors from the curvature.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray

from ..bounds import information_root
from ..objectives.general_fit import orthonormalize, squared_lengths
from ..wavefronts import Manifold

__all__ = ["choose_greedily", "choose_replacement", "derivatives", "inverse_curvature", "local_search"]

Responses: TypeAlias = Callable[[], Iterator[tuple[int, ndarray]]]
"""Yields the responses of a grid in blocks, one per row, each with the index of its first point."""

SAME_LOBE = 0.3  # squared correlation of two responses above which they are in one lobe
LEAST = 1e-8  # squared distance of a candidate from the span of the others, relative to its own, below which it is none
SINGULAR = 1e-8  # singular value of A, relative to the greatest, below which it is 0
APART = 1e-10  # least pivot of AᴴA from which standard errors are computed

ITERATIONS = 100
FIRST_DAMPING, LAST_DAMPING = 1e-3, 1e12  # μ
LONGEST = 0.25  # of a step in each coordinate: in beamwidths and depths of focus
ENOUGH = 1e-15  # decrease of J, relative to J, at which the search ends
LOST = 1e-13  # predicted decrease below which J may rise by its rounding errors alone
ROUNDING = 1e-30  # decrease of J, relative to ‖F‖², below which J is only the rounding of the residual
FLAT = 1e-14  # least curvature, relative to the greatest


def choose_greedily(responses: Responses, F: Complex[ndarray, "m c"], sources: int, starts: int) -> list[list[int]]:
    """Return indices of points of a grid, each where it lowers J most given those before.

    There are as many choices as ``starts``. The first begins with the best point, the second with the best one outside
    its lobe, and so on.
    """
    nothing = np.empty((0, len(F)), dtype=np.complex128)
    choices, firsts = [], nothing
    for _ in range(starts):
        first, a = _best(responses, F, nothing, avoided=firsts)
        firsts, A, chosen = np.vstack([firsts, a]), a[None], [first]
        while len(chosen) < sources:
            best, a = _best(responses, F, A)
            chosen.append(best)
            A = np.vstack([A, a])
        choices.append(chosen)
    return choices


def choose_replacement(
    responses: Responses, F: Complex[ndarray, "m c"], A: Complex[ndarray, "k m"], k: int
) -> tuple[int, float]:
    """Return the best point of a grid in the place of source k, given the others, and its squared correlation with k.

    A: responses of the sources, one per row.
    """
    best, a = _best(responses, F, np.delete(A, k, axis=0))
    lengths = np.vdot(a, a).real * np.vdot(A[k], A[k]).real
    return best, float(abs(np.vdot(a, A[k])) ** 2 / lengths)


def _best(
    responses: Responses,
    F: Complex[ndarray, "m c"],
    others: Complex[ndarray, "k m"],
    avoided: Complex[ndarray, "k m"] | None = None,
) -> tuple[int, Complex[ndarray, " m"]]:
    """Return the point of a grid with the greatest gain ‖F⊥ᴴa‖²/‖P⊥a‖², outside some lobes, and its response."""
    Q = orthonormalize(others[None], LEAST)[0][0]
    remaining = F - Q.T @ (Q.conj() @ F)
    best, highest, response = 0, -1.0, np.empty(0)
    for first, B in responses():
        size = squared_lengths(B)
        left = size - squared_lengths(B.conj() @ Q.T)
        explained = squared_lengths(B.conj() @ remaining)
        gain = np.divide(explained, left, out=np.zeros_like(left), where=left > LEAST * size)
        for a in () if avoided is None else avoided:
            gain[np.abs(B.conj() @ a) ** 2 > SAME_LOBE * size * np.vdot(a, a).real] = 0.0
        i = int(np.argmax(gain))
        if gain[i] > highest:
            best, highest, response = first + i, float(gain[i]), B[i]
    return best, response


class State(NamedTuple):
    """J at a point, half its gradient and half its Gauss–Newton Hessian in the units of the search."""

    J: float
    g: Float[ndarray, " n"]
    H: Float[ndarray, "n n"]
    pivot: float


def local_search(
    manifold: Manifold,
    F: Complex[ndarray, "m c"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    unit: Float[ndarray, " d"],
    start: Float[ndarray, " n"],
    fixed: int,
) -> tuple[Float[ndarray, " n"], float, Float[ndarray, "n n"], int, float]:
    """A local minimizer x, its J and H, the number of steps tried, and the least pivot of AᴴA relative to its length.

    The first ``fixed`` coordinates keep their values.
    """
    box = _Box(lower, upper, unit, len(start))
    x, z = start.copy(), box.inward(start)
    state, energy = derivatives(manifold, F, x, unit), float(np.vdot(F, F).real)
    damping, growth, steps = FIRST_DAMPING, 2.0, 0
    while steps < ITERATIONS and damping <= LAST_DAMPING:
        low, high = np.maximum(box.low - z, -LONGEST), np.minimum(box.high - z, LONGEST)
        s, predicted, limited = _step(state, low, high, damping, fixed)
        if not predicted > ENOUGH * state.J + ROUNDING * energy:
            if not limited:
                break
            damping, growth = damping * growth, 2.0 * growth
            continue
        trial = np.clip(z + s, box.low, box.high)
        moved = box.outward(trial)
        moved[:fixed] = start[:fixed]
        steps += 1
        after = derivatives(manifold, F, moved, unit)
        drop = state.J - after.J
        if not drop > 0.0:
            if predicted <= LOST * state.J:
                break
            damping, growth = damping * growth, 2.0 * growth
            continue
        x, z, state = moved, trial, after
        damping *= max(0.1, 1.0 - (2.0 * drop / predicted - 1.0) ** 3)
        growth = 2.0
        if drop <= ENOUGH * state.J:
            break
    return x, state.J, state.H, steps, state.pivot


class _Box:
    """The box of all sources in the units z of the search: angle/unit, and 1/(range·unit), whose ends change places."""

    def __init__(self, lower: ndarray, upper: ndarray, unit: ndarray, n: int) -> None:
        d = len(unit)
        self.unit, self.lower, self.upper = (np.tile(side, n // d) for side in (unit, lower, upper))
        self.is_range = np.arange(n) % d == d - 1
        self.low, self.high = np.sort([self.inward(self.lower), self.inward(self.upper)], axis=0)

    def inward(self, x: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        return np.where(self.is_range, 1 / np.where(self.is_range, x, 1.0), x) / self.unit

    def outward(self, z: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """x of z, exactly on an edge where z is."""
        scaled = z * self.unit
        x = np.where(self.is_range, 1 / np.where(self.is_range, scaled, 1.0), scaled)
        at_low, at_high = z <= self.low, z >= self.high
        x = np.where(at_low, np.where(self.is_range, self.upper, self.lower), x)
        x = np.where(at_high, np.where(self.is_range, self.lower, self.upper), x)
        return np.clip(x, self.lower, self.upper)


def derivatives(
    manifold: Manifold, F: Complex[ndarray, "m c"], x: Float[ndarray, " n"], unit: Float[ndarray, " d"]
) -> State:
    """J = ‖E‖² with E = F − AC, g = −Re(∂a_kᴴ·E·c_kᴴ) and H = Re[(DᴴP⊥D) ⊙ (CCᴴ)ᵀ] (Kaufman 1975)."""
    d = len(unit)
    theta = x.reshape(-1, d)
    a, derivatives = manifold.response_and_derivatives(theta)
    scale = np.tile(unit, (len(theta), 1))
    scale[:, -1] *= -(theta[:, -1] ** 2)  # ∂r/∂z = −r²·depth
    D = (derivatives * scale[:, :, None]).reshape(len(x), -1).T
    U, values, Vh = np.linalg.svd(a.T, full_matrices=False)
    held = values > SINGULAR * values[0]
    U, values, Vh = U[:, held], values[held], Vh[held]
    projected = U.conj().T @ F
    C = Vh.conj().T @ (projected / values[:, None])
    E = F - U @ projected
    source = np.repeat(np.arange(len(theta)), d)
    g = -np.sum(D.conj() * (E @ C.conj().T)[:, source], axis=0).real
    left = D - U @ (U.conj().T @ D)
    H = ((left.conj().T @ left) * (C @ C.conj().T)[np.ix_(source, source)].T).real
    R = np.linalg.qr(a.T / np.linalg.norm(a, axis=1)).R
    return State(float(np.vdot(E, E).real), g, H, float(np.abs(np.diag(R)).min() ** 2))


def _step(
    state: State, low: Float[ndarray, " n"], high: Float[ndarray, " n"], damping: float, fixed: int
) -> tuple[Float[ndarray, " n"], float, bool]:
    """The step s within its limits, the decrease of J that the model J + 2g·s + sᵀHs predicts, and whether it is cut.

    The first ``fixed`` coordinates are held, and those at an edge of the box from which the gradient points outwards.
    What leaves the limits is put on them, and the other coordinates are solved again given those.
    """
    g, H = state.g, state.H
    n = len(g)
    size = np.maximum(np.diag(H), FLAT * max(float(np.diag(H).max()), 1e-300))
    damped = H + np.diag(size * damping + (size - np.diag(H)))
    s, limited = np.zeros(n), False
    held = (np.arange(n) < fixed) | ((low >= 0) & (g >= 0)) | ((high <= 0) & (g <= 0))
    for _ in range(n):
        free = ~held
        if free.any():
            right = -g[free] - H[np.ix_(free, held)] @ s[held]
            s[free] = _solve(damped[np.ix_(free, free)], right)
        out = free & ~((low <= s) & (s <= high))
        if not out.any():
            break
        s[out] = np.clip(s[out], low[out], high[out])
        held, limited = held | out, True
    return s, float(-s @ (2 * g + H @ s)), limited


def _solve(H: Float[ndarray, "n n"], right: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    try:
        return np.linalg.solve(H, right)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(H, right, rcond=None)[0])


def inverse_curvature(
    manifold: Manifold,
    F: Complex[ndarray, "m c"],
    G: Complex[ndarray, "m c"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    theta: Float[ndarray, "k d"],
) -> Float[ndarray, "n n"]:
    """H(F)⁻¹·H(G)·H(F)⁻¹ in [rad, m], or H(F)⁻¹ if G has no columns; coordinates on an edge of the box are held.

    Rows and columns of held coordinates are 0. All elements are NaN if H(F) is singular or sources coincide.
    """
    free: Bool[ndarray, " n"] = ((theta > lower) & (theta < upper)).ravel()
    A = manifold.response(theta).T
    pivots = np.abs(np.diag(np.linalg.qr(A / np.linalg.norm(A, axis=0)).R)) ** 2
    C = np.zeros((theta.size, theta.size))
    if not pivots.min() > APART or not np.isfinite(G).all():
        return np.full_like(C, math.nan)
    inverse = np.linalg.pinv(A)
    J = information_root(manifold, theta, inverse @ F)[0][:, free]
    R = np.linalg.qr(J).R
    if len(R) < free.sum() or not (np.abs(np.diag(R)) > 1e-7 * np.linalg.norm(R, axis=0)).all():
        return np.full_like(C, math.nan)
    root = np.linalg.inv(R)
    H = root @ root.T
    if G.shape[1]:
        spread = information_root(manifold, theta, inverse @ G)[0][:, free] @ H
        H = spread.T @ spread
    C[np.ix_(free, free)] = H
    return C
