"""Checks of every value that is read from ``runs.sqlite``: what comes out has the right type and a possible value."""

from __future__ import annotations

import functools
import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from nfbench.core import Status, Trace

__all__ = ["checked_row", "inflated", "is_positive", "packed", "settings", "unpacked"]

LARGEST = 2**26  # bytes of a run's traces; a million times more is no trace but damage, or an attack
_FIELDS = ("evaluations", "seconds", "values", "points")
_HEADER = re.compile(  # of an array of NumPy's format
    rb"\{'descr': '(<[if]8)', 'fortran_order': False, 'shape': \((\d+(?:, \d+)*,?)\), \} *\n"
)


def checked_row(table: str, names: Sequence[str], row: Sequence[Any]) -> list[Any]:
    """The values of a row of a table: ``scores`` and ``columns`` as a dict, ``estimate`` and ``point`` as lists,
    ``truth`` and ``estimated`` as arrays (n, 3) or (n, 6).

    ``swept`` and ``traces`` are checked by ``settings`` and ``unpacked`` where they are used. Raises ValueError, which
    names the row and the column, if a value is not one that a run can have.
    """
    values, name = [], ""
    try:
        for name, value in zip(names, row, strict=True):
            values.append(_CHECKS[name](value))
    except Exception as error:
        reason = error if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(f"table {table}, row {row[0]!r:.40}, column {name}: {reason}") from error
    return values


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expected text, found {value!r:.80}")
    value.encode("utf-8")  # a lone surrogate cannot be written to any file
    return value


def _status(value: Any) -> str:
    return str(Status(_text(value)))


def _number(value: Any) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float):
        raise ValueError(f"expected a number, found {value!r:.80}")
    return float(value)


def _whole(value: Any) -> int:
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"expected a whole number >= 0, found {value!r:.80}")
    return value


def _time(value: Any) -> float | None:
    time = _number(value)
    if time is not None and not 0 <= time < 1e11:
        raise ValueError(f"expected a time in seconds since 1970, found {value!r:.80}")
    return time


@functools.lru_cache(maxsize=4096)
def settings(text: Any) -> dict[str, Any]:
    """The swept values of a run by key, from their JSON. The same text gives the same dict: do not change it."""
    found = json.loads(_text(text))
    if not isinstance(found, dict):
        raise ValueError(f"expected the swept values as a table, found {text!r:.80}")
    json.dumps(found, ensure_ascii=False).encode("utf-8")  # raises ValueError for lone surrogates
    return found


def _swept(value: Any) -> str:
    settings(value)
    return str(value)


def _scores(value: Any) -> dict[str, float]:
    found = json.loads(_text(value))
    if not isinstance(found, dict):
        raise ValueError(f"expected the scores as a table, found {value!r:.80}")
    return {_text(name): float(score) for name, score in found.items()}


def _estimate(value: Any) -> Any:
    found = json.loads(_text(value))
    if found is not None:
        np.array(found, dtype=np.float64)
    return found


def _point(value: Any) -> list[float] | None:
    found = _estimate(value)
    if found is not None and np.ndim(found) != 1:
        raise ValueError(f"expected a point, found {value!r:.80}")
    return None if found is None else [float(coordinate) for coordinate in found]


def _places(value: Any) -> ndarray:
    found = np.array(json.loads(_text(value)), dtype=np.float64)
    if not found.size:
        return np.empty((0, 3))
    if found.ndim != 2 or found.shape[1] not in (3, 6):
        raise ValueError(f"expected a list of points [x, y, z] or [x, y, z, φ, ψ, r], found {value!r:.80}")
    return found


def _blob(value: Any) -> bytes:
    if not isinstance(value, bytes):
        raise ValueError(f"expected bytes, found {value!r:.80}")
    return value


_CHECKS: dict[str, Callable[[Any], Any]] = {
    "ordinal": _whole,
    "run_id": _text,
    "scenario": _text,
    "formulation": _text,
    "solver": _text,
    "method": _text,
    "repetition": _whole,
    "swept": _swept,
    "instance_seed": _whole,
    "solver_seed": _whole,
    "status": _status,
    "message": _text,
    "objective": _number,
    "evaluations": _whole,
    "runtime_s": _number,
    "cpu_s": _number,
    "scores": _scores,
    "estimate": _estimate,
    "traces": _blob,
    "reference_id": _text,
    "scene": _whole,
    "value": _number,
    "gap": _number,
    "certified": _whole,
    "step": _whole,
    "columns": _scores,
    "point": _point,
    "seconds": _number,
    "truth": _places,
    "estimated": _places,
    "host": _text,
    "worker": _whole,
    "finished": _time,
}


def packed(traces: tuple[Trace, ...]) -> bytes:
    """The traces as one compressed block of bytes."""
    if not traces:
        return b""
    buffer = io.BytesIO()
    arrays = {f"{name}{i}": getattr(trace, name) for i, trace in enumerate(traces) for name in _FIELDS}
    np.savez(buffer, **arrays)
    return zlib.compress(buffer.getvalue(), 1)


def unpacked(blob: bytes) -> tuple[Trace, ...]:
    """The traces in a block of bytes. Raises an exception, of whatever kind, if there are none."""
    if not blob:
        return ()
    with zipfile.ZipFile(io.BytesIO(inflated(blob))) as archive:
        if sum(member.file_size for member in archive.infolist()) > LARGEST:
            raise ValueError(f"expected traces of at most {LARGEST} bytes")
        arrays = {name.removesuffix(".npy"): _array(archive.read(name)) for name in archive.namelist()}
    traces = tuple(Trace(*(arrays[f"{name}{i}"] for name in _FIELDS)) for i in range(len(arrays) // 4))
    if len(arrays) != 4 * len(traces):
        raise ValueError(f"expected four arrays per trace, found {len(arrays)}")
    for trace in traces:
        _check(trace)
    return traces


def _array(content: bytes) -> ndarray:
    """The array in a file of NumPy's format; plain numbers are read without its general parser, which is slow."""
    start = 10 + int.from_bytes(content[8:10], "little")
    found = _HEADER.fullmatch(content[10:start]) if content[:8] == b"\x93NUMPY\x01\x00" else None
    if found is None:
        array: ndarray = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
        return array
    shape = tuple(int(n) for n in found[2].split(b",") if n.strip())
    return np.frombuffer(content, found[1].decode(), math.prod(shape), start).reshape(shape).copy()


def inflated(blob: bytes) -> bytes:
    """The content of a compressed block, which is complete, undamaged and not too large."""
    if not blob:
        return b""
    inflater = zlib.decompressobj()
    content = inflater.decompress(blob, LARGEST)
    if not inflater.eof:
        raise ValueError(f"expected complete traces of at most {LARGEST} bytes")
    return content


def _check(trace: Trace) -> None:
    rows = len(trace.evaluations) if trace.evaluations.ndim == 1 else -1
    columns: tuple[ndarray, ...] = (trace.seconds, trace.values)
    if any(column.shape != (rows,) for column in columns) or trace.points.ndim != 2 or len(trace.points) != rows:
        raise ValueError("expected columns of equal length in a trace")
    if trace.evaluations.dtype.kind not in "iu" or any(c.dtype.kind != "f" for c in (*columns, trace.points)):
        raise ValueError("expected numbers in a trace")
    if rows and (trace.evaluations[0] < 1 or (np.diff(trace.evaluations) < 0).any()):
        raise ValueError("expected increasing evaluations in a trace")


def is_positive(text: str) -> bool:
    """Whether the text is a finite number above 0."""
    try:
        return 0 < float(text) < math.inf
    except ValueError:
        return False
