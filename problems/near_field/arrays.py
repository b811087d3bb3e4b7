"""Antenna arrays: positions of the elements relative to an explicitly chosen origin, in metres."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import FilePath, Ge, Gt, Lt, Options

__all__ = ["UCA", "ULA", "UPA", "Array", "Custom", "Origin"]

Origin: TypeAlias = Literal["first", "center"]
"""The point from which range and angles are measured: the first element (as in the paper) or the centroid of all."""

_Positive: TypeAlias = Annotated[float, Gt(0.0), Lt(math.inf)]


class Array(ABC):
    """An array of M >= 2 elements at distinct positions; subclasses are Options."""

    @abstractmethod
    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        """Return the element positions [m] relative to the origin, shape (M, 3), for a wavelength [m]."""


@dataclass(frozen=True)
class ULA(Options, Array):
    """A uniform linear array along the y axis.

    elements: number M of elements.
    spacing_wavelengths: distance between neighbouring elements, in wavelengths.
    origin: point from which range and angles are measured: "first" (first element) or "center" (centre of the array).
    """

    kind: ClassVar[str] = "ula"
    elements: Annotated[int, Ge(2)]
    spacing_wavelengths: _Positive
    origin: Origin

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        Q = np.zeros((self.elements, 3))
        Q[:, 1] = np.arange(self.elements) * (self.spacing_wavelengths * wavelength_m)
        return _relative(Q, self.origin)


@dataclass(frozen=True)
class UPA(Options, Array):
    """A uniform planar array in the y-z plane.

    The elements are numbered along y first, starting at the corner with the smallest y and z.

    columns: number of elements along y.
    rows: number of elements along z.
    spacing_wavelengths: distance between neighbouring elements in both directions, in wavelengths.
    origin: point from which range and angles are measured: "first" (first element, the corner) or "center" (centre of
        the array).
    """

    kind: ClassVar[str] = "upa"
    columns: Annotated[int, Ge(1)]
    rows: Annotated[int, Ge(1)]
    spacing_wavelengths: _Positive
    origin: Origin

    def validate(self) -> None:
        if self.columns * self.rows < 2:
            raise ValueError(f"columns and rows: expected at least 2 elements, got {self.columns} × {self.rows}")

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        z, y = np.divmod(np.arange(self.columns * self.rows), self.columns)
        Q = np.stack([np.zeros(len(y)), y, z], axis=1) * (self.spacing_wavelengths * wavelength_m)
        return _relative(Q, self.origin)


@dataclass(frozen=True)
class UCA(Options, Array):
    """A uniform circular array in the x-y plane.

    The first element lies in the direction of the x axis, and the others follow counter-clockwise. The array has the
    same resolution at every azimuth, but cannot distinguish an elevation from its negative.

    elements: number M of elements.
    radius_wavelengths: radius of the circle, in wavelengths.
    origin: point from which range and angles are measured: "center" (centre of the circle) or "first" (first element).
    """

    kind: ClassVar[str] = "uca"
    elements: Annotated[int, Ge(2)]
    radius_wavelengths: _Positive
    origin: Origin

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        angle = 2 * math.pi * np.arange(self.elements) / self.elements
        Q = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
        return _relative(Q * (self.radius_wavelengths * wavelength_m), self.origin)


@dataclass(frozen=True)
class Custom(Options, Array):
    """An array with arbitrary element positions, given either by ``positions`` or by ``file``.

    The positions are read from the file when the options are checked, and stored as ``positions``. An array from a file
    whose contents have changed is therefore a different array.

    origin: point from which range and angles are measured: "first" (first element) or "center" (centroid of all
        elements).
    positions: list of positions [x, y, z] of the elements [m]; None: they are read from ``file``.
    file: path of a .npy or .csv file with one row x, y, z [m] per element; None: ``positions`` is used.
    """

    kind: ClassVar[str] = "custom"
    origin: Origin
    positions: tuple[tuple[float, float, float], ...] | None = None
    file: FilePath | None = None

    def validate(self) -> None:
        if (self.positions is None) == (self.file is None):
            raise ValueError(f"expected either positions or file, got {'neither' if self.file is None else 'both'}")
        source = "positions" if self.file is None else f"file {Path(self.file).name}"
        Q = np.array(self.positions) if self.file is None else _load(Path(self.file))
        if Q.ndim != 2 or Q.shape[1] != 3 or len(Q) < 2:
            raise ValueError(f"{source}: expected at least 2 rows of x, y, z, got an array of shape {Q.shape}")
        if not np.isfinite(Q).all():
            row = int(np.flatnonzero(~np.isfinite(Q).all(axis=1))[0])
            raise ValueError(f"{source}: expected finite positions, got {Q[row].tolist()} in row {row}")
        if len(np.unique(Q, axis=0)) < len(Q):
            raise ValueError(f"{source}: expected distinct positions, got {len(Q)} positions, some of which are equal")
        object.__setattr__(self, "positions", tuple(tuple(row) for row in Q.tolist()))
        object.__setattr__(self, "file", None)

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        return _relative(np.array(self.positions), self.origin)


def _relative(Q: Float[ndarray, "m 3"], origin: Origin) -> Float[ndarray, "m 3"]:
    placed: ndarray = Q - (Q[0] if origin == "first" else Q.mean(axis=0))
    return placed


def _load(path: Path) -> ndarray:
    """Read the numbers from a .npy or .csv file; raises ValueError if it does not contain a table of numbers."""
    if path.suffix not in (".npy", ".csv"):
        raise ValueError(f"file: expected a .npy or .csv file, got {path.name}")
    try:
        if path.suffix == ".npy":
            return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
        return np.array([[float(cell) for cell in line.split(",")] for line in lines])
    except (ValueError, TypeError, EOFError) as error:
        raise ValueError(f"file {path.name}: expected rows of three numbers, but reading it failed: {error}") from error
