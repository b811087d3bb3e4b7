"""Reads the arrays in files that can hold several: .npz, .mat and HDF5."""

from __future__ import annotations

import importlib
import zipfile
from typing import Any

import numpy as np
from numpy import ndarray

from nfbench import MissingExtra

__all__ = ["MAX_BYTES", "from_hdf5", "from_mat", "from_npz"]

MAX_BYTES = 2**31
"""Size of a file, and of the arrays in it when they are decompressed."""

_NUMBERS = {"double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"}  # of MATLAB


def from_npz(path: str) -> tuple[dict[str, ndarray], None]:
    """Return the arrays of numbers in a .npz file by their names. Arrays of Python objects are left out."""
    with zipfile.ZipFile(path) as archive:
        _bounded(sum(info.file_size for info in archive.infolist()))
    found = {}
    with np.load(path, allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                found[name] = arrays[name]
            except ValueError as error:
                if "pickle" not in str(error) and "Object arrays" not in str(error):
                    raise
    return found, None


def from_mat(path: str) -> tuple[dict[str, ndarray], None]:
    """Return the arrays of numbers in a MATLAB file by their names; those of version 7.3 are HDF5 files."""
    from scipy import io

    with open(path, "rb") as file:  # noqa: PTH123
        head = file.read(520)
    if b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520]):
        return {name: X.T for name, X in from_hdf5(path)[0].items()}, None  # MATLAB stores columns first
    listed = [(name, shape) for name, shape, kind in io.whosmat(path) if kind in _NUMBERS]
    _bounded(16 * sum(int(np.prod(shape, dtype=object)) for _, shape in listed))
    loaded = io.loadmat(path, variable_names=[name for name, _ in listed])
    return {name: np.asarray(loaded[name]) for name, _ in listed}, None


def from_hdf5(path: str) -> tuple[dict[str, ndarray], None]:
    """Return the arrays of numbers in an HDF5 file by their paths in it.

    Pairs of real numbers with the fields r and i, or real and imag, are complex numbers. Links and arrays that are
    stored in other files are not followed. Raises MissingExtra if h5py is not installed.
    """
    try:
        h5py: Any = importlib.import_module("h5py")
    except ImportError as error:
        text = "HDF5 and MATLAB 7.3 files need h5py, which is not installed: pip install 'nfbench[recordings]'"
        raise MissingExtra(text) from error
    found: dict[str, ndarray] = {}
    with h5py.File(path, "r") as file:
        datasets: dict[str, Any] = {}
        file.visititems(lambda name, item: datasets.update({name: item}) if isinstance(item, h5py.Dataset) else None)
        inside = {name: item for name, item in datasets.items() if not item.is_virtual and not item.external}
        numbers = {name: item for name, item in inside.items() if item.shape and _is_numeric(item.dtype)}
        _bounded(sum(item.dtype.itemsize * int(np.prod(item.shape, dtype=object)) for item in numbers.values()))
        for name, item in numbers.items():
            X = item[()]
            if X.dtype.names:
                X = X[X.dtype.names[0]] + 1j * X[X.dtype.names[1]]
            found[name] = X
    return found, None


def _is_numeric(kind: np.dtype[Any]) -> bool:
    names = kind.names or ()
    return kind.kind in "iufc" or [name.lower() for name in names] in (["r", "i"], ["re", "im"], ["real", "imag"])


def _bounded(size: int) -> None:
    if size > MAX_BYTES:
        raise ValueError(f"expected arrays of at most {MAX_BYTES:,} bytes together, got {size:,}")
