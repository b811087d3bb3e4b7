"""The study that a page shows: its methods, points and targets in the order in which the page shows them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
import pandas as pd

from nfbench.analysis import ALL, Block, Outcomes, outcomes, summarize, swept_columns
from nfbench.core import printable
from nfbench.figures import name_of, places, setting, text_of
from nfbench.results import Evidence, Results
from nfbench.study import read_labels

__all__ = ["Study", "number", "numbers", "words"]

SHOWN = 8  # methods that the figures show at first
BEST = 2  # of these, the best ones whatever their formulation; the best of each formulation comes next
DIGITS = 4  # significant


@final
@dataclass(frozen=True, eq=False)
class Study:
    """A results folder with at least one finished run.

    results: the folder. evidence: its conclusions.
    """

    results: Results
    evidence: Evidence

    @cached_property
    def meta(self) -> dict[str, str]:
        return self.results.meta

    @cached_property
    def runs(self) -> pd.DataFrame:
        return self.evidence.table

    @property
    def error(self) -> str:
        return self.meta["error"]

    @cached_property
    def summary(self) -> pd.DataFrame:
        """One row per point and method: the columns of ``summary.csv``."""
        with np.errstate(all="ignore"):  # scores may be infinite
            return summarize(self.runs, error=self.error, outlier_m=float(self.meta["outlier_m"]))

    @cached_property
    def target_table(self) -> pd.DataFrame:
        return self.evidence.target_table()

    @cached_property
    def swept(self) -> list[str]:
        return swept_columns(self.runs)

    @cached_property
    def settings(self) -> list[tuple[Any, ...]]:
        """The values of the swept columns at each point, in the study's order; one empty tuple without a sweep."""
        columns = [self.runs[name].tolist() for name in self.swept]
        return list(dict.fromkeys(zip(*columns, strict=True))) if columns else [()]

    @cached_property
    def labels(self) -> dict[str, str]:
        """The names of axes in the manifest of the folder, by key."""
        return read_labels(self.results.folder / "manifest.toml")

    def label(self, key: str, default: str) -> str:
        """The manifest's name of an axis that every study has: "rmse", "median" or "runtime"."""
        return printable(self.labels.get(key, default))

    def setting(self, column: str, value: Any) -> str:
        """A value of a swept column in words."""
        return words(setting(column.removeprefix("scenario."), value, self.labels))

    @cached_property
    def points(self) -> list[str]:
        """The label of each point."""
        return [", ".join(map(self.setting, self.swept, point)) or "the only point" for point in self.settings]

    @cached_property
    def axes(self) -> list[dict[str, Any]]:
        """The swept keys: name, texts of the values of the points, numbers where all of them are, and their scale."""
        found = []
        for i, name in enumerate(self.swept):
            values = [point[i] for point in self.settings]
            key = name.removeprefix("scenario.")
            scale = places(key, values)
            finite = scale is not None and scale.beyond is None
            found.append(
                {
                    "name": words(name_of(key, self.labels)),
                    "texts": [words(text_of(value)) for value in values],
                    "values": numbers(values, 12) if finite else None,
                    "log": scale is not None and scale.log,
                }
            )
        return found

    @cached_property
    def block(self) -> Block | None:
        """The ranking over all points, or at the only one; None if methods are not ranked."""
        blocks = self.evidence.ranking.blocks
        overall = [block for block in blocks if ALL in map(str, block.swept.values())]
        return (overall or list(blocks) or [None])[0]  # type: ignore[list-item]

    @cached_property
    def methods(self) -> list[str]:
        """The labels of the methods, the best first: the best set, then the others by their mean rank."""
        labels = list(dict.fromkeys(self.runs["method"]))
        if self.block is None:
            column = self.error if self.error in self.summary else "failed"
            means = self.summary.groupby("method")[column].mean()
            return sorted(labels, key=lambda name: _last(means.get(name, math.nan)))
        first = [self.block.methods[i] for i in self.block.order]
        ranks = self.evidence.ranking.frame.groupby("method", sort=False)["mean_rank"].last()
        place = {name: i for i, name in enumerate(first)}
        return sorted(labels, key=lambda name: (place.get(name, len(first)), _last(ranks.get(name, math.nan))))

    @cached_property
    def index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.methods)}

    @cached_property
    def shown(self) -> list[int]:
        """The methods that the figures show at first: the best ones, and the best of other formulations."""
        by = self.runs.drop_duplicates("method").set_index("method")["formulation"].to_dict()
        firsts: dict[str, str] = {}
        for name in self.methods:
            firsts.setdefault(by[name], name)
        chosen = list(dict.fromkeys([*self.methods[:BEST], *firsts.values(), *self.methods]))[:SHOWN]
        return sorted(self.index[name] for name in chosen)

    @cached_property
    def targets(self) -> list[str]:
        """The labels of the targets that apply."""
        return list(dict.fromkeys(self.evidence.hits.frame["target"]))

    @property
    def gaps_compare(self) -> bool:
        """Whether all methods have the same formulation: a gap is that of the first problem of a formulation."""
        return self.runs["formulation"].nunique() == 1

    @cached_property
    def outcomes(self) -> list[Outcomes | None]:
        """The outcomes at each point; None where there are none."""
        found = {tuple(swept.values()): each for swept, each in self.evidence.points}
        if not found and self.error in self.runs.columns:  # errors below 0 are not ranked
            runs = self.runs.assign(**{self.error: self.runs[self.error] - min(self.runs[self.error].min(), 0.0)})
            pairs = outcomes(runs, self.evidence.hits.frame, self.error, self.swept)
            found = {tuple(swept.values()): each for swept, each in pairs}
        return [found.get(point) for point in self.settings]

    def goal(self, target: str) -> str:
        """The label of a target with the unit of an error in metres."""
        plain = target.startswith("error") and "bound" not in target and self.error.endswith("_m")
        return f"{target} m" if plain else target

    def with_units(self, block: Block) -> Block:
        """The block with the label of its target as ``goal`` has it."""
        return replace(block, points=tuple(replace(each, target=self.goal(each.target)) for each in block.points))

    def place(self, row: dict[Any, Any]) -> int:
        """The point of a row of a table with the swept columns; -1 if it is of none."""
        return self._places.get(tuple(row[name] for name in self.swept), -1)

    def places(self, table: pd.DataFrame) -> list[int]:
        """``place`` of each row of a table."""
        if not self.swept:
            return [0] * len(table)
        columns = (table[name].tolist() for name in self.swept)
        return [self._places.get(values, -1) for values in zip(*columns, strict=True)]

    @cached_property
    def _places(self) -> dict[tuple[Any, ...], int]:
        return {point: i for i, point in enumerate(self.settings)}

    @property
    def error_name(self) -> str:
        """The error measure with its unit."""
        name = words(name_of(self.error))
        return "error [m]" if self.error == "rmse_m" else name[:1].lower() + name[1:]


def _last(value: float) -> float:
    return math.inf if math.isnan(value) else float(value)


def words(text: str) -> str:
    """A label of a figure as plain text, without the escapes of matplotlib."""
    return printable(text.replace(r"\$", "$").lstrip("\N{THIN SPACE}"))


def numbers(values: Iterable[Any], digits: int = DIGITS) -> list[float | int | str | None]:
    """Numbers in a form that JSON can hold, with few digits: null for NaN, and "inf" for infinity."""
    return [number(value, digits) for value in values]


def number(value: Any, digits: int = DIGITS) -> float | int | str | None:
    """One number of ``numbers``."""
    value = float(value)
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    short = float(f"{value:.{digits}g}")
    return int(short) if short.is_integer() and abs(short) < 1e15 else short
