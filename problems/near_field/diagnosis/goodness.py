"""How well estimated sources explain the data: the test of weighted subspace fitting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.special import fdtrc

from ..bands import Band
from ..search import BandFit, search_bands_locally, search_locally
from ..wavefronts import Manifold
from .eigenvalues import Spectrum

__all__ = ["Fit", "Seen", "explained_share", "fit", "fit_bins", "misfit", "source_covariance", "weighted_subspace"]


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


class Seen(NamedTuple):
    """What is seen in one frequency bin.

    manifold: array and wavefront model at the wavelength of the bin.
    spectrum: eigenvalues of the data.
    snapshots: number T of snapshots.
    """

    manifold: Manifold
    spectrum: Spectrum
    snapshots: int


def fit(
    theta: Float[ndarray, "k d"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    spectrum: Spectrum,
    snapshots: int,
) -> Fit:
    """Refine an estimate by WSF in one frequency bin, and test the misfit that remains; see ``fit_bins``."""
    return fit_bins(theta, [Seen(manifold, spectrum, snapshots)], lower, upper)


def fit_bins(
    theta: Float[ndarray, "k d"],
    bins: Sequence[Seen],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> Fit:
    """Refine an estimate by WSF, and test the misfit that remains.

    Under the model, with white noise and independent snapshots, 2T/σ²·V of the minimal misfit V of WSF is distributed
    as χ² with n = 2K'(M − K) − Kd degrees of freedom, where K' is the number of significant eigenvalues, at most K
    (Ottersten, Viberg, Stoica & Nehorai 1993, doi:10.1007/978-3-662-02938-8_4, for T → ∞ with fixed M). As σ² is
    estimated with 2(M − K)(T − K) degrees of freedom, an F distribution takes the place of χ², which matters for few
    elements and snapshots. A coordinate on an edge of the box is not counted as free. The p-value is NaN if the data
    contain no noise or no significant eigenvalue, or if no degree of freedom is left.

    The data of several bins are independent and have the positions in common: 2T/σ²·V and the degrees of freedom are
    added, but Kd is subtracted once. The share of the signal subspace is the mean over the bins.

    theta: estimated sources [rad, m], shape (K, d).
    bins: what is seen in each bin.
    lower, upper: bounds of one source [rad, m], shape (d,).
    """
    K = len(theta)
    inside = np.clip(theta, lower, upper).ravel()
    ranks = [min(max(seen.spectrum.significant, 1), K) for seen in bins]
    factors = [weighted_subspace(seen.spectrum, rank) for seen, rank in zip(bins, ranks, strict=True)]
    is_testable = all(seen.spectrum.noise > 0 and seen.spectrum.significant for seen in bins)
    if len(bins) == 1:
        found = search_locally(factors[0], bins[0].manifold, lower, upper, inside)
        statistic = 2 * bins[0].snapshots / bins[0].spectrum.noise * found.value if is_testable else math.nan
    else:
        scales = [2 * seen.snapshots / seen.spectrum.noise if is_testable else 1.0 for seen in bins]
        scaled = [
            BandFit(F * math.sqrt(scale), seen.manifold) for F, scale, seen in zip(factors, scales, bins, strict=True)
        ]
        found = search_bands_locally(scaled, lower, upper, inside)
        statistic = found.value if is_testable else math.nan
    refined = found.x.reshape(theta.shape)
    free = int(((refined > lower) & (refined < upper)).sum())
    freedom = sum(2 * rank * (seen.manifold.elements - K) for rank, seen in zip(ranks, bins, strict=True)) - free
    of_noise = sum(2 * (seen.manifold.elements - K) * (seen.snapshots - K) for seen in bins)
    p_value = math.nan
    if freedom > 0 and of_noise > 0 and is_testable:
        p_value = float(fdtrc(freedom, of_noise, statistic / freedom))
    shares = [
        explained_share(seen.manifold.response(refined), seen.spectrum.U[:, :rank])
        for seen, rank in zip(bins, ranks, strict=True)
    ]
    return Fit(refined, float(np.mean(shares)), p_value)


def explained_share(A: Complex[ndarray, "k m"], U_s: Complex[ndarray, "m r"]) -> float:
    """Return tr(U_sᴴ·P_A·U_s)/r for responses A, one per row: the share of a subspace that lies in their span."""
    basis = np.linalg.svd(A.T, full_matrices=False)[0]
    return float(np.linalg.norm(basis.conj().T @ U_s) ** 2 / U_s.shape[1])


def misfit(theta: Float[ndarray, "k d"], bands: Sequence[Band]) -> float:
    """Return Σ_f ‖(I − P_A)Y‖²/Σ_f ‖Y‖² of sources: the share of the energy that they do not explain."""
    rest = energy = 0.0
    for band in bands:
        basis = np.linalg.svd(band.manifold.response(theta).T, full_matrices=False)[0]
        residual = band.Y - basis @ (basis.conj().T @ band.Y)
        rest += float(np.vdot(residual, residual).real)
        energy += float(np.vdot(band.Y, band.Y).real)
    return rest / energy


def source_covariance(A: Complex[ndarray, "k m"], spectrum: Spectrum, noise: float) -> Complex[ndarray, "k k"]:
    """Return the covariance of the signals, A⁺(R̂ − σ²I)A⁺ᴴ, for responses A, one per row."""
    inverse = np.linalg.pinv(A.T)
    half = inverse @ (spectrum.U * np.sqrt(spectrum.eigenvalues))
    P: ndarray = half @ half.conj().T - noise * (inverse @ inverse.conj().T)
    return P
