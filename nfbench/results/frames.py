"""Builds the table of runs as a pandas frame, column by column so that a long study fits in memory."""

from __future__ import annotations

import math
import re
from collections import Counter
from typing import Any

import pandas as pd

from nfbench.study import swept_column

from .cells import cell
from .store import RUN_COLUMNS
from .values import settings

__all__ = ["RunsFrame"]


class RunsFrame:
    """Collects rows of the store into the table of runs; equal texts are kept in memory only once."""

    _TEXT = ("scenario", "formulation", "solver", "swept", "status", "message", "method")
    _NUMBERS = ("objective", "runtime_s", "cpu_s")

    def __init__(self, study: str, runs_per_scene: int = 1) -> None:
        self._study, self._runs_per_scene = study, runs_per_scene
        self._columns: dict[str, list[Any]] = {name: [] for name in RUN_COLUMNS if name != "scores"}
        self._scores: dict[str, dict[int, float]] = {}
        self._texts: dict[str, str] = {}

    def add(self, *row: Any) -> None:
        """Add one row with the columns RUN_COLUMNS."""
        number = len(self._columns["run_id"])
        for name, value in zip(RUN_COLUMNS, row, strict=True):
            if name == "scores":
                for score, found in value.items():
                    self._scores.setdefault(score, {})[number] = found
            elif name in self._TEXT:
                self._columns[name].append(self._texts.setdefault(value, value))
            elif name in self._NUMBERS:
                self._columns[name].append(math.nan if value is None else value)
            else:
                self._columns[name].append(value)

    def finished(self) -> pd.DataFrame:
        """The table. Score columns come last, sorted; ``rmse_m`` always exists and comes before the objective."""
        columns, rows = self._columns, range(len(self._columns["run_id"]))
        found = {text: settings(text) for text in dict.fromkeys(columns["swept"])}
        swept = next(iter(found.values()), {})
        self._check(found)

        def score(name: str) -> list[float]:
            found = self._scores.get(name, {})
            return [found.get(row, math.nan) for row in rows]

        table: dict[str, Any] = {"run_id": columns["run_id"], "study": [self._study] * len(rows)}
        table |= {name: columns[name] for name in ("scenario", "formulation", "solver", "repetition")}
        for name, part in (("scene", 0), ("run", 1)):
            table[name] = [divmod(number, self._runs_per_scene)[part] for number in columns["repetition"]]
        table |= {swept_column(key): [cell(found[text][key]) for text in columns["swept"]] for key in swept}
        table |= {name: columns[name] for name in ("status", "message")}
        table |= {"rmse_m": score("rmse_m")}
        table |= {name: columns[name] for name in ("objective", "evaluations", "runtime_s", "cpu_s", "instance_seed")}
        table |= {name: columns[name] for name in ("solver_seed", "method")}
        table |= {name: score(name) for name in sorted(self._scores, key=_natural) if name != "rmse_m"}
        return pd.DataFrame(table)

    def _check(self, found: dict[str, dict[str, Any]]) -> None:
        """Raise ValueError if rows contradict each other, which no study does."""
        columns = self._columns
        if len({tuple(setting) for setting in found.values()}) > 1:
            raise ValueError(f"table plan: expected the same swept keys in every row, found {list(found)[:2]}")
        runs = list(zip(columns["swept"], columns["method"], columns["repetition"], strict=True))
        if len(set(runs)) < len(runs):
            twice = next(run for run, count in Counter(runs).items() if count > 1)
            raise ValueError(f"table plan: two runs have the same swept values, method and repetition: {twice}")


def _natural(name: str) -> list[tuple[int, str]]:
    """A sort key that puts error_10_m after error_9_m."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
