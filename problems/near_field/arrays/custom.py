"""An array with arbitrary element positions, given in a list or a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import FilePath, OptionError, Options

from ..geometry import Frame
from .axes import Axis, axes_of
from .base import MAX_ELEMENTS, Array, Origin, relative_to_origin
from .files import Unit, checked_names, checked_positions, header_states_unit, in_metres, read_positions

__all__ = ["Custom"]


@dataclass(frozen=True)
class Custom(Options, Array):
    """An array with arbitrary element positions, given either by ``positions`` or by ``file``.

    The positions are read from the file when the options are checked, and stored as ``positions`` in metres, and the
    names of the elements as ``names``. An array from a file whose contents have changed is therefore a different array.

    A text file (.csv, .txt, .tsv, .dat) has one row x, y, z per element, separated by commas, semicolons, tabs or
    blanks, and optionally a first line with the names of the columns, such as ``name, x_mm, y_mm, z_mm`` or
    ``x [cm]; z [cm]``: coordinates that it does not name are 0, and other columns are ignored, except for the names of
    the elements. Lines may end in a comment after ``#``. A .npy, .npz, .mat or HDF5 file has an array of shape (M, 3)
    or (3, M); one of shape (3, 3) has one row per element.

    origin: point from which range and angles are measured: "first" (first element) or "center" (centroid of all
        elements).
    positions: list of positions [x, y, z] of the elements [m]; None: they are read from ``file``.
    file: path of a .csv, .txt, .tsv, .dat, .npy, .npz, .mat or HDF5 file with the positions; None: ``positions`` is
        used.
    broadside: direction in front of the array, in the coordinates of the positions, where azimuth and elevation are 0:
        "+x", "-x", "+y", "-y", "+z", "-z", or a vector [x, y, z]; None: "+x".
    up: direction upwards, towards which elevations are positive, given like ``broadside``; its part along the broadside
        is ignored. None: "+z", or "+y" if the broadside is along z.
    unit: unit of the positions: "m", "dm", "cm", "mm", "um", "km", "in" or "ft"; it must agree with the units that a
        text file names. None: metres, or what the file says.
    variable: name of the array in a .npz, .mat or HDF5 file; None: the only one of a fitting shape.
    names: list with one name per element; None: those in ``file``, if it has any.
    """

    kind: ClassVar[str] = "custom"
    origin: Origin
    positions: tuple[tuple[float, float, float], ...] | None = None
    file: FilePath | None = None
    broadside: Axis | None = None
    up: Axis | None = None
    unit: Unit | None = None
    variable: str | None = None
    names: tuple[str, ...] | None = field(default=None, metadata={"identifies": False})

    def validate(self) -> None:
        self._axes()
        if (self.positions is None) == (self.file is None):
            raise ValueError(f"expected either positions or file, got {'neither' if self.file is None else 'both'}")
        if self.positions is not None and len(self.positions) > MAX_ELEMENTS:
            text = f"expected at most {MAX_ELEMENTS:,} elements, got {len(self.positions):,}"
            raise OptionError(type(self).__name__, [("positions", text)])
        names = self.names
        if self.file is None:
            if self.variable is not None:
                text = f"expected none without a file, got {self.variable!r}"
                raise OptionError(type(self).__name__, [("variable", text)])
            Q = checked_positions(in_metres(np.array(self.positions), self.unit or "m"), "positions")
        else:
            Q, found = read_positions(Path(self.file), self.unit, self.variable)
            names = found if names is None else names
        checked_names(names, len(Q), "names")
        stated = self.unit is not None or (self.file is not None and header_states_unit(Path(self.file)))
        object.__setattr__(self, "_unit_stated", stated)
        stored = {"positions": tuple(tuple(row) for row in Q.tolist()), "names": names}
        for name, value in {**stored, "file": None, "unit": None, "variable": None}.items():
            object.__setattr__(self, name, value)

    @property
    def count(self) -> int:
        return len(self.positions or ())

    @property
    def unit_stated(self) -> bool:
        """Whether the user or the file has said what the unit of the positions is."""
        return bool(getattr(self, "_unit_stated", False))

    @property
    def in_metres(self) -> bool:
        return True

    @property
    def element_names(self) -> tuple[str, ...]:
        return self.names or tuple(map(str, range(self.count)))

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        Q = relative_to_origin(np.array(self.positions), self.origin)
        return Q if self.broadside is self.up is None else Q @ self._axes().T

    def frame(self, wavelength_m: float) -> Frame:
        Q = np.array(self.positions)
        return Frame(self._axes(), Q[0] if self.origin == "first" else Q.mean(axis=0))

    def _axes(self) -> Float[ndarray, "3 3"]:
        """Return the unit vectors of broadside, left and up in the coordinates of the positions, one per row."""
        return axes_of(self.broadside, self.up, type(self).__name__)
