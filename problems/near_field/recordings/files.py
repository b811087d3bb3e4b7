"""Reads the array of numbers that a file contains. Nothing in a file is executed or unpickled."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from nfbench import NfbenchError

from .containers import MAX_BYTES, from_hdf5, from_mat, from_npz
from .tables import from_text

__all__ = ["Contents", "content_hash", "read_array"]

_Arrays = dict[str, ndarray]


class Contents(NamedTuple):
    """What a file contains.

    array: finite numbers, float64 or complex128, read-only.
    rate_hz: sampling rate that the file states [Hz]; None if it states none.
    """

    array: ndarray
    rate_hz: float | None = None


def read_array(path: str, variable: str | None = None, length: int | None = None) -> Contents:
    """Return the array of numbers in a file.

    path: path of a .npy, .npz, .mat, .h5, .hdf5, .wav, .csv, .txt or .tsv file; its suffix decides how it is read.
    variable: name of the array in a file that can hold several; None: the only one with two or more axes.
    length: length of an axis of the array that is looked for, which decides between several arrays.
    Raises ValueError if there is no such array, or if it does not consist of finite numbers, and MissingExtra if the
    file needs h5py, which is not installed.
    """
    return _read(path, variable, length, *_stamp(path))


def content_hash(path: str) -> str:
    """Return the SHA-256 hash of a file's contents, in hexadecimal."""
    return _hash(path, *_stamp(path))


def _stamp(path: str) -> tuple[int, int]:
    try:
        found = Path(path).stat()
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}: {path}") from error
    if found.st_size > MAX_BYTES:
        raise ValueError(f"expected a file of at most {MAX_BYTES:,} bytes, got {found.st_size:,}: {path}")
    return found.st_mtime_ns, found.st_size


@functools.lru_cache(maxsize=64)
def _hash(path: str, modified_ns: int, size: int) -> str:
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@functools.lru_cache(maxsize=4)
def _read(path: str, variable: str | None, length: int | None, modified_ns: int, size: int) -> Contents:
    """Read a file; whatever a library raises about a damaged one becomes a ValueError with the file's name."""
    name = Path(path).name
    try:
        arrays, rate_hz = _READERS[_suffix(path)](path)
        X = _chosen(arrays, variable, length)
        if X.dtype.kind not in "iufc":
            raise ValueError(f"expected numbers, got {X.dtype}")
        X = np.array(X, dtype=np.complex128 if X.dtype.kind == "c" else np.float64)
        bad = ~np.isfinite(X)
        if bad.any():
            place = [int(i) for i in np.argwhere(bad)[0]]
            text = f"expected finite numbers, got {X[tuple(place)]} at {place}, counted from 0"
            raise ValueError(f"{text}, and {bad.sum() - 1} more" if bad.sum() > 1 else text)
    except NfbenchError:
        raise
    except MemoryError as error:
        raise ValueError(f"{name}: out of memory: its array is too large") from error
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    except Exception as error:  # of a library that meets a damaged file
        raise ValueError(f"{name}: the file is damaged or not of this format: {error}") from error
    X.flags.writeable = False
    return Contents(X, rate_hz)


def _suffix(path: str) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise ValueError(f"expected a file with the suffix {', '.join(_READERS)}, got {suffix or 'none'}")
    return suffix


def _chosen(arrays: _Arrays, variable: str | None, length: int | None) -> ndarray:
    """Return the array with this name, or the only one that can be meant."""
    shapes = ", ".join(f"{name} {X.shape}" for name, X in list(arrays.items())[:20]) or "none"
    if variable is not None:
        if list(arrays) == [""]:
            raise ValueError(f"variable: a file of this format holds one array without a name, got {variable!r}")
        if variable not in arrays:
            raise ValueError(f"variable: expected the name of an array in the file ({shapes}), got {variable!r}")
        return arrays[variable]
    tables = {name: X for name, X in arrays.items() if X.ndim >= 2 and X.dtype.kind in "iufc" and X.size > 1}
    if len(tables) > 1 and length is not None:
        tables = {name: X for name, X in tables.items() if length in X.shape} or tables
    if len(arrays) == 1 and "" in arrays:
        return arrays[""]
    if len(tables) != 1:
        raise ValueError(f"expected one array of numbers with two or more axes; name it with variable; found: {shapes}")
    return next(iter(tables.values()))


def _from_npy(path: str) -> tuple[_Arrays, None]:
    with Path(path).open("rb") as file:
        if file.read(6) != b"\x93NUMPY":
            raise ValueError("the file is damaged or not of this format: it does not begin like a .npy file")
    X = np.load(path, mmap_mode="r", allow_pickle=False)  # mapped, as a header may promise more numbers than there are
    if X.nbytes > MAX_BYTES:
        raise ValueError(f"expected an array of at most {MAX_BYTES:,} bytes, got {X.nbytes:,}")
    return {"": X}, None


def _from_wav(path: str) -> tuple[_Arrays, float]:
    """Read samples (n, channels); integers are scaled so that the full scale is ±1."""
    import warnings

    from scipy.io import wavfile

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about chunks that are not samples
        rate, X = wavfile.read(path)
    scaled = X.reshape(len(X), -1)
    if X.dtype.kind == "u":
        scaled = (scaled.astype(np.float64) - 128) / 128
    elif X.dtype.kind == "i":
        scaled = scaled / -float(np.iinfo(X.dtype).min)
    return {"": scaled}, float(rate)


_READERS: dict[str, Callable[[str], tuple[_Arrays, float | None]]] = {
    ".npy": _from_npy,
    ".npz": from_npz,
    ".mat": from_mat,
    ".h5": from_hdf5,
    ".hdf5": from_hdf5,
    ".wav": _from_wav,
    ".csv": from_text,
    ".txt": from_text,
    ".tsv": from_text,
}
