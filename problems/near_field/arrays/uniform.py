"""Uniform arrays: a line, a rectangle and a circle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Le, Options

from .base import MAX_ELEMENTS, Array, Elements, Origin, Positive, either_length, length_m, relative_to_origin

__all__ = ["UCA", "ULA", "UPA"]

_Spacing: TypeAlias = Positive | tuple[Positive, Positive] | None


@dataclass(frozen=True, kw_only=True)
class ULA(Options, Array):
    """A uniform linear array along the y axis.

    elements: number M of elements.
    spacing_wavelengths: distance between neighbouring elements, in wavelengths; None: ``spacing_m`` is used.
    spacing_m: distance between neighbouring elements [m], which does not change with the wavelength; None:
        ``spacing_wavelengths`` is used.
    origin: point from which range and angles are measured: "first" (first element) or "center" (centre of the array).
    """

    kind: ClassVar[str] = "ula"
    elements: Elements
    spacing_wavelengths: Positive | None = None
    spacing_m: Positive | None = None
    origin: Origin

    def validate(self) -> None:
        either_length(self, "spacing")

    @property
    def count(self) -> int:
        return self.elements

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        Q = np.zeros((self.elements, 3))
        Q[:, 1] = np.arange(self.elements) * length_m(self, "spacing", wavelength_m)
        return relative_to_origin(Q, self.origin)


@dataclass(frozen=True, kw_only=True)
class UPA(Options, Array):
    """A uniform planar (rectangular) array in the y-z plane.

    The elements are numbered along y first, starting at the corner with the smallest y and z.

    columns: number of elements along y.
    rows: number of elements along z.
    spacing_wavelengths: distance between neighbouring elements, in wavelengths: one number for both directions, or
        [along y, along z]; None: ``spacing_m`` is used.
    spacing_m: distance between neighbouring elements [m], which does not change with the wavelength: one number for
        both directions, or [along y, along z]; None: ``spacing_wavelengths`` is used.
    origin: point from which range and angles are measured: "first" (first element, the corner) or "center" (centre of
        the array).
    """

    kind: ClassVar[str] = "upa"
    columns: Annotated[int, Ge(1), Le(MAX_ELEMENTS)]
    rows: Annotated[int, Ge(1), Le(MAX_ELEMENTS)]
    spacing_wavelengths: _Spacing = None
    spacing_m: _Spacing = None
    origin: Origin

    def validate(self) -> None:
        either_length(self, "spacing")
        if self.count < 2:
            raise ValueError(f"columns and rows: expected at least 2 elements, got {self.columns} × {self.rows}")
        if self.count > MAX_ELEMENTS:
            product = f"{self.columns} × {self.rows} = {self.count:,}"
            raise ValueError(f"columns and rows: expected at most {MAX_ELEMENTS:,} elements, got {product}")

    @property
    def count(self) -> int:
        return self.columns * self.rows

    def aperture_m(self, wavelength_m: float) -> float:
        """Return D = √(columns² + rows²)·δ, as in the paper, whose 16 × 16 elements are √2·16·δ wide."""
        return float(np.hypot(*(np.array([self.columns, self.rows]) * length_m(self, "spacing", wavelength_m))))

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        z, y = np.divmod(np.arange(self.columns * self.rows), self.columns)
        Q = np.zeros((len(y), 3))
        Q[:, 1:] = np.stack([y, z], axis=1) * length_m(self, "spacing", wavelength_m)
        return relative_to_origin(Q, self.origin)


@dataclass(frozen=True, kw_only=True)
class UCA(Options, Array):
    """A uniform circular array in the x-y plane.

    The first element lies in the direction of the x axis, and the others follow counter-clockwise. The array has the
    same resolution at every azimuth, but cannot distinguish an elevation from its negative. For circles that face the
    sources, in the y-z plane, use kind "rings".

    elements: number M of elements.
    radius_wavelengths: radius of the circle, in wavelengths; None: ``radius_m`` is used.
    radius_m: radius of the circle [m], which does not change with the wavelength; None: ``radius_wavelengths`` is used.
    origin: point from which range and angles are measured: "center" (centre of the circle) or "first" (first element).
    """

    kind: ClassVar[str] = "uca"
    elements: Elements
    radius_wavelengths: Positive | None = None
    radius_m: Positive | None = None
    origin: Origin

    def validate(self) -> None:
        either_length(self, "radius")

    @property
    def count(self) -> int:
        return self.elements

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        angle = 2 * math.pi * np.arange(self.elements) / self.elements
        Q = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
        return relative_to_origin(Q * length_m(self, "radius", wavelength_m), self.origin)
