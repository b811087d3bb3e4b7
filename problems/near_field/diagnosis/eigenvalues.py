"""Significant eigenvalues of a sample covariance: how many signals rise above white noise, and how strong it is."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.special import airy

from ..subspace import compress

__all__ = ["Spectrum", "spectrum", "tracy_widom_tail"]

LEVEL = 1e-3  # probability that an eigenvalue of pure noise counts as significant
ROUNDS = 8  # of the correction of the noise power, which converges geometrically
NOISELESS = 1e-12  # power of the noise, relative to the largest eigenvalue, below which there is none


class Spectrum(NamedTuple):
    """The eigenvalues of R̂ = Y·Yᴴ/T and what they say about signals in white noise.

    U: eigenvectors in descending order of their eigenvalues, shape (M, c) with c = min(M, T).
    eigenvalues: shape (c,).
    significant: number of eigenvalues that are larger than those of white noise.
    noise: power σ² of the noise; 0 if the data contain none, NaN if it cannot be estimated.
    """

    U: Complex[ndarray, "m c"]
    eigenvalues: Float[ndarray, " c"]
    significant: int
    noise: float


def spectrum(Y: Complex[ndarray, "m t"], level: float = LEVEL) -> Spectrum:
    """Return the eigenvalues of the data, and test them one by one, from the largest, against those of white noise.

    After k signals, eigenvalue k + 1 is significant if it exceeds σ̂²(k)·(μ + s·ξ)/T, where s is the quantile of the
    Tracy–Widom distribution at the level (Kritchman & Nadler 2009, doi:10.1109/TSP.2009.2022897; centre and scale for
    complex data by Johansson 2000), and σ̂²(k) is the mean of the other eigenvalues, corrected for the noise that the
    signals take away. The data are assumed to have independent snapshots.

    Y: received data, finite, shape (M, T).
    level: probability that an eigenvalue of pure noise counts as significant.
    """
    M, T = Y.shape
    U, values, _ = np.linalg.svd(compress(Y), full_matrices=False)
    eigenvalues = values**2 / T
    rank = int(np.sum(eigenvalues > NOISELESS * eigenvalues[0])) if eigenvalues[0] > 0 else 0
    if 2 * rank <= min(M, T) and rank < min(M, T):  # no noise: what there is counts as signal
        return Spectrum(U, eigenvalues, rank, 0.0)
    if rank < min(M, T):  # channels that are zero or depend on others, or such snapshots, do not count
        M, T = (rank, T) if M <= T else (M, rank)
    most = min(M, T) - 1
    for k in range(most):
        noise = noise_power(eigenvalues, k, M, T)
        if not tracy_widom_tail(_standardized(eigenvalues[k] / noise, M - k, T)) < level:
            return Spectrum(U, eigenvalues, k, noise)
    return Spectrum(U, eigenvalues, most, math.nan)


def noise_power(eigenvalues: Float[ndarray, " c"], k: int, M: int, T: int) -> float:
    """Return the power of white noise if the k largest eigenvalues belong to signals.

    The mean of the others is too small, because each signal takes noise with it: λ̂ = (ℓ + σ²)(1 + (M − k)/T·σ²/ℓ) for a
    signal of power ℓ in its direction (Kritchman & Nadler 2009, equation 23), so that the sum of the others lacks the
    second term for each signal.
    """
    rest = float(eigenvalues[k:].sum())
    noise = rest / (M - k)
    c = (M - k) / T
    for _ in range(ROUNDS):
        # ℓ + σ² solves x² − (λ̂ + σ² − cσ²)·x + λ̂σ² = 0
        b = eigenvalues[:k] + noise * (1 - c)
        x = (b + np.sqrt(np.maximum(b * b - 4 * eigenvalues[:k] * noise, 0.0))) / 2
        noise = (rest + float(np.sum(eigenvalues[:k] - x))) / (M - k)
    return noise


def _standardized(ratio: float, n: int, T: int) -> float:
    """Centre and scale the largest eigenvalue of white noise, divided by its power, in n dimensions and T snapshots."""
    centre = (math.sqrt(n) + math.sqrt(T)) ** 2
    scale = (math.sqrt(n) + math.sqrt(T)) * (1 / math.sqrt(n) + 1 / math.sqrt(T)) ** (1 / 3)
    return (ratio * T - centre) / scale


def tracy_widom_tail(s: float) -> float:
    """Return the probability that a variable with the Tracy–Widom distribution of complex data (β = 2) exceeds s.

    F₂(s) = det(I − K) on (s, ∞) with the Airy kernel K, by Gauss–Legendre quadrature (Bornemann 2010,
    doi:10.1090/S0025-5718-09-02280-7).
    """
    if not -8.0 < s < 12.0:
        return 1.0 if s <= -8.0 else 0.0
    nodes, weights = _rule()
    x = s + (1 + nodes) / 2 * 16.0  # the kernel vanishes beyond
    root = np.sqrt(weights * 8.0)
    ai, slope, _, _ = airy(x)
    difference = x[:, None] - x
    np.fill_diagonal(difference, 1.0)
    K = (ai[:, None] * slope - slope[:, None] * ai) / difference
    np.fill_diagonal(K, slope**2 - x * ai**2)
    return float(np.clip(1 - np.linalg.det(np.eye(len(x)) - root[:, None] * K * root), 0.0, 1.0))


@lru_cache(maxsize=1)
def _rule() -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    return np.polynomial.legendre.leggauss(40)
