"""Which elements do not receive what the others receive, or do not fit them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..wavefronts import Manifold
from .eigenvalues import Spectrum, spectrum
from .goodness import Fit, fit, weighted_subspace

__all__ = ["are_mixed", "incoherent", "misfitting", "misfitting_elements", "silent_elements"]

LEVEL = 1e-3  # p-value from which the model fits
OF_NOISE = 5.0  # coherence with the others, times the number of snapshots, which noise alone hardly exceeds
WEAKLY = 0.05  # the same, relative to the median of all elements
COHERENT = 0.1  # coherence of the median element from which the elements receive the same signals
OUTLYING = 12.0  # residual of an element, relative to the median, which the largest of many rarely exceeds
BETTER = 0.25  # factor by which leaving out elements must lower the unexplained share
WEAK = 1e-4  # power of an element, relative to the median of all, from which it is weak: −40 dB
MOST = 8  # elements that are left out for their residual


def silent_elements(Y: Complex[ndarray, "m t"], names: tuple[str, ...] = ()) -> list[str]:
    """Return a sentence about elements that share no signals with the others or are far weaker, whatever the model is.

    Y: received data, shape (M, T), one row per element.
    names: names or numbers of the elements, by which they are left out; empty: the numbers of the rows.
    """
    power = np.mean(np.abs(Y) ** 2, axis=1)
    dead = np.flatnonzero(power == 0)
    weak = np.flatnonzero((power <= WEAK * np.median(power)) & (power > 0))
    others, levels = incoherent(Y)
    others = np.setdiff1d(others, [*dead, *weak])
    found = {"{receive} nothing": dead, "{are} at least 40 dB weaker than the median of all": weak}
    if len(others):
        text = (
            f"hardly {{receive}} what the others receive: the coherence (magnitude squared) with nine in ten other "
            f"elements is at most {levels[others].max():.1g}, against a median of {np.median(levels):.2g}"
        )
        found[text] = others
    clauses = [f"{_called(which, names)} {_inflected(text, len(which))}" for text, which in found.items() if len(which)]
    if not clauses:
        return []
    broken = np.sort(np.concatenate(list(found.values()))).astype(int)
    return [f"{', and '.join(clauses)}; the cable or the element may be broken: {_leave_out(broken, names)}"]


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
    if are_mixed(manifold) or np.isnan(quality.p_value):
        return []
    broken, share = misfitting(Y, seen, manifold, lower, upper, quality)
    if not len(broken):
        return []
    text = (
        f"{{do}} not fit the others: without {{them}}, the sources explain {100 * share:.4g} % in place of "
        f"{100 * quality.explained:.4g} % of the signal subspace; the position, cable or gain may be wrong"
    )
    return [f"{_called(broken, names)} {_inflected(text, len(broken))}: {_leave_out(broken, names)}"]


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


def are_mixed(manifold: Manifold) -> bool:
    """Whether a row of the data is not that of one element, such as after whitening."""
    return manifold.weights is not None and np.ndim(manifold.weights) > 1


def _without(manifold: Manifold, kept: ndarray) -> Manifold:
    weights = None if manifold.weights is None else manifold.weights[kept]
    return replace(manifold, positions=manifold.positions[kept], weights=weights)


def _called(which: ndarray, names: tuple[str, ...]) -> str:
    """Return "elements 5 and 19 (counted from 0)", or their names."""
    called = [names[m] if names else str(m) for m in which]
    listed = " and ".join(filter(None, [", ".join(called[:-1]), called[-1]]))
    counted = " (counted from 0)" if all(name.isdigit() for name in called) else ""
    return f"element{'s' * (len(called) > 1)} {listed}{counted}"


def _inflected(text: str, count: int) -> str:
    """Put the verbs of a clause in the singular or plural."""
    forms = {"receive": ("receives", "receive"), "do": ("does", "do"), "are": ("is", "are"), "them": ("it", "them")}
    return text.format(**{word: both[count > 1] for word, both in forms.items()})


def _leave_out(broken: ndarray, names: tuple[str, ...]) -> str:
    """Say how elements are left out."""
    called = [names[m] if names else str(m) for m in broken]
    numbers = all(name.isdigit() for name in called)
    table = ", ".join(called if numbers else (f'"{name}"' for name in called))
    them = "them" if len(called) > 1 else "it"
    return f"leave {them} out with failed = [{table}] (--failed {','.join(called)})"
