"""Reads the file of a manifest, and refuses what no study needs before it costs time or memory."""

from __future__ import annotations

import datetime
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nfbench.core import ManifestError

from .schema import Table

__all__ = ["MANIFEST_FOLDER", "folder_of", "read_manifest"]

MANIFEST_FOLDER = "manifest_folder"  # key of environment.json: that of the manifest, seen from the results folder

MAX_BYTES = 1_000_000  # of the file
MAX_VALUES = 50_000  # numbers, texts, lists and tables in the file
MAX_DEPTH = 32  # of nested lists and tables
MAX_PARTS = 16  # of a dotted key
MAX_KEY = 200  # characters of a key
MAX_TEXT = 10_000  # characters of a text
MAX_DIGITS = 1000  # of a number
INTEGERS = range(-(2**63), 2**63)

_TEXTS = re.compile(  # texts and comments; an unclosed one ends with the line or the file, so that the search is linear
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:""")?'
    r"|'''(?:[^']++|'(?!''))*+(?:''')?"
    r'|"(?:[^"\\\n]++|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|\#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{MAX_PARTS},}}")
_LONG_NUMBER = re.compile(rf"(?<![\w-])\d[\w]{{{MAX_DIGITS},}}")
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")  # also those that turn a line
_CONTROL_IN_TEXT = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def read_manifest(path: Path) -> tuple[Table, str]:
    """Return the tables of a manifest and its text.

    Raises ManifestError if the file cannot be read, is not TOML, or contains what no option accepts: numbers of more
    than 64 bits, dates, control characters, or more of anything than the limits of this module.
    """
    try:
        text = _text(path)
        _check_structure(text)
        table = tomllib.loads(text)
    except _Refused as error:
        raise ManifestError(str(path), [str(error)]) from error
    except OSError as error:
        raise ManifestError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    except tomllib.TOMLDecodeError as error:
        raise ManifestError(str(path), [f"is not valid TOML: {error}"]) from error
    except (ValueError, RecursionError, MemoryError) as error:  # of tomllib, or of a path with a null character
        raise ManifestError(str(path), [f"cannot be read: {type(error).__name__}: {error}"]) from error
    if not table:
        required = "name, scenes, seed, [scenario] and [[formulation]]"
        raise ManifestError(str(path), [f"is empty: expected at least {required}"])
    if problems := list(_problems(table)):
        raise ManifestError(str(path), problems)
    return table, text


def folder_of(path: Path) -> Path:
    """Return the folder that relative paths in a manifest refer to.

    It is the manifest's own folder. For the copy in a results folder it is that of the manifest from which the study
    was run, if it is still there: a file of the results must not take the place of one of the study.
    """
    try:
        facts = json.loads((path.parent / "environment.json").read_text(encoding="utf-8"))
        origin = path.parent / facts[MANIFEST_FOLDER]
        return origin if path.name == "manifest.toml" and origin.is_dir() else path.parent
    except (OSError, ValueError, TypeError, KeyError, RecursionError):  # missing, damaged, or older
        return path.parent


class _Refused(Exception):
    """The file is refused; the message says why."""


def _text(path: Path) -> str:
    """Return the text of a regular file of at most MAX_BYTES bytes."""
    with _open(path) as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise _Refused(f"expected at most {MAX_BYTES:,} bytes, got more; move long lists to files of their own")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        text = f"expected UTF-8, got the byte 0x{content[error.start]:02x} in line {line}"
        raise _Refused(f"{text}; save the file in the encoding UTF-8") from error


def _open(path: Path) -> Any:
    """Open a regular file. It is opened without waiting, as a pipe would wait for its writer forever."""
    if path.is_dir():
        inside = path / "manifest.toml"
        hint = f"that of this results folder is {inside}" if inside.is_file() else "give the path of a .toml file in it"
        raise _Refused(f"expected the file of a manifest, got a folder; {hint}")
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    file = os.fdopen(descriptor, "rb")
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        file.close()
        raise _Refused("expected a regular file, got a pipe or a device; save the manifest to a file first")
    return file


def _check_structure(text: str) -> None:
    """Refuse what would take tomllib long: it is quadratic in the parts of a key, and recursive in the depth."""
    bare = _TEXTS.sub(lambda found: "\n" * found[0].count("\n") + ("" if found[0][0] == "#" else "s"), text)
    values = bare.count(",") + bare.count("=")
    if values > MAX_VALUES:
        raise _Refused(f"expected at most {MAX_VALUES:,} values, got {values:,}; move long lists to files of their own")
    depth = 0
    for found in re.finditer(r"[\[\]{}]", bare):
        depth += 1 if found[0] in "[{" else -1
        if depth > MAX_DEPTH:
            line = bare.count("\n", 0, found.start()) + 1
            raise _Refused(f"expected at most {MAX_DEPTH} nested brackets, got more in line {line}")
    for pattern, expected in ((_LONG_KEY, f"at most {MAX_PARTS} parts of a key"), (_LONG_NUMBER, "64-bit numbers")):
        if found_long := pattern.search(bare):
            line = bare.count("\n", 0, found_long.start()) + 1
            raise _Refused(f"expected {expected}, got {len(found_long[0]):,} characters in line {line}")


def _problems(table: Table) -> Iterator[str]:
    """Yield ``path: message`` for every key and value that no option accepts, in the order of the file."""
    todo: list[tuple[str, Any, int]] = [("", table, 0)]
    while todo:
        path, value, depth = todo.pop()
        problem = _problem(value) if depth <= MAX_DEPTH else f"expected at most {MAX_DEPTH} nested tables, got more"
        if problem:
            yield f"{path}: {problem}"
        elif isinstance(value, dict):
            bad = [(key, problem) for key in value if (problem := _key_problem(key))]
            yield from (f"{path or 'manifest'}: {problem}" for _, problem in bad)
            names = [key for key in value if not _key_problem(key)] if bad else list(value)
            todo += [(f"{path}.{key}" if path else key, value[key], depth + 1) for key in reversed(names)]
        elif isinstance(value, list):
            todo += [(f"{path}[{i}]", value[i], depth + 1) for i in reversed(range(len(value)))]


def _key_problem(key: str) -> str | None:
    if len(key) > MAX_KEY:
        return f"expected keys of at most {MAX_KEY} characters, got one of {len(key):,}: {key[:20]!r}…"
    if key.count(".") >= MAX_PARTS:
        return f"expected keys of at most {MAX_PARTS} parts, got {key.count('.') + 1}: {key[:20]!r}…"
    if _CONTROL.search(key):
        return f"expected keys without control characters, got {key!r}"
    return None


def _problem(value: Any) -> str | None:
    match value:
        case bool() | float():
            return None
        case int() if value not in INTEGERS:
            return f"expected an integer between -2^63 and 2^63 - 1, got one of {value.bit_length()} bits"
        case str() if len(value) > MAX_TEXT:
            return f"expected at most {MAX_TEXT:,} characters, got {len(value):,}: {value[:20]!r}…"
        case str() if _CONTROL_IN_TEXT.search(value):
            found = _CONTROL_IN_TEXT.findall(value)[0]
            return f"expected text without control characters, got {found!r} in {value[:60]!r}"
        case datetime.date() | datetime.time():
            expected = "expected a number, text, list or table"
            return f"{expected}, got the date or time {value.isoformat()}; write text in quotes"
    return None
