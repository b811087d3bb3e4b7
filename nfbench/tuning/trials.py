"""The folder of a tuning: ``trials.csv``, row by row, and ``tuning.json``, which says what it is a tuning of."""

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
    """One setting on the training scenes.

    score: NaN where a run failed or the setting is impossible. error: the score of a run that it is the mean log of.
    message: why there is no score, in one line.
    """

    number: int
    options: dict[str, Any]
    score: float
    error: str
    message: str = ""


@final
class Trials:
    """What is stored of a tuning; new trials are added behind.

    A last line that was not written whole counts as not written. Nothing is touched before the first ``add``. Raises
    StoreError where the folder has another tuning than ``identity``, or one that cannot be read.
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
        """The stored trial of that number; None where there is none.

        Raises StoreError where it is of another setting than ``options``, which the tuner asks for now.
        """
        if number >= len(self._rows):
            return None
        _, score, error, message, *cells = self._rows[number]
        differing = [
            f"{name} is {there} there, {here} now"
            for name, there, here in zip(self.names, cells, self._cells(options), strict=True)
            if there != here
        ]
        if differing:
            then, now = self._written_with, version("optuna")
            raise StoreError(
                f"{self.folder / TABLE} cannot be gone on with: trial {number} is another setting than now "
                f"({'; '.join(differing)}); it was begun with optuna {then}, here is {now}; {ADVICE}"
            )
        return Trial(number, options, float(score or "nan"), error, message)

    def add(self, trial: Trial) -> None:
        """Write one more row; it is on the disk when this returns."""
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
        """The version of Optuna that the folder's tuning was begun with; none where there is no tuning yet."""
        path = self.folder / IDENTITY
        if not path.exists():
            if found := [name for name in (TABLE, TUNED) if (self.folder / name).exists()]:
                raise StoreError(f"{self.folder} has {' and '.join(found)} of a tuning without {IDENTITY}; {ADVICE}")
            return ""
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            there, written_with = found["tuning"], str(found["optuna"])
        except (ValueError, TypeError, KeyError) as error:
            raise StoreError(f"{path} cannot be read: {error}; {ADVICE}") from error
        if differing := list(_differences(there, self.identity)):
            raise StoreError(f"{self.folder} belongs to another tuning: {'; '.join(differing)}; {ADVICE}")
        return written_with

    def _read(self) -> tuple[list[list[str]], int]:
        """The rows that are whole, and where they end [bytes]."""
        path = self.folder / TABLE
        data = path.read_bytes() if path.exists() else b""
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


def _differences(there: Any, here: Any, path: str = "") -> Iterator[str]:
    """Where two identities differ, in words."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in {**there, **here}:
            yield from _differences(there.get(key), here.get(key), f"{path}.{key}" if path else key)
    elif isinstance(there, list) and isinstance(here, list):
        if len(there) != len(here):
            yield f"{path} are {len(there)} there, {len(here)} were asked for"
        else:
            for i, pair in enumerate(zip(there, here, strict=True)):
                yield from _differences(*pair, f"{path}[{i}]")
    elif there != here:
        yield f"{path} is {there!r} there, {here!r} was asked for"
