"""Reads the rows in the pages of an SQLite file one by one, also where SQLite itself refuses the file.

A damaged page costs the rows in it and no others, even if it is the first page or one that leads to all others. The
format is described at https://www.sqlite.org/fileformat2.html.
"""

from __future__ import annotations

import contextlib
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["carved"]

_INDEX, _INDEX_LEAF, _TABLE_LEAF = 0x02, 0x0A, 0x0D  # kinds of pages with rows; WITHOUT ROWID tables are indexes
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # serial type → bytes
_WAL_HEAD, _FRAME_HEAD = 32, 24
_USUAL = 4096


def carved(path: Path) -> Iterator[tuple[int | None, tuple[Any, ...]]]:
    """Yield (rowid, columns) of every row that can be read in the file and its write-ahead log.

    The rowid is None in tables without one. Rows of all tables are mixed, and deleted rows may be among them.
    """
    wal = path.with_name(f"{path.name}-wal")
    frames = wal.read_bytes() if wal.is_file() else b""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        stated = int.from_bytes(data[16:18], "big")
        sizes = [size for size in dict.fromkeys([65536 if stated == 1 else stated, _USUAL]) if _is_size(size)]
        if len(sizes) > 1:  # the stated one may be damaged
            sizes.sort(key=lambda size: -sum(1 for _ in _Pages(data, frames, size).rows()))
        yield from _Pages(data, frames, sizes[0]).rows()


def _is_size(size: int) -> bool:
    return 512 <= size <= 65536 and not size & (size - 1)


@dataclass
class _Pages:
    """The pages of a file: those of the log in place of those that they replace."""

    data: mmap.mmap
    frames: bytes
    size: int
    logged: dict[int, int] = field(default_factory=dict)  # page number → place in ``frames``

    def __post_init__(self) -> None:
        salt = self.frames[16:24]
        step = _FRAME_HEAD + self.size
        for place in range(_WAL_HEAD, len(self.frames) - step + 1, step):
            if self.frames[place + 8 : place + 16] == salt:
                self.logged[int.from_bytes(self.frames[place : place + 4], "big")] = place + _FRAME_HEAD

    def page(self, number: int) -> bytes:
        if number in self.logged:
            return self.frames[self.logged[number] : self.logged[number] + self.size]
        return self.data[(number - 1) * self.size : number * self.size]

    def rows(self) -> Iterator[tuple[int | None, tuple[Any, ...]]]:
        for number in range(1, max([len(self.data) // self.size, *self.logged]) + 1):
            page = self.page(number)
            head = 100 if number == 1 else 0
            if len(page) < self.size or page[head] not in (_INDEX, _INDEX_LEAF, _TABLE_LEAF):
                continue
            first = head + (12 if page[head] == _INDEX else 8)
            for i in range(min(int.from_bytes(page[head + 3 : head + 5], "big"), self.size // 2)):
                place = int.from_bytes(page[first + 2 * i : first + 2 * i + 2], "big")
                try:
                    yield self._cell(page, page[head], place)
                except (ValueError, IndexError, struct.error):  # this row is damaged
                    continue

    def _cell(self, page: bytes, kind: int, place: int) -> tuple[int | None, tuple[Any, ...]]:
        place += 4 if kind == _INDEX else 0
        length, place = _varint(page, place)
        rowid = None
        if kind == _TABLE_LEAF:
            rowid, place = _varint(page, place)
        return rowid, _record(self._payload(page, kind, place, length))

    def _payload(self, page: bytes, kind: int, place: int, length: int) -> bytes:
        if length > len(self.data) + len(self.frames):
            raise ValueError("longer than the file")
        most = self.size - 35 if kind == _TABLE_LEAF else (self.size - 12) * 64 // 255 - 23
        if length <= most:
            return _bytes(page, place, length)
        least = (self.size - 12) * 32 // 255 - 23
        local = least + (length - least) % (self.size - 4)
        local = local if local <= most else least
        parts = [_bytes(page, place, local)]
        following, left = int.from_bytes(_bytes(page, place + local, 4), "big"), length - local
        while left > 0:
            page = self.page(following) if following else b""
            parts.append(_bytes(page, 4, min(left, self.size - 4)))
            following, left = int.from_bytes(page[:4], "big"), left - len(parts[-1])
        return b"".join(parts)


def _bytes(data: bytes, place: int, count: int) -> bytes:
    found = data[place : place + count]
    if len(found) < count:
        raise ValueError("beyond the end")
    return found


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """A number of 1 to 9 bytes, and the place after it."""
    value = 0
    for i in range(8):
        byte = data[place + i]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, place + i + 1
    return value << 8 | data[place + 8], place + 9


def _record(payload: bytes) -> tuple[Any, ...]:
    """The columns of a record."""
    end, place = _varint(payload, 0)
    kinds = []
    while place < end:
        kind, place = _varint(payload, place)
        kinds.append(kind)
    columns = []
    for kind in kinds:
        value, place = _column(payload, kind, place)
        columns.append(value)
    return tuple(columns)


def _column(payload: bytes, kind: int, place: int) -> tuple[Any, int]:
    if kind == 0:
        return None, place
    if kind in _INTEGERS:
        size = _INTEGERS[kind]
        return int.from_bytes(_bytes(payload, place, size), "big", signed=True), place + size
    if kind == 7:
        return struct.unpack(">d", _bytes(payload, place, 8))[0], place + 8
    if kind in (8, 9):
        return kind - 8, place
    if kind < 12:
        raise ValueError(f"serial type {kind}")
    size = (kind - 12) // 2
    content = _bytes(payload, place, size)
    with contextlib.suppress(UnicodeDecodeError):  # else it stays bytes, and the row's other columns can be read
        return (content if kind % 2 == 0 else content.decode("utf-8")), place + size
    return content, place + size
