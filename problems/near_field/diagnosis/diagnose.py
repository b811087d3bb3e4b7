"""Everything that may be wrong with data, a model and an estimate, in sentences that name the remedy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from jaxtyping import Complex, Float
from numpy import ndarray

from ..bands import Band
from ..geometry import Frame
from ..wavefronts import Manifold
from .alternatives import better_alternative, search_share
from .box_checks import alias_warnings, coincidence_warnings, edge_warnings, side_warnings
from .broken_elements import are_mixed, misfitting_elements, silent_elements
from .data_checks import data_warnings
from .eigenvalues import Spectrum, spectrum
from .goodness import Fit, Seen, fit_bins
from .reading import Reading

__all__ = ["Diagnosis", "diagnose"]

LEVEL = 1e-3  # p-value below which the model does not fit
NEARLY_ALL = 0.9  # share of the signal subspace from which no other reading of the data is searched
MISSED = 0.8  # factor by which a search must lower the unexplained share to show that the estimate is not the best

REASONS = (
    "; possible reasons are reflections, uncalibrated gains and phases (calibrate the elements), wrong positions, "
    "another speed of the waves, or another wavefront"
)

NOTHING_KNOWN = Reading()


class Diagnosis(NamedTuple):
    """What is known about an estimate.

    spectra: eigenvalues of the data of each frequency bin; none if data are not finite or all zero.
    fit: how well the estimate explains the data; None without an estimate.
    warnings: sentences about what may be wrong, each with a remedy.
    """

    spectra: tuple[Spectrum, ...]
    fit: Fit | None
    warnings: tuple[str, ...]


def diagnose(
    bands: Sequence[Band],
    frame: Frame,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    sources: int,
    theta: Float[ndarray, "k d"],
    reading: Reading = NOTHING_KNOWN,
) -> Diagnosis:
    """Return what the data say about an estimate, and what may be wrong.

    The model is tested at the level 0.001. Other readings of the data, such as the opposite phase convention, are
    searched only if the model does not fit, so that a correct model is rarely doubted. The fit is that to the data of
    all frequency bins together. Everything else is looked for in the first bin, and places that only one frequency
    confuses are not named if there are more.

    bands: data (M, T), array and wavefront model of each frequency bin.
    frame: coordinates in which the user describes the array.
    lower, upper: bounds of one source [rad, m], shape (d,).
    sources: number K of sources that were searched for.
    theta: estimated sources [rad, m], shape (K̂, d); may be empty.
    reading: how the data were read.
    """
    checked = [data_warnings(band.Y) for band in bands]
    found = next((each for each in checked if each), checked[0])
    if found and ("NaN" in found[0] or "all zero" in found[0]):
        return Diagnosis((), None, tuple(found))
    spectra = tuple(spectrum(band.Y) for band in bands)
    Y, manifold, seen, T = bands[0].Y, bands[0].manifold, spectra[0], bands[0].Y.shape[1]
    K = len(theta)
    together = [Seen(band.manifold, own, band.Y.shape[1]) for band, own in zip(bands, spectra, strict=True)]
    quality = fit_bins(theta, together, lower, upper) if 0 < K < manifold.elements else None
    cause = None
    if (quality is None or not quality.p_value >= LEVEL) and seen.significant and manifold.elements > (K or sources):
        own = quality if quality is None or len(bands) == 1 else fit_bins(theta, together[:1], lower, upper)
        misfit, cause = _misfit(Y, seen, manifold, frame, lower, upper, K or sources, own, reading)
        found += misfit + _test(quality, cause)
    if cause is None:  # otherwise the following would be its symptoms
        places, coinciding = _places(theta, manifold, lower, upper, len(bands) > 1)
        found += _counts(seen, K or sources, T, coinciding, reading.short_blocks) + places
    return Diagnosis(spectra, quality, tuple(found))


def _places(
    theta: Float[ndarray, "k d"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    is_wideband: bool,
) -> tuple[list[str], bool]:
    """Say what is questionable about the positions of the estimates and the box, and whether estimates coincide.

    is_wideband: whether there are more bins, at whose frequencies the aliases are elsewhere.
    """
    both_sides = side_warnings(manifold, lower, upper)
    if not len(theta):
        return both_sides, False
    same = coincidence_warnings(theta, manifold)
    found = same + edge_warnings(theta, lower, upper) + both_sides
    aliases = [] if both_sides or is_wideband else alias_warnings(theta, manifold, lower, upper)
    return found + aliases, bool(same)


def _counts(seen: Spectrum, K: int, T: int, coinciding: bool, short_blocks: tuple[str, bool] | None) -> list[str]:
    """Compare the number of significant eigenvalues with the number of sources.

    coinciding: whether estimates coincide, so that more sources do not explain more.
    short_blocks: why one source may seem to be several, and whether that is likely.
    """
    n = seen.significant
    if T == 1:
        return [
            "one snapshot shows neither the number of sources nor the noise, so that neither is tested and nothing "
            "has a standard error; take more snapshots, or use the objective dml for several sources "
            "(--option objective=dml)"
        ]
    if n == 0:
        return [
            "no eigenvalue of the data rises above white noise: they show no source; check the frequency, or take more "
            "snapshots"
        ]
    if n < K:
        rises = "eigenvalue rises" if n == 1 else "eigenvalues rise"
        return [
            f"only {n} {rises} above the noise, but {K} sources are searched: some are coherent, too weak, or not "
            f"there; set sources = {n} (--sources {n}), or, for coherent sources, the objective dml "
            f"(--option objective=dml)"
        ]
    if n > K and seen.noise > 0:
        searched = f"{K} sources are" if K > 1 else "1 source is"
        text = f"{n} eigenvalues rise above white noise, but {searched} searched: "
        if short_blocks and (short_blocks[1] or coinciding):
            return [f"{text}{short_blocks[0]}"]
        text += "there are more sources, reflections or coloured noise; "
        more = "" if coinciding else f"try sources = {K + 1} (--sources {K + 1}), or "
        return [f"{text}{more}give the covariance of the noise{f'; or {short_blocks[0]}' if short_blocks else ''}"]
    return []


def _other_data(reading: Reading) -> list[tuple[tuple[str, str], Spectrum]]:
    """Other readings of the data themselves: what fits better, and the remedy, with the eigenvalues."""
    if reading.transposed is None:
        return []
    Y, axis = reading.transposed
    text = "the data are probably transposed: they fit far better with their axes exchanged"
    return [((text, f"set element_axis = {axis} (--element-axis {axis})"), spectrum(Y))]


def _misfit(
    Y: Complex[ndarray, "m t"],
    seen: Spectrum,
    manifold: Manifold,
    frame: Frame,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    K: int,
    quality: Fit | None,
    reading: Reading,
) -> tuple[list[str], str | None]:
    """Say whether another reading of the data or another estimate fits far better.

    The second result is the sentence about broken elements or another reading; None if there is none.
    """
    explained = quality.explained if quality else 0.0
    best = search_share(seen, manifold, lower, upper, K) if explained < NEARLY_ALL else None
    known = max(explained, best or 0.0)
    found = [] if are_mixed(manifold) else silent_elements(Y, reading.elements)
    if known < NEARLY_ALL and not found:
        other = better_alternative(seen, manifold, frame, lower, upper, K, known, _other_data(reading))
        found = [other] if other else []
    if quality and not found and not quality.p_value >= LEVEL:
        found = misfitting_elements(Y, seen, manifold, lower, upper, quality, reading.elements)
    cause = found[0] if found else None
    if quality and best is not None and 1 - best < MISSED * (1 - explained):
        found.append(
            f"the estimate is not the best fit: a search on a grid explains {100 * best:.0f} % of the signal subspace, "
            f"the estimate {100 * explained:.0f} %; use the method grid-refine (--method grid-refine), or more "
            f"evaluations"
        )
    return found, cause


def _test(quality: Fit | None, cause: str | None) -> list[str]:
    """Say how badly the model fits, and why that may be, if no cause was found."""
    if quality is None or math.isnan(quality.p_value):
        return []
    chance = f"p = {quality.p_value:.1g}" if quality.p_value > 0 else "p < 1e-300"
    return [
        f"the model does not fit: it explains {100 * quality.explained:.3g} % of the signal subspace, and the rest is "
        f"more than noise ({chance}), so that the standard errors are too small{'' if cause else REASONS}"
    ]
