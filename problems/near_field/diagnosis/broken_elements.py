"""Which elements do not receive what the others receive, or do not fit them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..wavefronts import Manifold
from .eigenvalues import Spectrum, spectrum
from .goodness import Fit, fit, weighted_subspace

__all__ = ["incoherent", "misfitting", "misfitting_elements", "silent_elements"]

LEVEL = 1e-3  # p-value from which the model fits
OF_NOISE = 5.0  # coherence with the others, times the number of snapshots, which noise alone hardly exceeds
WEAKLY = 0.05  # the same, relative to the median of all elements
COHERENT = 0.1  # coherence of the median element from which the elements receive the same signals
OUTLYING = 12.0  # residual of an element, relative to the median, which the largest of many rarely exceeds
BETTER = 0.25  # factor by which leaving out elements must lower the unexplained share
MOST = 8  # elements that are left out for their residual


def silent_elements(Y: Complex[ndarray, "m t"], manifold: Manifold, names: tuple[str, ...]) -> list[str]:
    """Return a sentence about elements that share no signals with the others, whatever the model is.

    Y: received data, shape (M, T).
    manifold: array and wavefront model.
    names: names or numbers of the elements, by which they are left out.
    """
    if _are_mixed(manifold):
        return []
    broken, levels = incoherent(Y)
    if not len(broken):
        return []
    text = (
        f"hardly {{receive}} what the others receive: the coherence with nine in ten other elements is at most "
        f"{levels[broken].max():.1g}, compared with {np.median(levels):.2g} for the median of all; the cable or the "
        f"element may be broken"
    )
    return [_sentence(broken, text, names)]


def misfitting_elements(
    Y: Complex[ndarray, "m t"],
    seen: Spectrum,
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    quality: Fit,
    names: tuple[str, ...],
) -> list[str]:
    """Return a sentence about elements without which the model fits.

    The arguments are those of ``diagnose``; ``quality`` is the fit of all elements, and ``names`` are the names or
    numbers of the elements, by which they are left out.
    """
    if _are_mixed(manifold) or np.isnan(quality.p_value):
        return []
    broken, share = misfitting(Y, seen, manifold, lower, upper, quality)
    if not len(broken):
        return []
    text = (
        f"{{do}} not fit the others: without {{them}}, the sources explain {100 * share:.4g} % in place of "
        f"{100 * quality.explained:.4g} % of the signal subspace; the position, cable or gain may be wrong"
    )
    return [_sentence(broken, text, names)]


def incoherent(Y: Complex[ndarray, "m t"]) -> tuple[ndarray, Float[ndarray, " m"]]:
    """Return the rows that share no signals with the others, and the coherence of each row with the others.

    The coherence |R_mn|²/(R_mm·R_nn) of independent rows is 1/T in the mean. That of a row is the quantile of 90 % over
    the others, so that a few rows with the same disturbance do not hide each other. Rows are returned only if most rows
    are far more coherent than noise, and if they are at most a quarter of all.
    """
    M, T = Y.shape
    power = np.linalg.norm(Y, axis=1)
    if T < 2 or M < 4:
        return np.empty(0, dtype=int), np.zeros(M)
    unit = Y / np.where(power > 0, power, 1.0)[:, None]
    coherence = np.abs(unit @ unit.conj().T) ** 2
    np.fill_diagonal(coherence, np.nan)
    levels = np.nanquantile(coherence, 0.9, axis=1)
    usual = float(np.median(levels))
    limit = max(OF_NOISE / T, WEAKLY * usual)
    found = np.flatnonzero(levels <= limit)
    clear = usual >= max(COHERENT, 3 * limit) and len(found) <= M // 4
    return (found if clear else found[:0]), levels


def misfitting(
    Y: Complex[ndarray, "m t"],
    seen: Spectrum,
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    quality: Fit,
) -> tuple[ndarray, float]:
    """Return the elements without which the model fits, and the share of the signal subspace that is explained then.

    The element with the largest residual is left out and the sources are refined, again and again, while the residual
    is outlying. There are none unless the rest fits, or the unexplained share falls to a quarter.
    """
    M, K = manifold.elements, len(quality.theta)
    kept, now, spectra = np.arange(M), quality, seen
    while len(kept) > M - min(M // 4, MOST) and not now.p_value >= LEVEL:
        residual = _residuals(manifold, kept, now, spectra)
        worst = int(np.argmax(residual))
        if residual[worst] < OUTLYING * np.median(residual) or len(kept) - 1 <= K:
            break
        kept = np.delete(kept, worst)
        spectra = spectrum(Y[kept])
        now = fit(now.theta, _without(manifold, kept), lower, upper, spectra, Y.shape[1])
    left_out = np.setdiff1d(np.arange(M), kept)
    better = now.p_value >= LEVEL or 1 - now.explained <= BETTER * (1 - quality.explained)
    return (left_out if better else left_out[:0]), now.explained


def _residuals(manifold: Manifold, kept: ndarray, found: Fit, spectra: Spectrum) -> Float[ndarray, " m"]:
    """The energy in each element of the signal subspace that the responses of a fit do not explain."""
    F = weighted_subspace(spectra, min(max(spectra.significant, 1), len(found.theta)))
    basis = np.linalg.svd(_without(manifold, kept).response(found.theta).T, full_matrices=False)[0]
    rest: ndarray = np.sum(np.abs(F - basis @ (basis.conj().T @ F)) ** 2, axis=1)
    return rest


def _are_mixed(manifold: Manifold) -> bool:
    """Whether a row of the data is not that of one element, such as after whitening."""
    return manifold.weights is not None and np.ndim(manifold.weights) > 1


def _without(manifold: Manifold, kept: ndarray) -> Manifold:
    weights = None if manifold.weights is None else manifold.weights[kept]
    return replace(manifold, positions=manifold.positions[kept], weights=weights)


def _sentence(broken: ndarray, text: str, names: tuple[str, ...]) -> str:
    """Say what is wrong with elements, and how to leave them out."""
    called = [names[m] if names else str(m) for m in broken]
    many = len(called) > 1
    numbers = all(name.isdigit() for name in called)
    verbs = {"receive": "receive" if many else "receives", "do": "do" if many else "does"}
    listed = " and ".join(filter(None, [", ".join(called[:-1]), called[-1]]))
    table = ", ".join(called if numbers else (f'"{name}"' for name in called))
    return (
        f"element{'s' * many} {listed}{' (counted from 0)' * numbers} "
        f"{text.format(**verbs, them='them' if many else 'it')}: leave {'them' if many else 'it'} out with "
        f"failed = [{table}] (--failed {','.join(called)})"
    )
