"""The arrays on which methods for uniform linear arrays work, and the sentences with which they refuse others."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Incompatible

from ..array_instance import ArrayInstance
from ..bands import one_band
from ..calibration import Knowledge, calibrated
from ..geometry import azimuth_near
from ..wavefronts import Manifold, Wavefront

__all__ = [
    "azimuth_of_sine",
    "data_of_line",
    "inverse_range_scale",
    "regress",
    "require_centre",
    "require_quarter_wave",
    "sine_interval",
    "spacing_of",
    "widest_sine",
]

TINY = 1e-18  # spread of the abscissas [m²] of a regression that is 0
EQUAL = 1e-6  # deviation from a uniform line [wavelengths] that is ignored


def data_of_line(
    instance: ArrayInstance, knows: Knowledge, name: str, title: str
) -> tuple[Complex[ndarray, "m t"], Manifold, float]:
    """Return the data, the manifold and the spacing δ of the elements along y [m], which is negative if y falls.

    Raises Incompatible if there are several frequency bins, if the scenario has elevation, if the assumed wavefront is
    plane, if responses have another modulus than 1, or if the array is not a uniform linear array along y.

    knows: the options that say what the estimator knows of the array.
    name: name of the formulation, for the sentences. title: name of the method in prose, for the sentences.
    """
    one_band(instance.bands, name, "as it works at one wavelength")
    Y, manifold = calibrated(instance, knows)[0].received
    spacing = spacing_of(manifold, title)
    if manifold.wavefront == "planar":
        raise Incompatible(
            f'wavefront: expected "exact", "fresnel" or "paper" for {title}, got "planar", which has no range'
        )
    return Y, manifold, spacing


def spacing_of(manifold: Manifold, title: str) -> float:
    """Return the spacing δ of the elements along y [m]; raises Incompatible as ``data_of_line`` does."""
    if manifold.has_elevation:
        raise Incompatible(f"elevation_deg: expected none, as {title} works in the plane only, got an interval")
    if not manifold.has_unit_modulus:
        raise Incompatible(
            f"known_gains, known_coupling, known_noise: expected phases only for {title}, which "
            "needs responses of modulus 1 in white noise, got more; leave these options out"
        )
    steps = np.diff(manifold.positions, axis=0)
    spacing = float(steps[:, 1].mean())
    if not np.allclose(steps, [0.0, spacing, 0.0], rtol=0, atol=EQUAL * manifold.wavelength_m):
        raise Incompatible(f"array: expected a uniform linear array along y for {title}, got another geometry")
    return spacing


def require_centre(manifold: Manifold, title: str) -> None:
    """Raise Incompatible unless the origin is the centre of the array."""
    if not np.allclose(manifold.positions.mean(axis=0), 0.0, rtol=0, atol=EQUAL * manifold.wavelength_m):
        raise Incompatible(
            f'array.origin: expected "center" for {title}, got another origin, for which the phases of elements '
            "m and M+1−m differ, and sinφ would be estimated as sinφ − (M−1)δ/(2r)"
        )


def require_quarter_wave(manifold: Manifold, spacing: float, sin_max: float, title: str) -> None:
    """Raise Incompatible unless |δ| < λ/(4·sinφ_max), so that exp(j2kδ·sinφ) is unambiguous in the box."""
    wavelength = manifold.wavelength_m
    if not abs(spacing) < wavelength / (4 * sin_max):
        raise Incompatible(
            f"array: expected a spacing below λ/(4·sinφ_max) = {1 / (4 * sin_max):.4g} λ for {title}, "
            f"got {abs(spacing) / wavelength:.4g} λ, for which the angles are ambiguous"
        )


def sine_interval(lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> tuple[float, float]:
    """Return the least and the largest sinφ of the azimuths in a box."""
    endfire = np.clip(np.arange(-3, 4, 2) * np.pi / 2, lower[0], upper[0])
    sines = np.sin([lower[0], upper[0], *endfire])
    return float(sines.min()), float(sines.max())


def widest_sine(lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> float:
    """Return the largest |sinφ| of the azimuths in a box."""
    return max(map(abs, sine_interval(lower, upper)))


def azimuth_of_sine(
    sines: Float[ndarray, " p"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> Float[ndarray, " p"]:
    """Return azimuths with these sines [rad], on the side of the array on which the centre of the box is."""
    front, middle = np.arcsin(np.clip(sines, -1.0, 1.0)), (lower[0] + upper[0]) / 2
    azimuth: ndarray = front if np.cos(middle) >= 0 else np.pi - front
    return azimuth_near(azimuth, middle)


def regress(t: Float[ndarray, " s"], c: Float[ndarray, " s"], weights: Float[ndarray, " s"]) -> tuple[float, float]:
    """Return the η and ξ that minimize Σ w·(t − η + c·ξ)²."""
    w = weights / weights.sum()
    dc, dt = c - w @ c, t - w @ t
    xi = -float((w * dc) @ dt / max(float((w * dc) @ dc), TINY))
    return float(w @ t + xi * (w @ c)), xi


def inverse_range_scale(wavefront: Wavefront, azimuth: Float[ndarray, "*p"]) -> Float[ndarray, "*p"]:
    """Return r·κ, where κ = cos²φ/r, or 1/r for the wavefront "paper", is twice the curvature of the phase.

    With it the advance of a wave at the element y is r − d ≈ y·sinφ − κ·y²/2.
    """
    scale: ndarray = np.ones_like(azimuth) if wavefront == "paper" else np.cos(azimuth) ** 2
    return scale
