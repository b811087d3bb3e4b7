"""How a recording differs from the scenario of a study that has chosen the method for it."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["unlike"]

SAME_WAVELENGTH = 0.01  # largest relative difference
SAME_PLACE = 0.01  # largest difference of the positions of an element [wavelengths]


def unlike(own: Any, other: Any) -> list[str]:
    """Return sentences about differences of the array, the wavelength and the number of sources.

    own: scenario of the recording. other: scenario of the study, which may be of any kind.
    """
    if not all(hasattr(other, name) for name in ("array", "wavelength", "sources")):
        return []
    found, wavelength = [], own.wavelength
    if abs(other.wavelength / wavelength - 1) > SAME_WAVELENGTH:
        found.append(f"its wavelength is {other.wavelength:.4g} m, that of the recording {wavelength:.4g} m")
    Q, P = (each.array.place(each.wavelength) / each.wavelength for each in (own, other))
    if len(P) != len(Q):
        found.append(f"its array has {len(P)} elements, that of the recording {len(Q)}")
    elif (furthest := np.abs(P - Q).max()) > SAME_PLACE:
        found.append(f"its elements are at other places, by up to {furthest:.3g} wavelengths")
    if isinstance(other.sources, int) and other.sources != own.sources:
        found.append(f"its number of sources is {other.sources}, not {own.sources}")
    return found
