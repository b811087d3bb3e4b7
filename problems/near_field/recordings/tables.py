"""Reads a table of real or complex numbers from text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy import ndarray

__all__ = ["from_text"]

MAX_TEXT = 2**28  # bytes


def from_text(path: str) -> tuple[dict[str, ndarray], None]:
    """Return the table in a text file, whose cells are separated by commas, semicolons, tabs or blanks.

    Complex numbers are written like 1+2j or 1+2i, or in pairs of columns whose names in the header have re (or real)
    and im (or imag), such as re_1, im_1, re_2, im_2. Empty lines and what follows a # are ignored. The first line may
    be a header. Raises ValueError if there are other cells, or rows of different lengths.
    """
    if (size := Path(path).stat().st_size) > MAX_TEXT:
        raise ValueError(f"expected text of at most {MAX_TEXT:,} bytes, got {size:,}; a .npy file may be larger")
    text = Path(path).read_text(encoding="utf-8-sig")
    lines = [(n, cells) for n, line in enumerate(text.splitlines(), start=1) if (cells := line.split("#")[0].strip())]
    if not lines:
        raise ValueError("expected a table of numbers, got no lines")
    separator = next((mark for mark in (";", "\t", ",") if mark in lines[0][1]), None)
    rows = [(n, [cell.strip() for cell in line.split(separator)]) for n, line in lines]
    header: list[str] = []
    if any(_number(cell) is None for cell in rows[0][1]):
        header = rows.pop(0)[1]
    width = len(rows[0][1]) if rows else 0
    table: list[list[complex]] = []
    for n, row in rows:
        numbers = [_number(cell) for cell in row]
        for column, number in enumerate(numbers):
            if number is None:
                raise ValueError(f"expected a number in line {n}, column {column + 1}, got {row[column][:40]!r}")
        if len(row) != width:
            raise ValueError(f"expected {width} numbers in line {n}, as in the first row, got {len(row)}")
        table.append([number for number in numbers if number is not None])
    if not table:
        raise ValueError("expected a table of numbers, got a header only")
    X = np.array(table)
    if pairs := _pairs(header, width):
        return {"": X[:, pairs[0]] + 1j * X[:, pairs[1]]}, None
    return {"": X}, None


def _number(cell: str) -> float | complex | None:
    try:
        return float(cell)
    except ValueError:
        pass
    try:
        return complex(re.sub(r"[ij]\)?$", "j", cell.strip("()").replace(" ", "")))
    except ValueError:
        return None


def _pairs(header: list[str], width: int) -> tuple[list[int], list[int]] | None:
    """Return the columns of the real and of the imaginary parts, in the same order; None if there are none."""
    parts = [re.search(r"(?:^|[^a-z])(re|im)(?:al|ag)?(?![a-z])", name.lower()) for name in header]
    if len(header) != width or not all(parts):
        return None
    kinds = [part.group(1) if part else "" for part in parts]
    real, imag = ([i for i, kind in enumerate(kinds) if kind == name] for name in ("re", "im"))
    if len(real) != len(imag):
        raise ValueError(f"expected as many columns of real as of imaginary parts, got {len(real)} and {len(imag)}")
    return real, imag
