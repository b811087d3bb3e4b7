"""Describes an array: its size, spacing and shape, where its near field is, and what it cannot distinguish."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import OptionError, Options, Survey

from ..carrier import Frequency, Speed, Wavelength, carrier_problems, carrier_wavelength
from ..geometry import flatness, nearest_distances
from . import AnyArray
from .axes import NEARLY, axis_text
from .base import Array
from .plausibility import FLAT, unusual

__all__ = ["survey"]

FAR_APART = 50.0  # extent [m] from which an array without a wavelength is suspected to be in millimetres
HALF = 0.505  # wavelengths; spacings up to this are half a wavelength with rounding
MANY = 12  # names that are listed


@dataclass(frozen=True, kw_only=True)
class _Setup(Options):
    """The options of a scenario that a survey needs; without a wavelength, it leaves out what depends on it."""

    array: AnyArray
    wavelength_m: Wavelength | None = None
    frequency_hz: Frequency | None = None
    speed_m_s: Speed | None = None

    def validate(self) -> None:
        if (self.wavelength_m, self.frequency_hz, self.speed_m_s) != (None, None, None):
            problems = carrier_problems(self.wavelength_m, self.frequency_hz, self.speed_m_s)
        else:
            text = "is required, or frequency_hz and speed_m_s: the size of this array is in wavelengths"
            problems = [] if self.array.in_metres else [("wavelength_m", text)]
        if problems:
            raise OptionError("array", problems)


def survey(options: Mapping[str, Any]) -> Survey:
    """Return the survey of an array.

    options: ``array``, and optionally ``wavelength_m``, or ``frequency_hz`` and ``speed_m_s``, as in a scenario; other
        options are ignored.

    Raises OptionError if one of them is invalid.
    """
    if "array" not in options:
        raise OptionError("array", [("array", "is required")])
    setup = _Setup(**{name: options[name] for name in _Setup.__dataclass_fields__ if name in options})
    known = (setup.wavelength_m, setup.frequency_hz) != (None, None)
    wavelength = carrier_wavelength(setup.wavelength_m, setup.frequency_hz, setup.speed_m_s) if known else None
    if problems := setup.array.misplaced(wavelength or 1.0):
        raise OptionError("array", problems)
    return _survey(setup.array, wavelength)


def _survey(array: Array, wavelength: float | None) -> Survey:
    frame = array.frame(wavelength or 1.0)
    Q = array.place(wavelength or 1.0)
    named = array.element_names
    has_names = named != tuple(map(str, range(array.count)))
    facts = [("elements", f"{array.count}{_listed(named) if has_names else ''}")]
    facts += _size(array, Q @ frame.axes, wavelength)
    facts.append(_shape(Q, frame.axes, wavelength))
    facts.append(("in front, up", f"{_plain(frame.axes[0])}, {_plain(frame.axes[2])}"))
    facts += _near_field(array, wavelength) if wavelength else []
    return Survey(
        title=f"array {getattr(type(array), 'kind', '')}".strip(),
        facts=tuple(facts),
        warnings=tuple(_doubts(array, Q, wavelength)),
        elements=frame.outward(Q),
        names=named if has_names else (),
        broadside=frame.axes[0],
        up=frame.axes[2],
    )


def _size(array: Array, Q: Float[ndarray, "m 3"], wavelength: float | None) -> Iterator[tuple[str, str]]:
    """Yield the wavelength, extent, aperture and spacing; ``Q`` are positions along the axes of the user."""
    if wavelength:
        yield "wavelength", f"{wavelength:.6g} m"
    sides = np.ptp(Q, axis=0)
    yield "extent", f"{' × '.join(f'{side:.4g}' for side in sides)} m in x, y, z"
    yield "aperture D", _length(array.aperture_m(wavelength or 1.0), wavelength)
    distances = nearest_distances(Q)
    yield "smallest spacing", _length(float(distances.min()), wavelength)
    yield "median spacing", _length(float(np.median(distances)), wavelength)


def _shape(Q: Float[ndarray, "m 3"], axes: Float[ndarray, "3 3"], wavelength: float | None) -> tuple[str, str]:
    """Return whether the elements lie on a line or in a plane, and what such an array cannot distinguish."""
    rank, principal = flatness(Q, FLAT * (wavelength or 0.0))
    principal = principal @ axes  # in the coordinates of the user
    if rank == 1:
        text = f"on a line along {_plain(principal[0])}"
        return "shape", f"{text}; it cannot distinguish directions with the same angle to the line"
    if rank == 2:
        text = f"in a plane with the normal {_plain(principal[2])}"
        return "shape", f"{text}; it cannot distinguish the two sides of the plane, front and back"
    return "shape", "in space; no two directions are the same for it"


def _near_field(array: Array, wavelength: float) -> Iterator[tuple[str, str]]:
    D = array.aperture_m(wavelength)
    fresnel, fraunhofer = 0.62 * math.sqrt(D**3 / wavelength), 2 * D**2 / wavelength
    yield "Fresnel distance", f"{fresnel:.4g} m, 0.62·√(D³/λ): closer, the Fresnel approximation is inaccurate"
    yield "Fraunhofer distance", f"{fraunhofer:.4g} m, 2D²/λ: farther, ranges can hardly be estimated"


def _doubts(array: Array, Q: Float[ndarray, "m 3"], wavelength: float | None) -> Iterator[str]:
    """Yield sentences about units, the orientation and the spacing."""
    if wavelength is None:
        aperture = array.aperture_m(1.0)
        if aperture > FAR_APART:
            hint = "" if array.unit_stated else ': are these millimetres? then set unit = "mm"'
            yield f"array: its elements have an aperture of {aperture:.4g} m{hint}"
        return
    yield from unusual(array, wavelength, faces_forward=True)
    spacing = float(np.median(nearest_distances(Q))) / wavelength
    if spacing > HALF:
        text = f"array: half of the elements are {spacing:.3g} λ or more from the nearest other one, more than λ/2"
        uniform = np.ptp(nearest_distances(Q)) < 1e-6 * spacing * wavelength
        which = "grating lobes, other directions that fit as well," if uniform else "strong side lobes"
        yield f"{text}, so that {which} are possible (spatial aliasing); lower the frequency, or limit the angles"


def _listed(names: tuple[str, ...]) -> str:
    shown = names if len(names) <= MANY else (*names[:3], "…", names[-1])
    return f" ({', '.join(shown)})"


def _length(metres: float, wavelength: float | None) -> str:
    return f"{metres:.4g} m" + (f", {metres / wavelength:.3g} λ" if wavelength else "")


def _plain(axis: Float[ndarray, " 3"]) -> str:
    """Return a direction without quotation marks; of opposite ones along a line or normal, the positive one."""
    return axis_text(axis).strip('"') if abs(axis).max() > NEARLY else axis_text(axis)
