"""Planar arrays that face the sources: crosses, concentric rings, spirals and sunflowers in the y-z plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Gt, Le, Lt, OptionError, Options

from .base import MAX_ELEMENTS, Array, Elements, Origin, Positive, either_length, length_m, relative_to_origin

__all__ = ["Cross", "Rings", "Spiral", "Sunflower"]

_Count: TypeAlias = Annotated[int, Ge(1), Le(MAX_ELEMENTS)]
_Spacing: TypeAlias = Positive | tuple[Positive, Positive] | None


@dataclass(frozen=True, kw_only=True)
class Cross(Options, Array):
    """Two uniform lines in the y-z plane that cross at their centres, one along y and one along z.

    The elements along y come first, with growing y, followed by those along z, with growing z. If both numbers are odd,
    the lines share the element at the centre, which belongs to the line along y, and the array has columns + rows − 1
    elements.

    columns: number of elements of the line along y.
    rows: number of elements of the line along z.
    spacing_wavelengths: distance between neighbouring elements of a line, in wavelengths: one number for both lines, or
        [along y, along z]; None: ``spacing_m`` is used.
    spacing_m: distance between neighbouring elements of a line [m], which does not change with the wavelength: one
        number for both lines, or [along y, along z]; None: ``spacing_wavelengths`` is used.
    origin: point from which range and angles are measured: "first" (first element) or "center" (where the lines cross).
    """

    kind: ClassVar[str] = "cross"
    columns: Elements
    rows: Elements
    spacing_wavelengths: _Spacing = None
    spacing_m: _Spacing = None
    origin: Origin

    def validate(self) -> None:
        either_length(self, "spacing")
        if self.count > MAX_ELEMENTS:
            text = f"{self.columns} + {self.rows}"
            raise ValueError(f"columns and rows: expected at most {MAX_ELEMENTS:,} elements, got {text}")

    @property
    def count(self) -> int:
        return self.columns + self.rows - self.columns % 2 * (self.rows % 2)

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        y, z = (np.arange(n) - (n - 1) / 2 for n in (self.columns, self.rows))
        if self.columns % 2 and self.rows % 2:
            z = z[z != 0]
        Q = np.zeros((self.count, 3))
        Q[: len(y), 1], Q[len(y) :, 2] = y, z
        Q[:, 1:] *= length_m(self, "spacing", wavelength_m)
        return relative_to_origin(Q, self.origin)


@dataclass(frozen=True, kw_only=True)
class Rings(Options, Array):
    """Concentric uniform rings in the y-z plane.

    An element at the centre comes first, followed by the rings in their order. The first element of a ring lies in the
    direction of the y axis, and the others follow towards z, counter-clockwise as seen from the sources.

    radii_wavelengths: list of the radii of the rings, in wavelengths; None: ``radii_m`` is used.
    radii_m: list of the radii of the rings [m], which do not change with the wavelength; None: ``radii_wavelengths`` is
        used.
    elements: number of elements per ring: one number for all rings, or a list with one number per ring.
    center: whether there is also an element at the centre.
    stagger: whether every other ring is turned by half of the angle between its elements.
    origin: point from which range and angles are measured: "first" (first element) or "center" (centre of the rings).
    """

    kind: ClassVar[str] = "rings"
    radii_wavelengths: tuple[Positive, ...] | None = None
    radii_m: tuple[Positive, ...] | None = None
    elements: _Count | tuple[_Count, ...]
    center: bool = False
    stagger: bool = False
    origin: Origin

    def validate(self) -> None:
        either_length(self, "radii")
        name, radii = ("radii_m", self.radii_m) if self.radii_m is not None else ("radii_wavelengths", self._radii)
        problems = []
        if not self._radii or len(set(self._radii)) < len(self._radii):
            problems.append((name, f"expected one or more different radii, got {list(radii or ())}"))
        elif isinstance(self.elements, tuple) and len(self.elements) != len(self._radii):
            text = f"expected one number, or {len(self._radii)} (one per ring), got {len(self.elements)}"
            problems.append(("elements", text))
        elif not 2 <= self.count <= MAX_ELEMENTS:
            text = f"expected 2 to {MAX_ELEMENTS:,} elements, got {self.count:,} in {len(self._radii)} rings"
            problems.append(("elements", text))
        if problems:
            raise OptionError(type(self).__name__, problems)

    @property
    def _radii(self) -> tuple[float, ...]:
        return self.radii_m or self.radii_wavelengths or ()

    @property
    def _counts(self) -> tuple[int, ...]:
        return self.elements if isinstance(self.elements, tuple) else (self.elements,) * len(self._radii)

    @property
    def count(self) -> int:
        return sum(self._counts) + self.center

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        Q = np.zeros((1 if self.center else 0, 3))
        for i, (R, n) in enumerate(zip(length_m(self, "radii", wavelength_m), self._counts, strict=True)):
            angle = 2 * math.pi * (np.arange(n) + (0.5 if self.stagger and i % 2 else 0.0)) / n
            Q = np.vstack([Q, _in_plane(np.full(n, R), angle)])
        return Q - (Q[0] if self.origin == "first" else 0.0)


@dataclass(frozen=True, kw_only=True)
class Spiral(Options, Array):
    """A spiral with one or more equal arms in the y-z plane, as used for arrays of microphones.

    In an arm of N elements, the radius grows in equal steps, r_n = r_0 + (R − r_0)·n/(N − 1). The angle grows by
    ``turns`` revolutions in total: in equal steps in an Archimedean spiral, θ = 2π·turns·n/(N − 1), and with the
    logarithm of the radius in a logarithmic one, θ = 2π·turns·ln(r_n/r_0)/ln(R/r_0), so that its elements are equally
    far apart along the arm (Prime & Doolan, A comparison of popular beamforming arrays, Acoustics 2013). The elements
    are numbered along the first arm from the inside, then along the other arms, each of which is turned by 360°/arms.

    form: "archimedean" or "logarithmic".
    elements: number N of elements per arm.
    arms: number of arms.
    turns: number of revolutions of an arm.
    radius_wavelengths: radius R of the outermost element of an arm, in wavelengths; None: ``radius_m`` is used.
    radius_m: radius R of the outermost element of an arm [m], which does not change with the wavelength; None:
        ``radius_wavelengths`` is used.
    inner: radius r_0 of the innermost element of an arm, as a share of R.
    origin: point from which range and angles are measured: "first" (first element) or "center" (centroid of all).
    """

    kind: ClassVar[str] = "spiral"
    form: Literal["archimedean", "logarithmic"]
    elements: Elements
    arms: _Count = 1
    turns: Annotated[float, Ge(0.0), Le(1000.0)] = 1.0
    radius_wavelengths: Positive | None = None
    radius_m: Positive | None = None
    inner: Annotated[float, Gt(0.0), Lt(1.0)] = 0.1
    origin: Origin

    def validate(self) -> None:
        either_length(self, "radius")
        if self.count > MAX_ELEMENTS:
            text = f"{self.elements} × {self.arms} = {self.count:,}"
            raise ValueError(f"elements × arms: expected at most {MAX_ELEMENTS:,} elements, got {text}")

    @property
    def count(self) -> int:
        return self.elements * self.arms

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        t = np.linspace(0.0, 1.0, self.elements)
        r = self.inner + (1 - self.inner) * t
        share = t if self.form == "archimedean" else np.log(r / self.inner) / math.log(1 / self.inner)
        angle = 2 * math.pi * (np.arange(self.arms)[:, None] / self.arms + self.turns * share)
        radius = np.tile(r * length_m(self, "radius", wavelength_m), self.arms)
        return relative_to_origin(_in_plane(radius, angle.ravel()), self.origin)


@dataclass(frozen=True, kw_only=True)
class Sunflower(Options, Array):
    """A sunflower (Vogel's spiral) in the y-z plane, whose elements fill a disc evenly, without a regular grid.

    Element m = 1 … M is at radius R·√(m/M) and angle π·m·(1 + √V) (Vogel, Mathematical Biosciences 1979; Sarradj,
    A generic approach to synthesize optimal array microphone arrangements, BeBeC 2016). The elements are numbered from
    the inside.

    elements: number M of elements.
    radius_wavelengths: radius R of the outermost element, in wavelengths; None: ``radius_m`` is used.
    radius_m: radius R of the outermost element [m], which does not change with the wavelength; None:
        ``radius_wavelengths`` is used.
    v: Sarradj's parameter V, which sets the angle between consecutive elements; 5 is the golden angle.
    origin: point from which range and angles are measured: "first" (first element) or "center" (centroid of all).
    """

    kind: ClassVar[str] = "sunflower"
    elements: Elements
    radius_wavelengths: Positive | None = None
    radius_m: Positive | None = None
    v: Annotated[float, Ge(0.0), Le(1e6)] = 5.0
    origin: Origin

    def validate(self) -> None:
        either_length(self, "radius")

    @property
    def count(self) -> int:
        return self.elements

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        m = np.arange(1, self.elements + 1)
        radius = length_m(self, "radius", wavelength_m) * np.sqrt(m / self.elements)
        return relative_to_origin(_in_plane(radius, math.pi * m * (1 + math.sqrt(self.v))), self.origin)


def _in_plane(radius: Float[ndarray, " m"], angle: Float[ndarray, " m"]) -> Float[ndarray, "m 3"]:
    """Return points in the y-z plane; angles are measured from y towards z [rad]."""
    return np.stack([np.zeros(len(angle)), radius * np.cos(angle), radius * np.sin(angle)], axis=1)
