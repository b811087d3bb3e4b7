"""Builds the table of runs as a pandas frame, column by column so that a long study fits in memory."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import pandas as pd

from .store import RUN_COLUMNS

__all__ = ["RunsFrame", "cell"]


class RunsFrame:
    """Collects rows of the store into the table of runs; equal texts are kept in memory only once."""

    _TEXT = ("scenario", "formulation", "solver", "swept", "status", "message", "method")
    _NUMBERS = ("objective", "runtime_s", "cpu_s")

    def __init__(self, study: str) -> None:
        self._study = study
        self._columns: dict[str, list[Any]] = {name: [] for name in RUN_COLUMNS if name != "scores"}
        self._scores: dict[str, dict[int, float]] = {}
        self._texts: dict[str, str] = {}

    def add(self, *row: Any) -> None:
        """Add one row with the columns RUN_COLUMNS."""
        number = len(self._columns["run_id"])
        for name, value in zip(RUN_COLUMNS, row, strict=True):
            if name == "scores":
                for score, text in json.loads(value).items():
                    self._scores.setdefault(score, {})[number] = float(text)
            elif name in self._TEXT:
                self._columns[name].append(self._texts.setdefault(value, value))
            elif name in self._NUMBERS:
                self._columns[name].append(math.nan if value is None else value)
            else:
                self._columns[name].append(value)

    def finished(self) -> pd.DataFrame:
        """The table. Score columns come last, sorted; ``rmse_m`` always exists and comes before the objective."""
        columns, rows = self._columns, range(len(self._columns["run_id"]))
        settings = {text: json.loads(text) for text in dict.fromkeys(columns["swept"])}
        swept = dict.fromkeys(key for setting in settings.values() for key in setting)

        def score(name: str) -> list[float]:
            found = self._scores.get(name, {})
            return [found.get(row, math.nan) for row in rows]

        table: dict[str, Any] = {"run_id": columns["run_id"], "study": [self._study] * len(rows)}
        table |= {name: columns[name] for name in ("scenario", "formulation", "solver", "repetition")}
        table |= {f"scenario.{key}": [cell(settings[text].get(key)) for text in columns["swept"]] for key in swept}
        table |= {name: columns[name] for name in ("status", "message")}
        table |= {"rmse_m": score("rmse_m")}
        table |= {name: columns[name] for name in ("objective", "evaluations", "runtime_s", "cpu_s", "instance_seed")}
        table |= {name: columns[name] for name in ("solver_seed", "method")}
        table |= {name: score(name) for name in sorted(self._scores, key=_natural) if name != "rmse_m"}
        return pd.DataFrame(table)


def cell(value: Any) -> Any:
    """A swept value as one cell: numbers and text unchanged, lists and tables as JSON."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _natural(name: str) -> list[tuple[int, str]]:
    """A sort key that puts error_10_m after error_9_m."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
