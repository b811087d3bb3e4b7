"""The search where the compiled kernels do not apply: responses of any modulus, in NumPy.

The algorithms are those of the kernels: a greedy choice on the grid, Levenberg–Marquardt on the variable projection,
and the standard errors from the curvature.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray

from ..bounds import information_root
from ..objectives.general_fit import orthonormalize, squared_lengths
from ..wavefronts import Manifold
from .levenberg_marquardt import Box, State, minimize

__all__ = ["choose_greedily", "choose_replacement", "derivatives", "inverse_curvature", "local_search"]

Responses: TypeAlias = Callable[[], Iterator[tuple[int, ndarray]]]
"""Yields the responses of a grid in blocks, one per row, each with the index of its first point."""

SAME_LOBE = 0.3  # squared correlation of two responses above which they are in one lobe
LEAST = 1e-8  # squared distance of a candidate from the span of the others, relative to its own, below which it is none
SINGULAR = 1e-8  # singular value of A, relative to the greatest, below which it is 0
APART = 1e-10  # least pivot of AᴴA from which standard errors are computed


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
    box = Box(lower, upper, unit, len(start))
    energy = float(np.vdot(F, F).real)
    x, state, steps = minimize(lambda x: derivatives(manifold, F, x, unit), box, start, fixed, energy)
    return x, state.J, state.H, steps, state.pivot


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
