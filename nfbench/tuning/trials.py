"""The folder of a tuning: ``trials.csv`` with one row per trial, and ``tuning.json``, which identifies the tuning."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, final

from nfbench.core import StoreError
from nfbench.results import write_whole

__all__ = ["Trial", "Trials"]

TABLE, IDENTITY, TUNED = "trials.csv", "tuning.json", "tuned.toml"
ADVICE = "choose another folder with --out, or move this one aside with --fresh"


@dataclass(frozen=True)
class Trial:
    """The result of one setting on the training scenes.

    number: number of the trial; 0 is the default setting.
    options: values of the tuned options.
    score: mean of log10 of the error over the training scenes; NaN if a run failed or the setting is invalid.
    error: name of the error measure, e.g. ``rmse_m``.
    message: the reason why there is no score, in one line; empty if there is one.
    """

    number: int
    options: dict[str, Any]
    score: float
    error: str
    message: str = ""


@final
class Trials:
    """The stored trials of a tuning, to which new trials are appended.

    An incomplete last line is ignored. No file is changed before the first ``add``.

    folder: folder of the tuning.
    identity: everything that determines the trials and their scores, as plain data.
    names: names of the tuned options.

    Raises StoreError if the folder holds a tuning with another identity, or one that cannot be read.
    """

    def __init__(self, folder: Path, identity: dict[str, Any], names: Sequence[str]) -> None:
        self.folder, self.names = folder, list(names)
        self._header = ["trial", "score", "error", "message", *names]
        self.identity = json.loads(json.dumps(identity))
        self._written_with = self._checked()
        self._rows, self._size = self._read()

    def __len__(self) -> int:
        return len(self._rows)

    def replay(self, number: int, options: dict[str, Any]) -> Trial | None:
        """The stored trial of that number; None if there is none.

        Raises StoreError if the stored options differ from ``options``, which the sampler proposes now.
        """
        if number >= len(self._rows):
            return None
        _, score, error, message, *cells = self._rows[number]
        differing = [
            f"{name} was {stored}, now {proposed}"
            for name, stored, proposed in zip(self.names, cells, self._cells(options), strict=True)
            if stored != proposed
        ]
        if differing:
            then, now = self._written_with, version("optuna")
            raise StoreError(
                f"{self.folder / TABLE} cannot be resumed: the sampler proposes other options for trial {number} "
                f"({'; '.join(differing)}); started with optuna {then}, resumed with optuna {now}; {ADVICE}"
            )
        return Trial(number, options, float(score or "nan"), error, message)

    def add(self, trial: Trial) -> None:
        """Append one row; it is on disk when this returns."""
        if not self._rows:
            text = json.dumps({"tuning": self.identity, "optuna": version("optuna")}, indent=2) + "\n"
            write_whole(self.folder / IDENTITY, lambda draft: draft.write_text(text, encoding="utf-8"), TABLE)
        score = "" if math.isnan(trial.score) else repr(trial.score)
        row = [str(trial.number), score, trial.error, trial.message, *self._cells(trial.options)]
        buffer = io.StringIO(newline="")
        csv.writer(buffer).writerows([row] if self._rows else [self._header, row])
        data = buffer.getvalue().encode()
        with (self.folder / TABLE).open("ab") as file:
            file.truncate(self._size)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self._rows.append(row)
        self._size += len(data)

    def _cells(self, options: dict[str, Any]) -> list[str]:
        return ["" if options[name] is None else str(options[name]) for name in self.names]

    def _checked(self) -> str:
        """The version of Optuna with which the stored tuning was started; empty if there is no tuning yet."""
        path = self.folder / IDENTITY
        if not _is_file(path):
            if found := [name for name in (TABLE, TUNED) if (self.folder / name).exists()]:
                raise StoreError(f"{self.folder} has {' and '.join(found)} but no {IDENTITY}; {ADVICE}")
            return ""
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            stored, written_with = found["tuning"], str(found["optuna"])
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise StoreError(f"{path} cannot be read: {error}; {ADVICE}") from error
        if differing := list(_differences(stored, self.identity)):
            raise StoreError(f"{self.folder} belongs to another tuning: {'; '.join(differing)}; {ADVICE}")
        return written_with

    def _read(self) -> tuple[list[list[str]], int]:
        """The complete rows, and the size of the file up to their end [bytes]."""
        path = self.folder / TABLE
        data = path.read_bytes() if _is_file(path) else b""
        data = data[: data.rfind(b"\n") + 1]
        try:
            header, *rows = [*csv.reader(io.StringIO(data.decode(), newline=""), strict=True)] or [self._header]
            if header != self._header:
                raise ValueError(f"expected the columns {', '.join(self._header)}, got {', '.join(header)}")
            for number, row in enumerate(rows):
                if len(row) != len(header) or row[0] != str(number):
                    raise ValueError(f"expected trial {number} in line {number + 2}, got {','.join(row)}")
                float(row[1] or "nan")
        except (ValueError, csv.Error) as error:
            raise StoreError(f"{path} cannot be read: {error}; {ADVICE}") from error
        return rows, len(data) if rows else 0


def _is_file(path: Path) -> bool:
    """Whether there is a file. Raises StoreError if there is something else, such as a folder or a pipe."""
    if path.exists() and not path.is_file():
        raise StoreError(f"{path}: expected a file, found something else; {ADVICE}")
    return path.exists()


def _differences(stored: Any, expected: Any, path: str = "") -> Iterator[str]:
    """Describe where two identities differ."""
    if isinstance(stored, dict) and isinstance(expected, dict):
        for key in {**stored, **expected}:
            yield from _differences(stored.get(key), expected.get(key), f"{path}.{key}" if path else key)
    elif isinstance(stored, list) and isinstance(expected, list):
        if len(stored) != len(expected):
            yield f"expected {len(expected)} {path}, found {len(stored)}"
        else:
            for i, pair in enumerate(zip(stored, expected, strict=True)):
                yield from _differences(*pair, f"{path}[{i}]")
    elif stored != expected:
        yield f"expected {path} = {expected!r}, found {stored!r}"
