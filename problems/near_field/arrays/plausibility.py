"""Sentences about arrays that are probably not what was meant."""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ..geometry import flatness, nearest_distances
from .axes import NEARLY, axis_text
from .base import Array
from .custom import Custom

__all__ = ["unusual"]

LARGE, SMALL = 1000.0, 0.1  # extents [wavelengths] beyond which an array is unusual
SPARSE = 3.0  # distance of the closest elements [wavelengths], six times the usual one
FLAT = 0.02  # deviation from a line or plane [wavelengths, root mean square] that phases do not show


@functools.lru_cache(maxsize=16)
def unusual(array: Array, wavelength_m: float, faces_forward: bool) -> tuple[str, ...]:
    """Return sentences about an array that is probably not what was meant, e.g. because of a wrong unit.

    faces_forward: whether all sources are in front of the array, at azimuths within ±90°.
    """
    Q = array.place(wavelength_m)
    found = []
    extent = array.aperture_m(wavelength_m)
    closest = float(nearest_distances(Q).min())
    size = f"{array.count} elements have an aperture of {extent:.4g} m, {extent / wavelength_m:,.4g} wavelengths"
    apart = f"and are at least {closest:.4g} m apart, {closest / wavelength_m:,.4g} wavelengths"
    is_custom = isinstance(array, Custom)
    unit = "its spacing or radius is in " + ("metres" if array.in_metres else "wavelengths")
    unit = "positions are in metres" if is_custom else unit
    remedy = ': are these millimetres? then set unit = "mm" (--unit mm)' if is_custom and not array.unit_stated else ""
    others = "; or check the frequency [Hz], --frequency-hz, and the speed [m/s], --speed"
    if extent > LARGE * wavelength_m or closest > SPARSE * wavelength_m:
        found.append(
            f"array: its {size} of {wavelength_m:g} m, {apart}; half a wavelength is usual; {unit}{remedy}{others}"
        )
    elif extent < SMALL * wavelength_m:
        found.append(f"array: its {size} of {wavelength_m:g} m, which hardly resolves directions; {unit}{others}")
    if isinstance(array, Custom) and faces_forward:
        found += _facing_sideways(array, Q, wavelength_m)
    return tuple(found)


def _facing_sideways(array: Custom, Q: Float[ndarray, "m 3"], wavelength_m: float) -> list[str]:
    """Return a sentence if the elements lie in a plane or on a line that contains the x axis, the broadside."""
    rank, axes = flatness(Q, FLAT * wavelength_m)
    where = "the x axis, from which azimuths are measured and which is assumed to be the broadside"
    if rank == 1 and abs(axes[0, 0]) > NEARLY:
        normal = array.frame(wavelength_m).axes[1]  # the line is along x, so that y is perpendicular to it
        return [f"array: its elements lie on a line along {where}; {_remedy(normal)}"]
    if rank == 2 and np.hypot(axes[0, 0], axes[1, 0]) > NEARLY:
        plane = ", for example the x-y plane" if abs(axes[2, 2]) > NEARLY else ""
        text = f"array: its elements lie in a plane that contains {where}{plane and f' ({plane[2:]})'}"
        return [f"{text}; {_remedy(axes[2] @ array.frame(wavelength_m).axes)}"]
    return []


def _remedy(normal: Float[ndarray, " 3"]) -> str:
    """Return what to do, for a direction perpendicular to the array in the coordinates of its positions."""
    normal = normal * (1 if normal[np.argmax(np.abs(normal))] > 0 else -1)
    one, other = axis_text(normal), axis_text(-normal)
    return f"set broadside to the direction in front of the array, for example {one} or {other}"
