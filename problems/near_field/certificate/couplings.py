"""Bounds of the inner products of responses of different regions, and of their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .balls import BallBounds, Charted

__all__ = ["Couplings", "couplings", "gram_limits"]


class Couplings(NamedTuple):
    """Suprema over the balls of sources j and k, along unit directions, (K, K) each; 0 on the diagonal.

    value: |â_jᴴâ_k|. first: |â_jᴴâ_k'|. second: |â_jᴴâ_k''|. mixed: |â_j'ᴴâ_k'|. change: of â_jᴴâ_k from its value at
    the centres.
    """

    value: Float[ndarray, "k k"]
    first: Float[ndarray, "k k"]
    second: Float[ndarray, "k k"]
    mixed: Float[ndarray, "k k"]
    change: Float[ndarray, "k k"]


def couplings(
    pieces: Charted, rho: Float[ndarray, " b"], bounds: BallBounds, first: list[int], centres: Charted
) -> Couplings:
    """Return the bounds by Taylor's formula about the centres of b balls, up to derivatives of order two in total.

    pieces, rho, bounds: the balls that cover those of the sources. first: the first of each source. centres: the
    sources themselves.
    """
    a, d1, d2 = pieces.a, pieces.first, pieces.second
    B, d, M = d1.shape
    d1, d2 = d1.reshape(B * d, M), d2.reshape(B * d * d, M)
    zero = a.conj() @ a.T
    one = np.linalg.norm((a.conj() @ d1.T).reshape(B, B, d), axis=-1)  # ‖âᴴ_j ∂â_k‖
    two = np.linalg.norm((a.conj() @ d2.T).reshape(B, B, d * d), axis=-1)
    both = np.linalg.norm((d1.conj() @ d1.T).reshape(B, d, B, d).swapaxes(1, 2).reshape(B, B, d * d), axis=-1)
    rj, rk = rho[:, None], rho
    n1j, n2j, n3j = (n[:, None] for n in (bounds.n1, bounds.n2, bounds.n3))
    n1k, n2k, n3k = bounds.n1, bounds.n2, bounds.n3
    change = rk * one + rj * one.T + rk**2 / 2 * two + rj**2 / 2 * two.T + rj * rk * both
    change += (rj**3 * n3j + 3 * rj**2 * rk * n2j * n1k + 3 * rj * rk**2 * n1j * n2k + rk**3 * n3k) / 6
    by_one = one + rk * two + rj * both + (rk**2 * n3k + 2 * rj * rk * n1j * n2k + rj**2 * n2j * n1k) / 2
    by_two = two + rk * n3k + rj * n1j * n2k
    by_both = both + rj * n2j * n1k + rk * n1j * n2k
    owner = np.repeat(np.arange(len(first)), np.diff([*first, B]))
    moved = np.abs(zero - (centres.a.conj() @ centres.a.T)[np.ix_(owner, owner)]) + change
    others = 1 - np.eye(len(first))
    return Couplings(
        _largest(np.minimum(np.abs(zero) + change, 1.0), first) * others,
        _largest(np.minimum(by_one, n1k), first) * others,
        _largest(np.minimum(by_two, n2k), first) * others,
        _largest(np.minimum(by_both, n1j * n1k), first) * others,
        _largest(moved, first) * others,
    )


def gram_limits(centres: Charted, found: Couplings) -> tuple[float, float]:
    """Return bounds of the smallest and the largest eigenvalue of G = ÂᴴÂ on the product of the balls."""
    coupled = float(np.linalg.eigvalsh((found.value + found.value.T) / 2)[-1])  # |xᴴ(G − 1)x| <= |x|ᵀ·value·|x|
    values = np.linalg.eigvalsh(centres.a.conj() @ centres.a.T)
    moved = float(np.linalg.eigvalsh((found.change + found.change.T) / 2)[-1])
    return max(1 - coupled, values[0] - moved), min(1 + coupled, values[-1] + moved)


def _largest(x: Float[ndarray, "b b"], first: list[int]) -> Float[ndarray, "k k"]:
    largest: ndarray = np.maximum.reduceat(np.maximum.reduceat(x, first, axis=0), first, axis=1)
    return largest
