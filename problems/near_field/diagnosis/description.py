"""What an estimate says about the sources, in the coordinates in which the user describes the array."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import solve_triangular

from nfbench import Localization, Picture

from ..bands import Band
from ..bounds import information_root
from ..geometry import Frame, cartesian, direction_derivatives, directions
from ..wavefronts import Manifold
from .alternatives import OTHER_UNIT
from .diagnose import diagnose
from .eigenvalues import Spectrum
from .goodness import misfit, source_covariance
from .mirror import mirror_notes
from .reading import Reading

__all__ = ["describe_sources"]

CERTAIN = 100  # factor by which a pivot of the information must exceed its rounding error
BOX_POINTS = 25  # along each edge of the box in a picture


def describe_sources(
    bands: Sequence[Band],
    frame: Frame,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    sources: int,
    theta: Float[ndarray, "k d"],
    truth: Float[ndarray, "n d"] | None = None,
    reading: Reading | None = None,
) -> Localization:
    """Return positions, standard errors, goodness of fit and warnings of an estimate.

    Each source has x_m, y_m, z_m in the user's coordinates, azimuth_deg, elevation_deg (in 3D) and range_m, the
    standard error of each with the prefix std_, and snr_db, its power at an element relative to the noise. Standard
    errors are those of the stochastic Cramér–Rao bound at the estimate with the estimated powers; those of a source on
    an edge of the box are NaN. Several frequency bins have the positions in common: their information is added, and the
    signal-to-noise ratio is the mean of theirs.

    The fit has misfit, the share of the energy that the estimate does not explain; explained, the share of the signal
    subspace that it explains; p_value of the goodness of fit; noise_power, in the units of the data;
    significant_eigenvalues; sources, elements, snapshots, and wavelength_m. With several bins, noise_power is the mean
    over them, significant_eigenvalues and snapshots are those of the first, wavelength_m is its wavelength, and bins is
    their number.

    bands: data (M, T), array and wavefront model of each frequency bin.
    frame: coordinates in which the user describes the array.
    lower, upper: bounds of one source [rad, m], shape (d,).
    sources: number K of sources that were searched for.
    theta: estimated sources [rad, m], shape (K̂, d).
    truth: true sources [rad, m]; None: not known.
    reading: how the data were read; None: nothing is known about it.
    """
    diagnosis = diagnose(bands, frame, lower, upper, sources, theta, reading or Reading())
    powers, C = _uncertainty(bands, theta, diagnosis.spectra)
    C[(~_inside(theta, lower, upper)).repeat(theta.shape[1])] = math.nan
    rows, covariances = _sources(frame, theta, powers, C)
    seen, manifold = diagnosis.spectra, bands[0].manifold
    fit = {
        "misfit": misfit(theta, bands) if seen and len(theta) else math.nan,
        "explained": diagnosis.fit.explained if diagnosis.fit else math.nan,
        "p_value": diagnosis.fit.p_value if diagnosis.fit else math.nan,
        "noise_power": float(np.mean([own.noise for own in seen])) if seen else math.nan,
        "significant_eigenvalues": float(seen[0].significant) if seen else math.nan,
        "sources": float(len(theta)),
        "elements": float(bands[0].Y.shape[0]),
        "snapshots": float(bands[0].Y.shape[1]),
        "wavelength_m": manifold.wavelength_m,
    }
    if len(bands) > 1:
        fit["bins"] = float(len(bands))
    picture = _picture(manifold, frame, _edges(lower, upper), theta, covariances, truth)
    notes = mirror_notes(theta, manifold, frame, lower, upper)
    replaces = {OTHER_UNIT: "array: its", "element": "data: element"}  # guesses, and what is said again
    found = [old for new, old in replaces.items() if any(text.startswith(new) for text in diagnosis.warnings)]
    return Localization(rows, fit, diagnosis.warnings, picture, tuple(notes), replaces=tuple(found))


def _uncertainty(
    bands: Sequence[Band], theta: Float[ndarray, "k d"], spectra: Sequence[Spectrum]
) -> tuple[Float[ndarray, " k"], Float[ndarray, "kd kd"]]:
    """Return the signal-to-noise ratios and the bound on the covariance [rad, m]; NaN where they are not known."""
    K, d = theta.shape
    unknown = np.full(K, math.nan), np.full((K * d, K * d), math.nan)
    if not spectra or not all(seen.noise > 0 for seen in spectra) or not 0 < K < bands[0].manifold.elements:
        return unknown
    ratios, information = [], []
    for band, seen in zip(bands, spectra, strict=True):
        A = band.manifold.response(theta)
        P = source_covariance(A, seen, seen.noise) / seen.noise
        ratios.append(np.diag(P).real * np.mean(np.abs(A) ** 2, axis=1))
        information.append(_information(band.manifold, theta, P))
    power = np.mean(ratios, axis=0)
    return np.where(power > 0, power, math.nan), _bound(information, [band.Y.shape[1] for band in bands])


def _information(
    manifold: Manifold, theta: Float[ndarray, "k d"], P: Complex[ndarray, "k k"]
) -> tuple[Float[ndarray, "rows kd"], Float[ndarray, " kd"]]:
    """Return J and its rounding errors, where JᵀJ is the information of a snapshot with signals of covariance P.

    The noise has the power 1. X = PAᴴR⁻¹AP with R = APAᴴ + I, as in ``bounds.stochastic_bound``, but for signals that
    may be correlated.
    """
    values, vectors = np.linalg.eigh(P)
    B = vectors * np.sqrt(np.maximum(values, 0.0))
    _, s, Vh = np.linalg.svd(manifold.response(theta).T @ B, full_matrices=False)
    return information_root(manifold, theta, B @ Vh.conj().T * (s / np.sqrt(1 + s * s)))


def _bound(
    information: Sequence[tuple[Float[ndarray, "rows n"], Float[ndarray, " n"]]], snapshots: Sequence[int]
) -> Float[ndarray, "n n"]:
    """Return the stochastic bound from the information of all bins; NaN if it is not finite."""
    J = np.vstack([math.sqrt(2 * T) * root for T, (root, _) in zip(snapshots, information, strict=True)])
    rounding = np.linalg.norm(
        [math.sqrt(2 * T) * error for T, (_, error) in zip(snapshots, information, strict=True)], axis=0
    )
    R, n = np.linalg.qr(J).R, J.shape[1]
    if len(R) < n or not (np.abs(np.diag(R)) > CERTAIN * rounding).all():
        return np.full((n, n), math.nan)
    inverse = solve_triangular(R, np.eye(n))
    C: ndarray = inverse @ inverse.T
    return C


def _picture(
    manifold: Manifold,
    frame: Frame,
    edges: list[Float[ndarray, "points 3"]],
    theta: Float[ndarray, "k d"],
    covariances: Float[ndarray, "k 3 3"],
    truth: Float[ndarray, "n d"] | None,
) -> Picture:
    return Picture(
        elements=frame.outward(manifold.positions),
        box=tuple(frame.outward(line) for line in edges),
        sources=frame.outward(cartesian(theta)),
        covariances=covariances,
        truth=None if truth is None else frame.outward(cartesian(truth)),
        distances=_distances(manifold),
        origin=frame.origin,
    )


def _distances(manifold: Manifold) -> tuple[tuple[str, float], ...]:
    """The Fresnel and the Fraunhofer distance 0.62·√(D³/λ) and 2D²/λ [m] of the diameter D of the array."""
    Q, wavelength = manifold.positions, manifold.wavelength_m
    D = 2 * float(np.linalg.norm(Q - Q.mean(axis=0), axis=1).max())
    return ("Fresnel distance", 0.62 * math.sqrt(D**3 / wavelength)), ("Fraunhofer distance", 2 * D**2 / wavelength)


def _inside(theta: Float[ndarray, "k d"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> ndarray:
    """Whether an estimate lies inside the box, and not on its edge."""
    margin = 1e-9 * (upper - lower)
    return ((theta > lower + margin) & (theta < upper - margin)).all(axis=1)


def _sources(
    frame: Frame, theta: Float[ndarray, "k d"], snr: Float[ndarray, " k"], C: Float[ndarray, "kd kd"]
) -> tuple[tuple[dict[str, float], ...], Float[ndarray, "k 3 3"]]:
    """Return the table of each source, and the covariances of their positions [m²] in the user's coordinates."""
    K, d = theta.shape
    places, r = frame.outward(cartesian(theta)), theta[:, -1]
    slopes = np.empty((K, d, 3))  # of the position with respect to the parameters
    slopes[:, :-1] = r[:, None, None] * direction_derivatives(theta)
    slopes[:, -1] = directions(theta)
    own = C.reshape(K, d, K, d)[np.arange(K), :, np.arange(K)]
    covariances = np.einsum("kix,kij,kjy->kxy", slopes @ frame.axes, own, slopes @ frame.axes)
    rows = []
    for k in range(K):
        spherical = {"azimuth_deg": math.degrees(theta[k, 0])}
        if d == 3:
            spherical["elevation_deg"] = math.degrees(theta[k, 1])
        spherical["range_m"] = float(r[k])
        std = np.sqrt(np.diag(own[k])) * np.where(np.arange(d) < d - 1, 180 / math.pi, 1.0)
        xyz, std_xyz = places[k], np.sqrt(np.maximum(np.diag(covariances[k]), 0.0))
        row = dict(zip(("x_m", "y_m", "z_m"), map(float, xyz), strict=True)) | spherical
        row |= dict(zip(("std_x_m", "std_y_m", "std_z_m"), map(float, std_xyz), strict=True))
        row |= {f"std_{name}": float(value) for name, value in zip(spherical, std, strict=True)}
        rows.append(row | {"snr_db": float(10 * np.log10(snr[k]))})
    return tuple(rows), covariances


def _edges(lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> list[Float[ndarray, "points 3"]]:
    """Return lines along the edges of the box, and in 3D through the middle of its sides."""
    d, fraction = len(lower), np.linspace(0.0, 1.0, BOX_POINTS)
    lines = []
    for i in range(d):
        for corner in np.ndindex(*[2] * (d - 1)):
            ends = list(corner)
            ends.insert(i, 0)
            line = np.repeat(np.where(np.array(ends) == 0, lower, upper)[None], BOX_POINTS, axis=0)
            line[:, i] = lower[i] + fraction * (upper[i] - lower[i])
            lines.append(cartesian(line))
    if d == 3:  # the outline of the box seen along an axis
        middle = np.array([np.mean([lower[0], upper[0]]), np.clip(0.0, lower[1], upper[1]), 0.0])
        for r in (lower[2], upper[2]):
            for i in (0, 1):
                line = np.repeat(middle[None], BOX_POINTS, axis=0)
                line[:, i], line[:, 2] = lower[i] + fraction * (upper[i] - lower[i]), r
                lines.append(cartesian(line))
    return lines
