"""The data of figures: the study's summary, with the intervals of all values that have one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, final

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from nfbench.analysis import default_groups, parameters, quantile_interval, summarize, swept_columns
from nfbench.core import NfbenchError, Status
from nfbench.results import Evidence, Results

from .drawing import Wanted
from .highlights import highlighted
from .labels import Places, name_of, places, plain, setting
from .style import Style, styles

__all__ = ["Drawn", "Metric", "chosen", "drawn", "key_of", "median_over_scenes"]

PANELS = 4


@final
@dataclass(frozen=True)
class Metric:
    """One column of the summary, as shown on an axis.

    column: name of the column; its interval is in ``<column>_low`` and ``<column>_high``.
    label: label of the axis.
    bounds: columns of the bounds and floors that apply to it; they are root mean squares.
    share: whether it is a share of sources, shown in percent.
    """

    column: str
    label: str
    bounds: tuple[str, ...] = ()
    share: bool = False


@final
@dataclass(frozen=True)
class Drawn:
    """The data of a study, or of a part of it, that figures show.

    runs: all finished runs.
    table: the summary, with the median run time ``runtime_median_s`` of the runs that are ok, and its interval.
    error: name of the error measure.
    outlier_m: error beyond which a source counts as an outlier [m].
    title: title of the study; empty to show none.
    styles: style of each method.
    evidence: hits and ranking of the study.
    where: the swept columns that are fixed in this part, as (column, value) pairs.
    names: labels of axes that the manifest gives, by key.
    """

    runs: pd.DataFrame
    table: pd.DataFrame
    error: str
    outlier_m: float
    title: str
    styles: dict[str, Style]
    evidence: Evidence
    where: tuple[tuple[str, Any], ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def swept(self) -> list[str]:
        """The swept columns that are not fixed."""
        fixed = [column for column, _ in self.where]
        return [column for column in swept_columns(self.runs) if column not in fixed]

    @property
    def methods(self) -> list[str]:
        return list(self.styles)

    @property
    def coloured(self) -> list[str]:
        """The methods in colour."""
        return [name for name, style in self.styles.items() if not style.pale]

    @property
    def others(self) -> list[str]:
        """The methods in grey."""
        return [name for name, style in self.styles.items() if style.pale]

    def at(self, frame: pd.DataFrame) -> pd.DataFrame:
        """The rows of another table of the study that belong to this part."""
        for column, value in self.where:
            frame = frame[frame[column] == value]
        return frame

    @cached_property
    def along(self) -> tuple[str, Places | None] | None:
        """The swept column for the x axis and its places: that with the most numbers. None without a sweep."""
        found = [(column, places(key_of(column), self.table[column].tolist())) for column in self.swept]
        return max(found, key=lambda pair: len(pair[1].of) if pair[1] else 0, default=None)

    def name(self, column: str) -> str:
        """The label of the axis of a swept column."""
        return name_of(key_of(column), self.names)

    @property
    def settings(self) -> list[str]:
        """The fixed values of this part, e.g. ``SNR = 20 dB``."""
        return [setting(key_of(column), value, self.names) for column, value in self.where]

    def by(self, columns: Sequence[str]) -> list[Drawn]:
        """The parts in which these columns are constant, in the study's order; ``[self]`` without columns."""
        if not columns:
            return [self]
        settings = dict.fromkeys(zip(*(self.table[column].tolist() for column in columns), strict=True))
        return [self._at(tuple(zip(columns, setting, strict=True))) for setting in settings]

    def _at(self, where: tuple[tuple[str, Any], ...]) -> Drawn:
        part = replace(self, where=where)
        return replace(self, runs=part.at(self.runs), table=part.at(self.table), where=self.where + where)

    def metrics(self, wanted: Wanted | None) -> list[Metric]:
        """RMSE, median, and the outlier rate if there are outliers; or only the wanted measure.

        Raises NfbenchError if the runs have no errors of a wanted parameter.
        """
        if wanted not in (None, "rmse", "median"):
            return self._of_parameter(wanted)
        metres = self.error == "rmse_m"
        label = self._given("rmse", "RMSE [m]" if metres else f"RMS {self.error}")
        rmse = Metric(self.error, label, bounds=("crb_m", "floor_m") if metres else ())
        median = Metric("median_m" if metres else f"{self.error}_median", self.median_label)
        if wanted:
            return [rmse if wanted == "rmse" else median]
        far = Metric("outlier_rate", f"Off by\n> {self.outlier_m:g} m [%]", share=True)
        return [rmse, median, *([far] if (self.table["outlier_rate"] > 0).any() else [])]

    def _of_parameter(self, wanted: Wanted) -> list[Metric]:
        """RMSE and median of a parameter such as the azimuth."""
        known = {parameter.name: parameter for parameter in parameters(self.table.columns)}
        if wanted not in known:
            raise NfbenchError(f"metric: expected {', '.join(['rmse', 'median', *known])}, got {wanted!r}")
        found = known[wanted]
        rmse = Metric(found.error, f"{wanted.capitalize()} RMSE [{found.symbol}]", bounds=(found.bound,))
        return [rmse, Metric(f"{found.error}_median", f"Median {wanted} error [{found.symbol}]")]

    @property
    def median_label(self) -> str:
        """The axis label of the median error."""
        return self._given("median", "Median [m]" if self.error == "rmse_m" else f"Median {self.error}")

    @property
    def time_label(self) -> str:
        """The axis label of run times."""
        return self._given("runtime", "Run time [s]")

    def _given(self, key: str, label: str) -> str:
        return plain(self.names[key]) if key in self.names else label

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


def drawn(
    results: Results, title: bool = True, methods: Sequence[str] = (), names: Mapping[str, str] | None = None
) -> Drawn:
    """The data to draw, with these methods in colour in addition to the best ones, and these labels of axes.

    Raises StoreError if there is no study, NfbenchError if no run has an estimate yet or a method is unknown.
    """
    runs, meta = results.runs, results.meta
    ok = runs[runs["status"] == Status.OK]
    if ok.empty:
        reason = "no run has finished yet" if runs.empty else "no run ended with an estimate"
        raise NfbenchError(f"{results.folder}: nothing to draw: {reason}")
    error, outlier_m, by = meta["error"], float(meta["outlier_m"]), default_groups(runs)
    if error not in ok.columns:
        raise NfbenchError(f"{results.folder}: nothing to draw: no run has the study's error measure {error!r:.80}")
    with np.errstate(all="ignore"):  # scores may be infinite
        table = summarize(runs, error=error, outlier_m=outlier_m)
    groups: dict[Any, pd.DataFrame] = dict(list(ok.groupby(by, sort=False)))
    keys = [tuple(row) for row in table[by].itertuples(index=False)]
    times = [median_over_scenes(groups[key], "runtime_s") if key in groups else (math.nan,) * 3 for key in keys]
    ends = [f"runtime_median_s{end}" for end in ("", "_low", "_high")]
    table[ends] = np.array(times).reshape(-1, 3)
    evidence, labels = results.evidence(runs), list(dict.fromkeys(runs["method"]))
    families = dict(zip(runs["method"], zip(runs["formulation"], runs["solver"], strict=True), strict=True))
    shown = styles(labels, highlighted(labels, methods, evidence, families))
    heading = meta["title"] if title else ""
    return Drawn(runs, table, error, outlier_m, heading, shown, evidence, names=names or {})


def median_over_scenes(runs: pd.DataFrame, column: str) -> tuple[float, float, float]:
    """The median over scenes of the median over the runs of a scene, and the ends of its 95 % interval.

    Runs without a value count as infinite. An end is NaN if there are too few scenes to bound it.
    """
    values = runs[column].astype(float).fillna(math.inf)
    each: Float[ndarray, " n"] = values.groupby(runs["scene"]).median().to_numpy(dtype=np.float64)
    return (float(np.median(each)), *quantile_interval(each))


def chosen(parts: Sequence[Drawn]) -> list[Drawn]:
    """All parts, or four of them: the first, the last and two evenly spaced between.

    If they differ in two columns, these are the first and the last value of one with those of the other.
    """
    if len(parts) <= PANELS:
        return list(parts)
    values = [list(dict.fromkeys(part.where[i][1] for part in parts)) for i in range(len(parts[0].where))]
    differing = [i for i, column in enumerate(values) if len(column) > 1]
    if len(differing) == 2:
        ends = [(values[i][0], values[i][-1]) for i in differing]
        corners = [p for p in parts if all(p.where[i][1] in pair for i, pair in zip(differing, ends, strict=True))]
        if len(corners) == PANELS:
            return corners
    picks = np.unique(np.linspace(0, len(parts) - 1, PANELS).round().astype(int))
    return [parts[i] for i in picks]
