"""The data of figures: the study's summary, with intervals for all values that are drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, final

import numpy as np
import pandas as pd

from nfbench.analysis import default_groups, mean_interval, median_interval
from nfbench.core import NfbenchError, Status
from nfbench.results import Results

from .labels import Places, places
from .style import Style, styles

__all__ = ["Drawn", "Metric", "Wanted", "drawn"]

Wanted: TypeAlias = Literal["rmse", "median"]


@final
@dataclass(frozen=True)
class Metric:
    """One column of the summary, as shown on an axis.

    column: name of the column; its interval is in ``<column>_low`` and ``<column>_high``.
    label: label of the axis.
    bounded: whether the bound and the floor apply to it; they are root mean squares.
    share: whether it is a share of sources, shown in percent.
    """

    column: str
    label: str
    bounded: bool = False
    share: bool = False


@final
@dataclass(frozen=True)
class Drawn:
    """The data of a study, or of a part of it, that figures show.

    runs: all finished runs.
    table: the summary, with intervals of the median and of the mean run time.
    error: name of the error measure.
    outlier_m: error beyond which a source counts as an outlier [m].
    title: title of the study; empty to show none.
    styles: style of each method.
    where: the swept columns that are fixed in this part, as (column, value) pairs.
    """

    runs: pd.DataFrame
    table: pd.DataFrame
    error: str
    outlier_m: float
    title: str
    styles: dict[str, Style]
    where: tuple[tuple[str, Any], ...] = ()

    @cached_property
    def swept(self) -> list[str]:
        """The swept columns that are not fixed."""
        fixed = [column for column, _ in self.where]
        return [column for column in default_groups(self.runs)[:-3] if column not in fixed]

    @property
    def methods(self) -> list[str]:
        return list(self.styles)

    @cached_property
    def along(self) -> tuple[str, Places | None] | None:
        """The swept column for the x axis (the first numeric one, if any) and its places; None without a sweep."""
        found = [(column, places(key_of(column), self.table[column].tolist())) for column in self.swept]
        return next((pair for pair in found if pair[1]), found[0] if found else None)

    def by(self, columns: Sequence[str]) -> list[Drawn]:
        """The parts in which these columns are constant, in the study's order; ``[self]`` without columns."""
        if not columns:
            return [self]
        settings = dict.fromkeys(zip(*(self.table[column].tolist() for column in columns), strict=True))
        return [self._at(tuple(zip(columns, setting, strict=True))) for setting in settings]

    def _at(self, where: tuple[tuple[str, Any], ...]) -> Drawn:
        def select(frame: pd.DataFrame) -> pd.DataFrame:
            return frame[np.logical_and.reduce([frame[column] == value for column, value in where])]

        return Drawn(
            select(self.runs),
            select(self.table),
            self.error,
            self.outlier_m,
            self.title,
            self.styles,
            self.where + where,
        )

    def metrics(self, wanted: Wanted | None) -> list[Metric]:
        """RMSE, median, and the outlier rate if there are outliers; or only the wanted measure."""
        metres = self.error == "rmse_m"
        rmse = Metric(self.error, "RMSE [m]" if metres else f"RMS {self.error}", bounded=metres)
        median = Metric(_median(self.error), "Median [m]" if metres else f"Median {self.error}")
        if wanted:
            return [rmse if wanted == "rmse" else median]
        far = Metric("outlier_rate", f"Off by\n> {self.outlier_m:g} m [%]", share=True)
        return [rmse, median, *([far] if (self.table["outlier_rate"] > 0).any() else [])]

    def bound(self, column: str) -> pd.DataFrame:
        """A bound at each scenario point, as the median over methods; points where it is unknown are left out."""
        if column not in self.table:
            return self.table.iloc[:0]
        known = self.table[self.table[column].notna()]
        return known.groupby(self.swept, sort=False)[column].median().reset_index() if self.swept else known.iloc[:1]

    def of(self, method: str) -> pd.DataFrame:
        """The table's rows of one method."""
        return self.table[self.table["method"] == method]


def key_of(column: str) -> str:
    """A swept column's key in the manifest."""
    return column.removeprefix("scenario.")


def drawn(results: Results, title: bool = True) -> Drawn:
    """The data to draw. Raises StoreError if there is no study, NfbenchError if no run has an estimate yet."""
    runs, meta = results.runs, results.meta
    ok = runs[runs["status"] == Status.OK]
    if ok.empty:
        reason = "no run has finished yet" if runs.empty else "no run ended with an estimate"
        raise NfbenchError(f"{results.folder}: nothing to draw: {reason}")
    error, by = meta["error"], default_groups(runs)
    if error not in ok.columns:
        raise NfbenchError(f"{results.folder}: nothing to draw: no run has the study's error measure {error!r:.80}")
    table = results.summary()
    groups: dict[Any, pd.DataFrame] = dict(list(ok.groupby(by, sort=False)))
    keys = [tuple(row) for row in table[by].itertuples(index=False)]
    for values, column, interval in (
        (error, _median(error), median_interval),
        ("runtime_s", "runtime_s", mean_interval),
    ):
        pairs = [interval(groups[key][values].to_numpy()) if key in groups else (math.nan, math.nan) for key in keys]
        table[f"{column}_low"], table[f"{column}_high"] = zip(*pairs, strict=True)
    methods = list(dict.fromkeys(runs["method"]))
    return Drawn(runs, table, error, float(meta["outlier_m"]), meta["title"] if title else "", styles(methods))


def _median(error: str) -> str:
    return "median_m" if error == "rmse_m" else f"{error}_median"
