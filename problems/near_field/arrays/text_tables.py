"""Parses the positions of elements in text: with or without a header, units, names and comments."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

__all__ = ["UNITS", "parsed", "states_unit"]

UNITS: dict[str, tuple[float, float]] = {  # a length in metres is the number times the first and divided by the second
    "m": (1.0, 1.0),
    "dm": (1.0, 10.0),
    "cm": (1.0, 100.0),
    "mm": (1.0, 1000.0),
    "um": (1.0, 1e6),
    "km": (1000.0, 1.0),
    "in": (254.0, 10_000.0),
    "ft": (3048.0, 10_000.0),
}
_SPELLINGS = {
    **{name: name for name in UNITS},
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("µm", "μm", "micron", "microns"), "um"),
    **dict.fromkeys(("inch", "inches", '"'), "in"),
    **dict.fromkeys(("foot", "feet"), "ft"),
}
_NAME = re.compile(
    r"names?|label|id|mic(?:rophone)?s?|elements?|sensors?|antennas?|channels?|ch|no\.?|nr\.?|#|index|number"
)
_COORDINATE = re.compile(
    r"(?:(?:pos(?:ition)?s?|coord(?:inate)?s?)[\s_.-]*)?(?P<axis>[xyz])(?:[\s_.-]*(?:pos(?:ition)?|coord(?:inate)?))?"
    r"(?:[\s_.,/-]*[\[(]\s*(?P<bracket>[^\])]*?)\s*[\])]|\s*[\s_/.]\s*(?P<suffix>\S+))?"
)
_BEFORE_UNIT = re.compile(r"\s+(?=[\[(])")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?|[+-]?\d+,")


def states_unit(line: str) -> bool:
    """Return whether a line is a header that names the unit of a coordinate."""
    cells = _split([line.lstrip("# ").strip("\r\n")])[0] if line.strip() else []
    found = (_COORDINATE.fullmatch(cell.strip().casefold()) for cell in cells)
    return any(each["bracket"] or each["suffix"] for each in found if each)


@dataclass(frozen=True)
class _Header:
    """What the first line says: the columns of the coordinates by axis, their units by axis, and that of the names."""

    columns: dict[str, int]
    units: dict[str, str]
    names: int | None


def parsed(text: str, unit: str | None, most: int) -> tuple[Float[ndarray, "m 3"], tuple[str, ...] | None]:
    """Return the positions [m] in a text and the names of the elements, if it has any.

    unit: unit of the numbers; None: metres, or what the header says.
    most: largest number of rows.

    Without a header, a text with three rows of more than three numbers is transposed. Raises ValueError if the text is
    not a table of numbers.
    """
    lines, comment = _lines(text)
    if len(lines) > most + 1:
        raise ValueError(f"it has {len(lines):,} rows, more than {most:,}")
    if not lines:
        return np.empty((0, 3)), None
    rows = [(number, cells) for (number, _), cells in zip(lines, _split([line for _, line in lines]), strict=True)]
    header = None
    if not any(_is_number(cell) for cell in rows[0][1]):
        header = _header(rows.pop(0)[1], [cells for _, cells in rows[:1]])
    elif comment and (cells := _split([comment])[0]) and any(_COORDINATE.fullmatch(c.casefold()) for c in cells):
        fits = len(cells) == len(rows[0][1])  # as numpy.savetxt writes it, after a "#"
        header = _header(cells, [rows[0][1]]) if fits else None
    if len(rows) > most:
        raise ValueError(f"it has {len(rows):,} rows, more than {most:,}")
    width = len(rows[0][1]) if rows else 3
    for number, cells in rows:
        if len(cells) != width:
            raise ValueError(f"line {number}: expected {width} columns as in the lines before, got {len(cells)}")
    return _with_header(rows, header, unit) if header else _without_header(rows, unit)


def _with_header(
    rows: list[tuple[int, list[str]]], header: _Header, unit: str | None
) -> tuple[Float[ndarray, "m 3"], tuple[str, ...] | None]:
    Q = np.zeros((len(rows), 3))
    if header.units and len(header.units) < len(header.columns):
        without = ", ".join(sorted(set(header.columns) - set(header.units)))
        raise ValueError(f"the header names the units of some coordinates, but not of {without}")
    for axis, column in header.columns.items():
        own = header.units.get(axis)
        if unit is not None and own not in (None, unit):
            text = f'expected unit = "{own}" as in the header of column {axis}, got "{unit}"'
            raise ValueError(f"{text}; leave the option out, or correct the header")
        factor, divisor = UNITS[own or unit or "m"]
        Q[:, "xyz".index(axis)] = [_number(cells[column], number) * factor / divisor for number, cells in rows]
    names = None if header.names is None else tuple(cells[header.names] for _, cells in rows)
    return Q, names


def _without_header(
    rows: list[tuple[int, list[str]]], unit: str | None
) -> tuple[Float[ndarray, "m 3"], tuple[str, ...] | None]:
    names = None
    first = [cells[0] for _, cells in rows]
    if len(rows[0][1]) == 4 and (not _is_number(first[0]) or _counts(first)):
        names, rows = tuple(first), [(number, cells[1:]) for number, cells in rows]
    Q = np.array([[_number(cell, number) for cell in cells] for number, cells in rows])
    if Q.shape[0] == 3 and Q.shape[1] > 3:
        Q = Q.T
    factor, divisor = UNITS[unit or "m"]
    return (Q * factor / divisor), names


def _header(cells: list[str], below: list[list[str]]) -> _Header:
    """Read a header. Raises ValueError if it names no coordinate, or a unit that is not known."""
    columns: dict[str, int] = {}
    units: dict[str, str] = {}
    names = None
    for i, cell in enumerate(cells):
        found = _COORDINATE.fullmatch(cell.strip().casefold())
        if found is None:
            if names is None and _NAME.fullmatch(cell.strip().casefold()):
                names = i
            continue
        axis = found["axis"]
        if axis in columns:
            raise ValueError(f"the header names coordinate {axis} twice")
        columns[axis] = i
        if given := found["bracket"] or found["suffix"]:
            if given not in _SPELLINGS:
                raise ValueError(f"the header has an unknown unit {given!r:.40} of {axis}; known: {', '.join(UNITS)}")
            units[axis] = _SPELLINGS[given]
    if not columns:
        text = f"the header names no coordinate x, y or z, such as x_m or y [mm]: {', '.join(cells)!r:.200}"
        raise ValueError(text)
    texts = [i for i in range(len(cells)) if i not in columns.values() and all(not _is_number(row[i]) for row in below)]
    if names is None and texts and below and len(below[0]) == len(cells):
        names = texts[0]
    return _Header(columns, units, names)


def _lines(text: str) -> tuple[list[tuple[int, str]], str]:
    """Return the lines that are not empty without comments, each with its number, and the last comment above them."""
    lines, comment = [], ""
    for number, line in enumerate(text.splitlines(), start=1):
        kept, mark, rest = (line, "", "") if line.lstrip()[:2] == "#," else line.partition("#")
        if kept.strip():
            lines.append((number, kept.strip("\r\n")))
        elif mark and rest.strip() and not lines:
            comment = rest.strip()
    return lines, comment


def _split(lines: list[str]) -> list[list[str]]:
    """Split lines at semicolons, tabs, commas or blanks, the first of them that the lines have."""
    joined = "\n".join(lines)
    delimiter = next((mark for mark in (";", "\t", ",") if mark in joined), None)
    if delimiter is None:
        return [_BEFORE_UNIT.sub("", line).split() for line in lines]
    rows = []
    for line in lines:  # one at a time, so that an open quotation mark ends with its line
        (row,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
        rows.append([cell.strip() for cell in row])
    if delimiter != ",":
        rows = [[cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in row] for row in rows]
    return [row[:-1] if len(row) > 1 and not row[-1] else row for row in rows]  # a delimiter at the end of a line


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(cell: str, line: int) -> float:
    try:
        return float(cell)
    except ValueError as error:
        raise ValueError(f"line {line}: expected a number, got {cell!r:.80}") from error


def _counts(cells: list[str]) -> bool:
    """Whether the cells are the integers from 0 or 1."""
    start = cells[0]
    return start in ("0", "1") and cells == [str(int(start) + i) for i in range(len(cells))]
