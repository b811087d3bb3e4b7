"""What all arrays have in common: the abstract class, and lengths given in wavelengths or in metres."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Gt, Le, OptionError

from ..geometry import Frame

__all__ = [
    "MAX_ELEMENTS",
    "Array",
    "Elements",
    "Origin",
    "Positive",
    "either_length",
    "length_m",
    "relative_to_origin",
]

MAX_ELEMENTS = 100_000

Origin: TypeAlias = Literal["first", "center"]
"""The point from which range and angles are measured: the first element (as in the paper) or the centroid of all."""

Positive: TypeAlias = Annotated[float, Gt(0.0), Le(1e6)]
Elements: TypeAlias = Annotated[int, Ge(2), Le(MAX_ELEMENTS)]

_LENGTHS = ("spacing_m", "radius_m", "radii_m")


class Array(ABC):
    """An array of M >= 2 elements at distinct positions; subclasses are Options."""

    @property
    @abstractmethod
    def count(self) -> int:
        """The number M of elements, at most 100,000, which is known before they are placed."""

    @property
    def in_metres(self) -> bool:
        """Whether the size of the array is given in metres, and therefore does not depend on the wavelength."""
        return any(getattr(self, name, None) is not None for name in _LENGTHS)

    @property
    def unit_stated(self) -> bool:
        """Whether the user, or a file, has said in which unit the positions are."""
        return False

    @property
    def element_names(self) -> tuple[str, ...]:
        """The names of the elements; by default their numbers, from 0."""
        return tuple(map(str, range(self.count)))

    def aperture_m(self, wavelength_m: float) -> float:
        """Return the aperture D [m] from which the Fraunhofer distance 2D²/λ follows: the extent of the array."""
        Q = self.place(wavelength_m)
        return 2 * float(np.linalg.norm(Q - Q.mean(axis=0), axis=1).max())

    def frame(self, wavelength_m: float) -> Frame:
        """Return the coordinates in which the array is described; by default those of ``place``."""
        return Frame(np.eye(3), np.zeros(3))

    def misplaced(self, wavelength_m: float) -> list[tuple[str, str]]:
        """Return errors in the options that show only at a wavelength [m], as (path, message) pairs."""
        return []

    @abstractmethod
    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        """Return the element positions [m] relative to the origin, shape (M, 3), for a wavelength [m].

        The broadside is the x axis, and the z axis points upwards.
        """


def either_length(array: Array, name: str) -> None:
    """Raise OptionError unless a length is given either in wavelengths or in metres."""
    in_wavelengths, in_metres = f"{name}_wavelengths", f"{name}_m"
    given = [option for option in (in_wavelengths, in_metres) if getattr(array, option) is not None]
    if len(given) != 1:
        text = f"expected either {in_wavelengths} or {in_metres}, got {'both' if given else 'neither'}"
        raise OptionError(type(array).__name__, [(in_wavelengths, text)])


def length_m(array: Array, name: str, wavelength_m: float) -> Any:
    """Return a length [m] that is given in wavelengths or in metres, or an array of them if it is a list."""
    metres = getattr(array, f"{name}_m")
    if metres is not None:
        return np.array(metres) if isinstance(metres, tuple) else metres
    wavelengths = getattr(array, f"{name}_wavelengths")
    return np.array(wavelengths) * wavelength_m if isinstance(wavelengths, tuple) else wavelengths * wavelength_m


def relative_to_origin(Q: Float[ndarray, "m 3"], origin: Origin) -> Float[ndarray, "m 3"]:
    """Return element positions relative to the origin of the array."""
    placed: ndarray = Q - (Q[0] if origin == "first" else Q.mean(axis=0))
    return placed
