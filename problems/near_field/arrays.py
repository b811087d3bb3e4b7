"""Antenna arrays: element positions relative to a stated origin, in metres."""

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
"""What range and angles are measured from: the first element (the paper) or the centroid of all."""

_Positive: TypeAlias = Annotated[float, Gt(0.0), Lt(math.inf)]


class Array(ABC):
    """An array of M >= 2 elements, no two at the same place; its kinds are Options."""

    @abstractmethod
    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        """The element positions (M, 3) relative to the origin, for a wavelength, both in metres."""


@dataclass(frozen=True)
class ULA(Options, Array):
    """A uniform linear array along y.

    elements: their number M. spacing_wavelengths: between neighbours [λ]. origin: "first" or "center".
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
    """A uniform planar array in the y-z plane; elements run along y first, from the corner of least y and z.

    columns, rows: elements along y and along z. spacing_wavelengths: between neighbours, in both directions [λ].
    origin: "first" (that corner) or "center".
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
    """A uniform circular array in the x-y plane, the first element on the x axis, the others counter-clockwise.

    It sees every azimuth alike, but cannot tell an elevation from its negative.

    elements: their number M. radius_wavelengths: of the circle [λ]. origin: "center" (of the circle) or "first".
    """

    kind: ClassVar[str] = "uca"
    elements: Annotated[int, Ge(2)]
    radius_wavelengths: _Positive
    origin: Origin

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        turn = 2 * math.pi * np.arange(self.elements) / self.elements
        Q = np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)
        return _relative(Q * (self.radius_wavelengths * wavelength_m), self.origin)


@dataclass(frozen=True)
class Custom(Options, Array):
    """Any array, by the positions of its elements.

    origin: "first" or "center". positions: (M, 3) [m], or file: a .npy or .csv that holds them, one element a row.
    The positions are what the options keep, so that a changed file is a different array.
    """

    kind: ClassVar[str] = "custom"
    origin: Origin
    positions: tuple[tuple[float, float, float], ...] | None = None
    file: FilePath | None = None

    def validate(self) -> None:
        if (self.positions is None) == (self.file is None):
            raise ValueError(f"expected either positions or a file, got {'neither' if self.file is None else 'both'}")
        source = "positions" if self.file is None else f"file {Path(self.file).name}"
        Q = np.array(self.positions) if self.file is None else _load(Path(self.file))
        if Q.ndim != 2 or Q.shape[1] != 3 or len(Q) < 2:
            raise ValueError(f"{source}: expected at least 2 rows of x, y, z, got an array of shape {Q.shape}")
        if not np.isfinite(Q).all():
            row = int(np.flatnonzero(~np.isfinite(Q).all(axis=1))[0])
            raise ValueError(f"{source}: expected finite positions, got {Q[row].tolist()} in row {row}")
        if len(np.unique(Q, axis=0)) < len(Q):
            raise ValueError(f"{source}: expected distinct positions, got {len(Q)} of which some are equal")
        object.__setattr__(self, "positions", tuple(tuple(row) for row in Q.tolist()))
        object.__setattr__(self, "file", None)

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        return _relative(np.array(self.positions), self.origin)


def _relative(Q: Float[ndarray, "m 3"], origin: Origin) -> Float[ndarray, "m 3"]:
    placed: ndarray = Q - (Q[0] if origin == "first" else Q.mean(axis=0))
    return placed


def _load(path: Path) -> ndarray:
    """The numbers in a .npy or .csv; raises ValueError where there are none."""
    if path.suffix not in (".npy", ".csv"):
        raise ValueError(f"file: expected a .npy or .csv, got {path.name}")
    try:
        if path.suffix == ".npy":
            return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
        return np.array([[float(cell) for cell in line.split(",")] for line in lines])
    except (ValueError, TypeError, EOFError) as error:
        raise ValueError(f"file {path.name}: expected rows of three numbers: {error}") from error
