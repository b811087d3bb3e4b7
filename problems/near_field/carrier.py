"""The wavelength, given as such or as a frequency with the speed of the waves."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from nfbench import Ge, Le

__all__ = ["Frequency", "Speed", "Wavelength", "carrier_problems", "carrier_wavelength"]

SHORTEST, LONGEST = 1e-9, 1e9  # wavelengths [m]

Wavelength: TypeAlias = Annotated[float, Ge(SHORTEST), Le(LONGEST)]
Frequency: TypeAlias = Annotated[float, Ge(1e-9), Le(1e18)]
Speed: TypeAlias = Annotated[float, Ge(1e-6), Le(1e9)]

_SPEEDS = "299792458 for radio waves, about 343 for sound in air"


def carrier_problems(
    wavelength_m: float | None, frequency_hz: float | None, speed_m_s: float | None
) -> list[tuple[str, str]]:
    """Return the errors in the three options as (path, message) pairs: it must be clear what the wavelength is."""
    if wavelength_m is not None and frequency_hz is not None:
        return [("frequency_hz", "expected either wavelength_m or frequency_hz, got both")]
    if wavelength_m is not None:
        text = f"expected none with wavelength_m, got {speed_m_s}; it is used only with frequency_hz"
        return [] if speed_m_s is None else [("speed_m_s", text)]
    if frequency_hz is None:
        return [("wavelength_m", "is required, unless frequency_hz and speed_m_s are given")]
    if speed_m_s is None:
        return [("speed_m_s", f"is required with frequency_hz: the speed of the waves [m/s], {_SPEEDS}")]
    wavelength = speed_m_s / frequency_hz
    if not SHORTEST <= wavelength <= LONGEST:
        text = f"expected a wavelength speed_m_s/frequency_hz from {SHORTEST:g} to {LONGEST:g} m, got {wavelength:g} m"
        return [("frequency_hz", text)]
    return []


def carrier_wavelength(wavelength_m: float | None, frequency_hz: float | None, speed_m_s: float | None) -> float:
    """Return the wavelength λ = c/f [m] that valid options stand for."""
    if wavelength_m is not None:
        return wavelength_m
    assert frequency_hz is not None and speed_m_s is not None  # by carrier_problems
    return speed_m_s / frequency_hz
