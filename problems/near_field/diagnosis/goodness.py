"""How well estimated sources explain the data: the test of weighted subspace fitting."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.special import fdtrc

from ..search import search_locally
from ..wavefronts import Manifold
from .eigenvalues import Spectrum

__all__ = ["Fit", "explained_share", "fit", "misfit", "source_covariance", "weighted_subspace"]


class Fit(NamedTuple):
    """How well K sources explain the data.

    theta: minimizer of the misfit of weighted subspace fitting (WSF) next to the estimate [rad, m], shape (K, d).
    explained: share of the signal subspace that lies in the span of the responses, from 0 to 1.
    p_value: probability that the misfit of WSF is at least as large if the model is right; NaN if it is not known.
    """

    theta: Float[ndarray, "k d"]
    explained: float
    p_value: float


def weighted_subspace(spectrum: Spectrum, rank: int) -> Complex[ndarray, "m r"]:
    """Return the factor of WSF, U_s·diag((λ_i − σ²)/√λ_i), from the largest ``rank`` eigenvalues (SPEC of WSF)."""
    eigenvalues = spectrum.eigenvalues[:rank]
    noise = 0.0 if math.isnan(spectrum.noise) else spectrum.noise
    weights = np.maximum(eigenvalues - noise, 0.0) / np.sqrt(np.maximum(eigenvalues, np.finfo(float).tiny))
    return spectrum.U[:, :rank] * weights


def fit(
    theta: Float[ndarray, "k d"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    spectrum: Spectrum,
    snapshots: int,
) -> Fit:
    """Refine an estimate by WSF, and test the misfit that remains.

    Under the model, with white noise and independent snapshots, 2T/σ²·V of the minimal misfit V of WSF is distributed
    as χ² with n = 2K'(M − K) − Kd degrees of freedom, where K' is the number of significant eigenvalues, at most K
    (Ottersten, Viberg, Stoica & Nehorai 1993, doi:10.1007/978-3-662-02938-8_4, for T → ∞ with fixed M). As σ² is
    estimated with 2(M − K)(T − K) degrees of freedom, an F distribution takes the place of χ², which matters for few
    elements and snapshots. A coordinate on an edge of the box is not counted as free. The p-value is NaN if the data
    contain no noise or no significant eigenvalue, or if no degree of freedom is left.

    theta: estimated sources [rad, m], shape (K, d).
    manifold: array and wavefront model.
    lower, upper: bounds of one source [rad, m], shape (d,).
    spectrum: eigenvalues of the data.
    snapshots: number T of snapshots.
    """
    K, d = theta.shape
    M = manifold.elements
    rank = min(max(spectrum.significant, 1), K)
    F = weighted_subspace(spectrum, rank)
    inside = np.clip(theta, lower, upper)
    found = search_locally(F, manifold, lower, upper, inside.ravel())
    refined = found.x.reshape(K, d)
    free = int(((refined > lower) & (refined < upper)).sum())
    freedom, of_noise = 2 * rank * (M - K) - free, 2 * (M - K) * (snapshots - K)
    p_value = math.nan
    if freedom > 0 and of_noise > 0 and spectrum.noise > 0 and spectrum.significant:
        statistic = 2 * snapshots / spectrum.noise * found.value
        p_value = float(fdtrc(freedom, of_noise, statistic / freedom))
    return Fit(refined, explained_share(manifold.response(refined), spectrum.U[:, :rank]), p_value)


def explained_share(A: Complex[ndarray, "k m"], U_s: Complex[ndarray, "m r"]) -> float:
    """Return tr(U_sᴴ·P_A·U_s)/r for responses A, one per row: the share of a subspace that lies in their span."""
    basis = np.linalg.svd(A.T, full_matrices=False)[0]
    return float(np.linalg.norm(basis.conj().T @ U_s) ** 2 / U_s.shape[1])


def misfit(A: Complex[ndarray, "k m"], Y: Complex[ndarray, "m t"]) -> float:
    """Return ‖(I − P_A)Y‖²/‖Y‖² for responses A, one per row: the share of the energy that they do not explain."""
    basis = np.linalg.svd(A.T, full_matrices=False)[0]
    residual = Y - basis @ (basis.conj().T @ Y)
    return float(np.vdot(residual, residual).real / np.vdot(Y, Y).real)


def source_covariance(A: Complex[ndarray, "k m"], spectrum: Spectrum, noise: float) -> Complex[ndarray, "k k"]:
    """Return the covariance of the signals, A⁺(R̂ − σ²I)A⁺ᴴ, for responses A, one per row."""
    inverse = np.linalg.pinv(A.T)
    half = inverse @ (spectrum.U * np.sqrt(spectrum.eigenvalues))
    P: ndarray = half @ half.conj().T - noise * (inverse @ inverse.conj().T)
    return P
