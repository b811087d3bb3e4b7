"""Reads the positions and names of elements from files: text, NumPy, MATLAB and HDF5."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .base import MAX_ELEMENTS
from .text_tables import UNITS, parsed, states_unit

__all__ = ["MAX_FILE_BYTES", "Unit", "checked_names", "checked_positions", "in_metres", "read_positions"]

MAX_FILE_BYTES = 2**26
FARTHEST_M = 1e9  # of an element from the origin of its coordinates
LONGEST_NAME = 100  # characters

Unit: TypeAlias = Literal["m", "dm", "cm", "mm", "um", "km", "in", "ft"]

_TEXT, _HDF5 = (".csv", ".txt", ".tsv", ".dat"), (".h5", ".hdf5")
_SUFFIXES = (*_TEXT, ".npy", ".npz", ".mat", *_HDF5)
_MATLAB_NUMBERS = {"double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


def header_states_unit(path: Path) -> bool:
    """Return whether the header of a text file, which can be read, names the unit of the positions."""
    if path.suffix.lower() not in _TEXT:
        return False
    with path.open(encoding="utf-8-sig") as file:
        return states_unit(file.readline(10_000))


def read_positions(
    path: Path, unit: Unit | None = None, variable: str | None = None
) -> tuple[Float[ndarray, "m 3"], tuple[str, ...] | None]:
    """Return the positions [m] of the elements of an array, shape (M, 3), and their names, if the file has any.

    path: text file (.csv, .txt, .tsv, .dat) as ``Custom`` describes it, or a .npy, .npz, .mat or HDF5 file.
    unit: unit of the numbers; None: metres, or the units that the first line of a text file names.
    variable: name of the array in a .npz, .mat or HDF5 file; None: the only one of shape (M, 3) or (3, M).

    An array of shape (3, M) is transposed; one of shape (3, 3) has one row per element. Files are never unpickled.
    Raises ValueError, which names the file and what is wrong with it.
    """
    source = f"file {path.name}"
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(f"file: expected a {', '.join(_SUFFIXES[:-1])} or {_SUFFIXES[-1]} file, got {path.name}")
    if variable is not None and suffix in (*_TEXT, ".npy"):
        raise ValueError(f"variable: expected none for a {suffix} file, which has no variables, got {variable!r}")
    if unit is not None and unit not in get_args(Unit):
        raise ValueError(f"unit: expected one of {', '.join(get_args(Unit))}, got {unit!r:.80}")
    names = None
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ValueError(f"it has more than {MAX_FILE_BYTES:,} bytes")
        if suffix in _TEXT:
            Q, names = parsed(path.read_text(encoding="utf-8-sig"), unit, MAX_ELEMENTS)
        else:
            Q, names = _arrays(path, suffix, variable)
            Q = in_metres(Q, unit or "m")
    except Exception as error:  # whatever a damaged file makes a library raise
        reason = str(error) or type(error).__name__
        raise ValueError(f"{source}: expected rows of coordinates, but reading it failed: {reason:.600}") from error
    Q = checked_positions(Q, source)
    checked_names(names, len(Q), source)
    return Q, names


def in_metres(Q: ndarray, unit: str) -> ndarray:
    """Return lengths in a unit in metres: 250 mm are exactly the number 0.25."""
    factor, divisor = UNITS[unit]
    return Q if factor == divisor else Q * factor / divisor


def checked_positions(Q: ndarray, source: str) -> Float[ndarray, "m 3"]:
    """Return positions as (M, 3), transposed if they are (3, M).

    Raises ValueError, which begins with ``source``, unless they are at least two distinct points.
    """
    if Q.ndim == 2 and Q.shape[1] != 3 and Q.shape[0] == 3:
        Q = Q.T
    if Q.ndim != 2 or Q.shape[1] != 3 or len(Q) < 2:
        text = f"{source}: expected at least 2 rows of x, y, z, got an array of shape {Q.shape}"
        two = "; for two coordinates, use a text file whose first line names them, such as x_m,y_m"
        raise ValueError(text + two * (Q.ndim == 2 and Q.shape[1] == 2))
    if len(Q) > MAX_ELEMENTS:
        raise ValueError(f"{source}: expected at most {MAX_ELEMENTS:,} elements, got {len(Q):,}")
    if not np.isfinite(Q).all():
        row = int(np.flatnonzero(~np.isfinite(Q).all(axis=1))[0])
        raise ValueError(f"{source}: expected finite positions, got {Q[row].tolist()} in row {row}")
    if np.abs(Q).max() > FARTHEST_M:
        raise ValueError(f"{source}: expected coordinates within ±{FARTHEST_M:g} m, got {np.abs(Q).max():g} m")
    if len(np.unique(Q, axis=0)) < len(Q):
        raise ValueError(f"{source}: expected distinct positions, got {len(Q)} positions, some of which are equal")
    return np.ascontiguousarray(Q, dtype=np.float64)


def checked_names(names: tuple[str, ...] | None, elements: int, source: str) -> None:
    """Raise ValueError, which begins with ``source``, unless there are no names or one different name per element."""
    if names is None:
        return
    if len(names) != elements:
        raise ValueError(f"{source}: expected {elements} names, one per element, got {len(names)}")
    if len(set(names)) < len(names):
        twice = next(name for i, name in enumerate(names) if name in names[:i])
        raise ValueError(f"{source}: expected a different name for each element, got {twice!r:.100} twice")
    for name in names:
        if not name.strip() or not name.isprintable() or len(name) > LONGEST_NAME:
            text = f"expected names of 1 to {LONGEST_NAME} printable characters"
            raise ValueError(f"{source}: {text}, got {name!r:.120}")


def _arrays(path: Path, suffix: str, variable: str | None) -> tuple[ndarray, tuple[str, ...] | None]:
    """Read the positions, and the names if there are any, from a file that is not text."""
    if suffix == ".npy":
        with path.open("rb") as file:
            return _npy(file, path.stat().st_size), None
    if suffix == ".npz":
        return _npz(path, variable)
    if suffix in _HDF5:
        return _hdf5(path, variable, is_matlab=False), None
    return _mat(path, variable), None


def _npy(file: IO[bytes], size: int) -> ndarray:
    """Read a .npy file of this many bytes, after checking that its header promises no more than there is."""
    shape, dtype = _npy_header(file)
    if dtype.kind not in "iuf":
        raise ValueError(f"it holds {dtype}, not real numbers")
    if len(shape) == 2 and 3 in shape and max(shape) > MAX_ELEMENTS:
        raise ValueError(f"it has {max(shape):,} rows, more than {MAX_ELEMENTS:,}")
    if float(np.prod([float(n) for n in shape])) * dtype.itemsize > size:
        raise ValueError(f"it is shorter than the array of shape {shape} that its header promises")
    file.seek(0)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False), dtype=np.float64)


def _npy_header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"it has version {version} of the format, not 1.0 or 2.0")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return tuple(shape), dtype


def _npz(path: Path, variable: str | None) -> tuple[ndarray, tuple[str, ...] | None]:
    with zipfile.ZipFile(path) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        if sum(member.file_size for member in members.values()) > MAX_FILE_BYTES:
            raise ValueError(f"it has more than {MAX_FILE_BYTES:,} bytes when it is unpacked")
        shapes, names = {}, None
        for name, member in members.items():
            with archive.open(member) as file:
                shape, dtype = _npy_header(file)
            shapes[name] = shape if dtype.kind in "iuf" else None
            if name == "names" and dtype.kind == "U" and len(shape) == 1:
                with archive.open(member) as file:
                    names = tuple(map(str, np.lib.format.read_array(file, allow_pickle=False)))
        chosen = members[_chosen(shapes, variable)]
        with archive.open(chosen) as file:
            return _npy(file, chosen.file_size), names


def _mat(path: Path, variable: str | None) -> ndarray:
    from scipy.io import loadmat, whosmat

    try:
        found = whosmat(path)
    except NotImplementedError:  # version 7.3, which is HDF5
        return _hdf5(path, variable, is_matlab=True)
    name = _chosen({name: shape if kind in _MATLAB_NUMBERS else None for name, shape, kind in found}, variable)
    value = loadmat(path, variable_names=[name])[name]
    if value.dtype.kind not in "iuf":
        raise ValueError(f"{name} holds {value.dtype}, not real numbers")
    return np.asarray(value, dtype=np.float64)


def _hdf5(path: Path, variable: str | None, is_matlab: bool) -> ndarray:
    try:
        import h5py
    except ImportError as error:
        kind = "a .mat file of version 7.3" if is_matlab else "HDF5"
        raise ValueError(f"{kind} is read by h5py, which is not installed: pip install h5py") from error
    with h5py.File(path, "r") as file:
        shapes: dict[str, tuple[int, ...] | None] = {}

        def note(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                shapes[name] = item.shape if item.dtype.kind in "iuf" else None

        file.visititems(note)
        values = np.asarray(file[_chosen(shapes, variable)][...], dtype=np.float64)
    return values.T if is_matlab else values  # MATLAB stores columns first


def _chosen(shapes: Mapping[str, tuple[int, ...] | None], variable: str | None) -> str:
    """Return the name of the array to read; a shape of None is that of an array that does not hold real numbers."""
    fitting = [name for name, shape in shapes.items() if shape is not None and _fits(shape)]
    listed = ", ".join(f"{name} {'×'.join(map(str, shape or ())) or '(no numbers)'}" for name, shape in shapes.items())
    if variable is None and len(fitting) == 1:
        return fitting[0]
    if variable is None:
        text = f"expected one array of shape (M, 3) or (3, M), found {len(fitting)}"
        raise ValueError(f"{text}; set variable to the name of the positions: {listed or 'the file has no arrays'}")
    if variable not in shapes:
        raise ValueError(f"it has no variable {variable!r:.80}; known: {listed or 'none'}")
    if variable not in fitting:
        raise ValueError(f"expected real numbers of shape (M, 3) or (3, M) in {variable}, found {listed}")
    return variable


def _fits(shape: tuple[int, ...]) -> bool:
    return len(shape) == 2 and 3 in shape and min(shape) >= 2 and max(shape) <= MAX_ELEMENTS
