"""Levenberg–Marquardt in the box, in NumPy: the steps of the compiled search in ``kernels/local_search.py``."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

__all__ = ["Box", "State", "minimize"]

ITERATIONS = 100
FIRST_DAMPING, LAST_DAMPING = 1e-3, 1e12  # μ
LONGEST = 0.25  # of a step in each coordinate: in beamwidths and depths of focus
ENOUGH = 1e-15  # decrease of J, relative to J, at which the search ends
LOST = 1e-13  # predicted decrease below which J may rise by its rounding errors alone
ROUNDING = 1e-30  # decrease of J, relative to ‖F‖², below which J is only the rounding of the residual
FLAT = 1e-14  # least curvature, relative to the greatest


class State(NamedTuple):
    """J at a point, half its gradient and half its Gauss–Newton Hessian in the units of the search.

    pivot: least pivot of AᴴA, relative to M.
    """

    J: float
    g: Float[ndarray, " n"]
    H: Float[ndarray, "n n"]
    pivot: float


class Box:
    """The box of all sources in the units z of the search: angle/unit, and 1/(range·unit), whose ends change places.

    lower, upper: bounds of one source [rad, m], shape (d,).
    unit: units of the coordinates of one source: beamwidths [rad], and the depth of focus [1/m].
    n: number of coordinates of all sources.
    """

    def __init__(
        self, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], unit: Float[ndarray, " d"], n: int
    ) -> None:
        d = len(unit)
        self.unit, self.lower, self.upper = (np.tile(side, n // d) for side in (unit, lower, upper))
        self.is_range = np.arange(n) % d == d - 1
        self.low, self.high = np.sort([self.inward(self.lower), self.inward(self.upper)], axis=0)

    def inward(self, x: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """Return z of x [rad, m]."""
        return np.where(self.is_range, 1 / np.where(self.is_range, x, 1.0), x) / self.unit

    def outward(self, z: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """Return x [rad, m] of z, exactly on an edge where z is."""
        scaled = z * self.unit
        x = np.where(self.is_range, 1 / np.where(self.is_range, scaled, 1.0), scaled)
        at_low, at_high = z <= self.low, z >= self.high
        x = np.where(at_low, np.where(self.is_range, self.upper, self.lower), x)
        x = np.where(at_high, np.where(self.is_range, self.lower, self.upper), x)
        return np.clip(x, self.lower, self.upper)


def minimize(
    evaluate: Callable[[Float[ndarray, " n"]], State], box: Box, start: Float[ndarray, " n"], fixed: int, energy: float
) -> tuple[Float[ndarray, " n"], State, int]:
    """Return a local minimizer x [rad, m], its state, and the number of steps that were tried.

    evaluate: returns the state at x [rad, m], shape (n,).
    start: starting point [rad, m], shape (n,), inside the box.
    fixed: number of coordinates at the beginning of x that keep their values.
    energy: ‖F‖², which says where J is only rounding.
    """
    x, z = np.array(start, dtype=np.float64), box.inward(start)
    state = evaluate(x)
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
        after = evaluate(moved)
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
    return x, state, steps


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
    held: Bool[ndarray, " n"] = (np.arange(n) < fixed) | ((low >= 0) & (g >= 0)) | ((high <= 0) & (g <= 0))
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
