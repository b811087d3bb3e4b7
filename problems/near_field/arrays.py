"""Antenna arrays: positions of the elements relative to an explicitly chosen origin, in metres."""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import FilePath, Ge, Gt, Le, OptionError, Options

from .geometry import Frame, flatness, nearest_distances

__all__ = ["MAX_ELEMENTS", "UCA", "ULA", "UPA", "Array", "Custom", "Origin", "unusual"]

MAX_ELEMENTS = 100_000
MAX_FILE_BYTES = 2**26
FARTHEST_M = 1e9  # of an element from the origin of its coordinates

LARGE, SMALL = 1000.0, 0.1  # extents [wavelengths] beyond which an array is unusual
SPARSE = 3.0  # distance of the closest elements [wavelengths], six times the usual one
FLAT = 0.02  # deviation from a line or plane [wavelengths, root mean square] that phases do not show
NEARLY = 0.9998  # cosine of 1°

Origin: TypeAlias = Literal["first", "center"]
"""The point from which range and angles are measured: the first element (as in the paper) or the centroid of all."""

Axis: TypeAlias = Literal["+x", "-x", "+y", "-y", "+z", "-z"] | tuple[float, float, float]
"""A direction in the coordinates of an array: an axis by name, or a vector of any length."""

_Positive: TypeAlias = Annotated[float, Gt(0.0), Le(1e6)]
_Elements: TypeAlias = Annotated[int, Ge(2), Le(MAX_ELEMENTS)]


class Array(ABC):
    """An array of M >= 2 elements at distinct positions; subclasses are Options."""

    @property
    @abstractmethod
    def count(self) -> int:
        """The number M of elements, at most 100,000, which is known before they are placed."""

    def aperture_m(self, wavelength_m: float) -> float:
        """Return the aperture D [m] from which the Fraunhofer distance 2D²/λ follows: the extent of the array."""
        Q = self.place(wavelength_m)
        return 2 * float(np.linalg.norm(Q - Q.mean(axis=0), axis=1).max())

    def frame(self, wavelength_m: float) -> Frame:
        """Return the coordinates in which the array is described; by default those of ``place``."""
        return Frame(np.eye(3), np.zeros(3))

    @abstractmethod
    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        """Return the element positions [m] relative to the origin, shape (M, 3), for a wavelength [m].

        The broadside is the x axis, and the z axis points upwards.
        """


@dataclass(frozen=True)
class ULA(Options, Array):
    """A uniform linear array along the y axis.

    elements: number M of elements.
    spacing_wavelengths: distance between neighbouring elements, in wavelengths.
    origin: point from which range and angles are measured: "first" (first element) or "center" (centre of the array).
    """

    kind: ClassVar[str] = "ula"
    elements: _Elements
    spacing_wavelengths: _Positive
    origin: Origin

    @property
    def count(self) -> int:
        return self.elements

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
    columns: Annotated[int, Ge(1), Le(MAX_ELEMENTS)]
    rows: Annotated[int, Ge(1), Le(MAX_ELEMENTS)]
    spacing_wavelengths: _Positive
    origin: Origin

    def validate(self) -> None:
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
        return math.hypot(self.columns, self.rows) * self.spacing_wavelengths * wavelength_m

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
    elements: _Elements
    radius_wavelengths: _Positive
    origin: Origin

    @property
    def count(self) -> int:
        return self.elements

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
    broadside: direction in front of the array, in the coordinates of the positions, where azimuth and elevation are 0:
        "+x", "-x", "+y", "-y", "+z", "-z", or a vector [x, y, z]; None: "+x".
    up: direction upwards, towards which elevations are positive, given like ``broadside``; its part along the broadside
        is ignored. None: "+z", or "+y" if the broadside is along z.
    """

    kind: ClassVar[str] = "custom"
    origin: Origin
    positions: tuple[tuple[float, float, float], ...] | None = None
    file: FilePath | None = None
    broadside: Axis | None = None
    up: Axis | None = None

    def validate(self) -> None:
        self._axes()
        if (self.positions is None) == (self.file is None):
            raise ValueError(f"expected either positions or file, got {'neither' if self.file is None else 'both'}")
        source = "positions" if self.file is None else f"file {Path(self.file).name}"
        if self.positions is not None and len(self.positions) > MAX_ELEMENTS:
            text = f"expected at most {MAX_ELEMENTS:,} elements, got {len(self.positions):,}"
            raise OptionError(type(self).__name__, [("positions", text)])
        Q = np.array(self.positions) if self.file is None else _load(Path(self.file))
        if Q.ndim != 2 or Q.shape[1] != 3 or len(Q) < 2:
            raise ValueError(f"{source}: expected at least 2 rows of x, y, z, got an array of shape {Q.shape}")
        if not np.isfinite(Q).all():
            row = int(np.flatnonzero(~np.isfinite(Q).all(axis=1))[0])
            raise ValueError(f"{source}: expected finite positions, got {Q[row].tolist()} in row {row}")
        if np.abs(Q).max() > FARTHEST_M:
            raise ValueError(f"{source}: expected coordinates within ±{FARTHEST_M:g} m, got {np.abs(Q).max():g} m")
        if len(np.unique(Q, axis=0)) < len(Q):
            raise ValueError(f"{source}: expected distinct positions, got {len(Q)} positions, some of which are equal")
        object.__setattr__(self, "positions", tuple(tuple(row) for row in Q.tolist()))
        object.__setattr__(self, "file", None)

    @property
    def count(self) -> int:
        return len(self.positions or ())

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        Q = _relative(np.array(self.positions), self.origin)
        return Q if self.broadside is self.up is None else Q @ self._axes().T

    def frame(self, wavelength_m: float) -> Frame:
        Q = np.array(self.positions)
        return Frame(self._axes(), Q[0] if self.origin == "first" else Q.mean(axis=0))

    def _axes(self) -> Float[ndarray, "3 3"]:
        """Return the unit vectors of broadside, left and up in the coordinates of the positions, one per row."""
        x = _unit("broadside", "+x" if self.broadside is None else self.broadside)
        usual: Axis = "+y" if abs(x[2]) > NEARLY else "+z"
        up = _unit("up", usual if self.up is None else self.up)
        z = up - (up @ x) * x
        if np.linalg.norm(z) < 0.01:
            text = f"expected a direction that is not along the broadside {self.broadside or '+x'}, got {self.up}"
            raise OptionError(type(self).__name__, [("up", text)])
        z /= np.linalg.norm(z)
        return np.stack([x, np.cross(z, x), z]) + 0.0


def _unit(name: str, axis: Axis) -> Float[ndarray, " 3"]:
    """Return the unit vector of an axis. Raises OptionError if it is not a direction."""
    if isinstance(axis, str):
        vector = np.zeros(3)
        vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
        return vector
    vector = np.array(axis)
    length = float(np.linalg.norm(vector))
    if not 1e-12 < length < 1e12:
        raise OptionError("Custom", [(name, f"expected a direction, got {list(axis)}")])
    return vector / length


def _relative(Q: Float[ndarray, "m 3"], origin: Origin) -> Float[ndarray, "m 3"]:
    placed: ndarray = Q - (Q[0] if origin == "first" else Q.mean(axis=0))
    return placed


def _load(path: Path) -> ndarray:
    """Read the numbers from a .npy or .csv file; raises ValueError if it does not contain a table of numbers."""
    if path.suffix not in (".npy", ".csv"):
        raise ValueError(f"file: expected a .npy or .csv file, got {path.name}")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ValueError(f"it has more than {MAX_FILE_BYTES:,} bytes")
        if path.suffix == ".npy":
            return _load_npy(path)
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
        if len(lines) > MAX_ELEMENTS:
            raise ValueError(f"it has {len(lines):,} rows, more than {MAX_ELEMENTS:,}")
        return np.array([[float(cell) for cell in line.split(",")] for line in lines])
    except (ValueError, TypeError, EOFError, OSError) as error:
        raise ValueError(f"file {path.name}: expected rows of three numbers, but reading it failed: {error}") from error


def _load_npy(path: Path) -> ndarray:
    """Map the file instead of reading it, as its header may promise more numbers than it has."""
    mapped = np.load(path, mmap_mode="r", allow_pickle=False)
    if not isinstance(mapped, ndarray) or mapped.dtype.kind not in "iuf":
        raise ValueError(f"it holds {getattr(mapped, 'dtype', 'several arrays')}, not real numbers")
    if mapped.ndim == 2 and len(mapped) > MAX_ELEMENTS:
        raise ValueError(f"it has {len(mapped):,} rows, more than {MAX_ELEMENTS:,}")
    return np.array(mapped, dtype=np.float64)


@functools.lru_cache(maxsize=16)
def unusual(array: Array, wavelength_m: float, faces_forward: bool) -> tuple[str, ...]:
    """Return sentences about an array that is probably not what was meant, e.g. because of a wrong unit.

    faces_forward: whether all sources are in front of the array, at azimuths within ±90°.
    """
    Q = array.place(wavelength_m)
    found = []
    extent = float(np.linalg.norm(np.ptp(Q, axis=0)))
    closest = float(nearest_distances(Q).min())
    size = f"{array.count} elements extend over {extent:.4g} m, {extent / wavelength_m:,.4g} wavelengths"
    apart = f"and are at least {closest:.4g} m apart, {closest / wavelength_m:,.4g} wavelengths"
    is_custom = isinstance(array, Custom)
    unit = "positions are in metres" if is_custom else "its spacing or radius is in wavelengths"
    millimetres = ": are these millimetres?" if is_custom else ""
    if extent > LARGE * wavelength_m or closest > SPARSE * wavelength_m:
        found.append(
            f"array: its {size} of {wavelength_m:g} m, {apart}; half a wavelength is usual; {unit}{millimetres}"
        )
    elif extent < SMALL * wavelength_m:
        found.append(f"array: its {size} of {wavelength_m:g} m, so that it resolves no directions; {unit}")
    if is_custom and faces_forward:
        found += _facing_sideways(Q, wavelength_m)
    return tuple(found)


def _facing_sideways(Q: Float[ndarray, "m 3"], wavelength_m: float) -> list[str]:
    """Return a sentence if the elements lie in a plane or on a line that contains the x axis, the broadside."""
    rank, axes = flatness(Q, FLAT * wavelength_m)
    where = "the x axis, from which azimuths are measured and which is assumed to be the broadside"
    if rank == 1 and abs(axes[0, 0]) > NEARLY:
        return [f"array: its elements lie on a line along {where}; turn the positions, e.g. to the y axis"]
    if rank == 2 and np.hypot(axes[0, 0], axes[1, 0]) > NEARLY:
        plane = ", for example the x-y plane" if abs(axes[2, 2]) > NEARLY else ""
        text = f"array: its elements lie in a plane that contains {where}{plane and f' ({plane[2:]})'}"
        return [f"{text}; turn the positions so that the array lies in the y-z plane"]
    return []
