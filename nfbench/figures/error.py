"""Error against the swept values: lines for numbers, dots for categories and for studies without a sweep."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Any, Literal, cast

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

from .axes import error_axis, legend_below, name_x, name_y, new_figure, swept_axis
from .data import Drawn, Metric, key_of
from .direct import direct, name_ends
from .drawing import Wanted
from .highlights import listed
from .labels import Places, plain, text_of
from .style import WIDTHS
from .text import fitted, text_width, wrapped

__all__ = [
    "BESIDE",
    "below_bound",
    "bound_handles",
    "bound_look",
    "error_figures",
    "headed",
    "heading",
    "method_handles",
    "named",
    "slug",
]

PANELS = {"single": 3, "double": 4}  # values of a second key in one figure; if there are more, each has its own figure
NAME = {"single": 1.5, "double": 2.9}  # width of a method's name [in]
SIZE, ROW_SIZE = 7.5, 7.0  # of headings, and of the names of rows [pt]
BESIDE, LINE = 0.6, 0.125  # room for a y axis and its labels, and height of a line of a heading [in]
LONG = 15  # rows; with more, names are cut to one line
STEM = 120  # characters of a file name
BEYOND = 1e6  # times the lower end: where an interval ends that reaches infinity
BANDS = 5  # with more methods, intervals are bars, because bands would hide each other
BELOW = 0.97  # times the bound: an error that is visibly below it
BIAS = (
    "An RMSE below the bound: the bound holds for unbiased estimates; a search box limits errors, and the RMSE of "
    "few scenes varies"
)
BOUNDS: dict[str, tuple[str, dict[str, Any]]] = {  # columns of the summary that are drawn in addition to the methods
    "crb": ("Cramér–Rao bound", {"color": "black", "linestyle": "--", "linewidth": 1.0}),
    "floor": ("Error floor", {"color": "black", "linestyle": ":", "linewidth": 1.2}),
}  # by the first word of their names


def error_figures(study: Drawn, width: str, wanted: Wanted | None) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) of a study's errors: one figure, or one for each setting of the further keys."""
    metrics = study.metrics(wanted)
    if study.along is None:
        yield "error", _dots([study], metrics, width)
        return
    column, at = study.along
    parts = study.by([other for other in study.swept if other != column])
    together = [parts] if len(parts) <= PANELS[width] else [[part] for part in parts]
    for panels in together:
        stem = "error" if len(together) == 1 else f"error-{slug(panels[0])}"
        yield stem, _lines(panels, metrics, width, column, at) if at else _dots(panels, metrics, width, column)


def bound_look(column: str) -> tuple[str, dict[str, Any]]:
    """The name of a bound in a legend, and how its line is drawn."""
    return BOUNDS[column.partition("_")[0]]


def headed(ax: Axes, part: Drawn) -> None:
    """Write above a panel which values are fixed in it, in as many lines as needed; the figure grows by their height.

    Call it while the panels have the size that they will have.
    """
    if not part.where:
        return
    figure, place = cast(Figure, ax.get_figure()), ax.get_subplotspec()
    columns = place.get_gridspec().ncols if place else 1
    lines = heading(part, (figure.get_figwidth() - BESIDE) / columns)
    ax.set_title("\n".join(lines), loc="left")
    if place and place.colspan.start == 0:
        figure.set_figheight(figure.get_figheight() + LINE * (len(lines) - 1))


def heading(part: Drawn, inches: float) -> list[str]:
    """The fixed values of a part, in lines no wider than this that break between values where possible."""
    kept = [text.replace(" ", "\N{NO-BREAK SPACE}") for text in part.settings]
    lines = wrapped(", ".join(kept), inches, SIZE)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def named(part: Drawn) -> str:
    """The fixed values of a part, e.g. ``SNR = 20 dB``."""
    return ", ".join(part.settings)


def slug(part: Drawn) -> str:
    """The fixed values of a part, as part of a file name; different values may give the same."""
    texts = [f"{key_of(column)}-{text_of(value)}".replace("∞", "inf").replace("−", "-") for column, value in part.where]
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", "-".join(texts)).strip("-.")[:STEM]


def method_handles(study: Drawn, joined: bool, names: Collection[str] | None = None) -> dict[str, Artist]:
    """The legend entries: one for each method in colour, and one for all others. names: methods drawn; None for all."""
    done = set(study.table.loc[study.table[study.error].notna(), "method"])
    shown = [name for name in study.methods if names is None or name in names]
    found: dict[str, Artist] = {}
    for name in [*(n for n in shown if n in study.coloured), *[n for n in shown if n in study.others][:1]]:
        style = study.styles[name]
        others = sum(other in study.others for other in shown)
        text = f"{others} other method{'s' * (others > 1)}" if style.pale else name
        text += "" if style.pale or name in done else " (no successful run)"
        found[text] = Line2D([], [], **(style.joined if joined else style.points))
    return found


# --- a numeric key: lines ------------------------------------------------------------------------------------------


def _lines(parts: list[Drawn], metrics: list[Metric], width: str, column: str, at: Places) -> Figure:
    """One column of panels per part, one row per metric. A single part in a wide figure has one row instead."""
    one_row = len(parts) == 1 and width == "double"
    heights = [1.7] if one_row else [0.8 if metric.share else 1.5 for metric in metrics]
    figure = new_figure(WIDTHS[width], sum(heights) + 0.35, parts[0].title)
    shape = (1, len(metrics)) if one_row else (len(metrics), len(parts))
    grid = figure.subplots(
        *shape, squeeze=False, sharex=True, sharey=False if one_row else "row", height_ratios=heights
    )
    panels = grid if one_row else grid.T  # (part, metric)
    for part, column_of_panels in zip(parts, panels, strict=True):
        headed(column_of_panels[0], part)
        for metric, ax in zip(metrics, column_of_panels, strict=True):
            _draw_lines(ax, part, metric, column, at)
    for metric, ax, height in zip(metrics, panels[0], heights * len(metrics), strict=False):
        name_y(ax, metric.label, height)
    for metric, axes in zip(metrics, panels.T, strict=True):
        _scale(axes, "y", metric, parts)
    for ax in grid.flat:
        swept_axis(ax, at)
    name_x(grid[-1], parts[0].name(column))
    figure.align_ylabels()
    names = parts[-1].coloured
    named_at_ends = not one_row and direct(names, WIDTHS[width], heights[0])
    for metric, ax in zip(metrics, panels[-1], strict=True) if named_at_ends else ():
        if not metric.share:
            ends = {name: _end(parts[-1].of(name).sort_values(column), metric, column, at) for name in names}
            name_ends(ax, ends, {name: parts[-1].styles[name].colour for name in names}, heights[0])
    _legend(figure, parts, metrics, joined=True, but=names if named_at_ends else ())
    return figure


def _end(rows: pd.DataFrame, metric: Metric, column: str, at: Places) -> tuple[float, float]:
    """The last point of a method's line; NaN if it has none."""
    y = _numbers(rows, metric, metric.column)
    known = np.flatnonzero(np.isfinite(y))
    return (float(rows[column].map(at.of).iloc[known[-1]]), float(y[known[-1]])) if len(known) else (math.nan,) * 2


def _draw_lines(ax: Axes, part: Drawn, metric: Metric, column: str, at: Places) -> None:
    for name, style in part.styles.items():
        rows = part.of(name).sort_values(column)
        x = rows[column].map(at.of).to_numpy(dtype=np.float64)
        ax.plot(*_apart(x, _numbers(rows, metric, metric.column), at), **style.joined, label=plain(name))
        low, high = _ends(rows, metric)
        if metric.share or style.pale or np.isnan(low).all():
            continue
        bars = np.full(len(x), len(part.coloured) > BANDS) | (x == at.beyond)
        if not bars.all():
            ax.fill_between(x[~bars], low[~bars], high[~bars], color=style.colour, alpha=0.16, linewidth=0, zorder=1)
        ax.vlines(x[bars], low[bars], high[bars], color=style.colour, linewidth=0.7, alpha=0.6, zorder=2)
    for name in metric.bounds:
        rows, (_, look) = part.bound(name), bound_look(name)
        if len(rows):
            rows = rows.sort_values(column)
            x = rows[column].map(at.of).to_numpy(dtype=np.float64)
            ax.plot(*_apart(x, rows[name].to_numpy(), at), **look, label=name, zorder=2.5)
            ax.plot(x[x == at.beyond], rows[name].to_numpy()[x == at.beyond], color="black", marker="_")


def _apart(x: ndarray, y: ndarray, at: Places) -> tuple[ndarray, ndarray]:
    """The points with a gap before ∞, so that no line joins it to the numbers."""
    beyond = np.flatnonzero(x == at.beyond)
    return np.insert(x, beyond, math.nan), np.insert(y, beyond, math.nan)


# --- categories, and no sweep: dots ----------------------------------------------------------------------------------


def _dots(parts: list[Drawn], metrics: list[Metric], width: str, column: str | None = None) -> Figure:
    """One row of panels per part, one column per metric, and in each category the methods below each other."""
    groups = [part.by([column] if column else []) for part in parts]
    rows = [] if column else _names(parts[0], width)
    step = 0.11 if column else 0.15 if len(rows) > LONG else 0.17 if not any("\n" in row for row in rows) else 0.24
    heights = [sum(step * _rows_of(group, column) + (0.12 if column else 0.0) for group in row) + 0.2 for row in groups]
    figure = new_figure(WIDTHS[width], sum(heights) + 0.45, parts[0].title)
    ratios = [0.55 if metric.share else 1.0 for metric in metrics]
    grid = figure.subplots(
        len(parts), len(metrics), squeeze=False, sharey="row", sharex="col", height_ratios=heights, width_ratios=ratios
    )
    for part, row, axes in zip(parts, groups, grid, strict=True):
        headed(axes[0], part)
        _draw_rows(axes, row, metrics, column, width)
    for metric, axes in zip(metrics, grid.T, strict=True):
        _scale(axes, "x", metric, parts)
        name_x(axes[-1:], metric.label.replace(" [%]", "\n[%]"))
    for ax, height in zip(grid[:, 0] if column else (), heights, strict=False):
        name_y(ax, parts[0].name(column or ""), height)
    if column or any(len(parts[0].bound(name)) for metric in metrics for name in metric.bounds):
        _legend(figure, parts, metrics, joined=False, methods=column is not None)
    return figure


def _draw_rows(
    axes: Sequence[Axes], groups: list[Drawn], metrics: list[Metric], column: str | None, width: str
) -> None:
    """Draw the rows of a part from the top. A group is a category; without categories the best method comes first."""
    top, ticks, names = 0.0, [], []
    for number, group in enumerate(groups):
        count = _rows_of(group, column)
        alone, together = _split(group, column)
        places = dict(zip(alone, -top - np.arange(count), strict=False)) | dict.fromkeys(together, -top - count + 1)
        span = (-top - count + 0.3, -top + 0.7) if column is None else (-top - count + 0.1, -top + 0.9)
        for metric, ax in zip(metrics, axes, strict=True):
            if number % 2:
                ax.axhspan(*span, color="0.95", linewidth=0, zorder=0)
            _draw_dots(ax, group, metric, places, span)
        ticks += [-top - (count - 1) / 2] if column else list(dict.fromkeys(places.values()))
        names += [text_of(group.where[-1][1])] if column else _names(group, width)
        top += count + 0.8
    for ax in axes:
        ax.set_ylim(span[0], 0.9 if column else 0.7)
        ax.grid(visible=column is None, axis="y")
    axes[0].set_yticks(ticks, names)
    for ax in axes:
        ax.tick_params(axis="y", length=0)


def _rows_of(group: Drawn, column: str | None) -> int:
    """Number of rows of a group."""
    alone, together = _split(group, column)
    return len(alone) + bool(together)


def _split(group: Drawn, column: str | None) -> tuple[list[str], list[str]]:
    """The methods with a row of their own and those that share one: the grey ones of a category, else all but the best.

    Without a category, the best method comes first.
    """
    if column is None:
        return listed(group.table.sort_values(group.error, na_position="last")["method"].tolist(), group.coloured)
    shown = group.table["method"].tolist()
    return [n for n in shown if not group.styles[n].pale], [n for n in shown if group.styles[n].pale]


def _draw_dots(ax: Axes, group: Drawn, metric: Metric, places: dict[str, float], span: tuple[float, float]) -> None:
    lone = Counter(places.values())
    for name, y in places.items():
        style, rows = group.styles[name], group.of(name)
        ax.plot(_numbers(rows, metric, metric.column), [y], **style.points, label=plain(name))
        low, high = _ends(rows, metric)
        if not metric.share and not np.isnan(low).all() and (lone[y] == 1 or not style.pale):
            ax.hlines([y], low, high, color=style.colour, linewidth=1.0, zorder=2)
    for name in metric.bounds:
        for value in group.bound(name)[name] if name in group.table else ():
            ax.plot([value, value], span, **bound_look(name)[1], label=name, zorder=1)


def _names(group: Drawn, width: str) -> list[str]:
    """The names of the rows with the numbers of failed runs: wrapped, or cut if there are many."""
    names: list[str] = []
    alone, together = _split(group, None)
    table = group.table.set_index("method", drop=False).loc[alone]
    for row in table.to_dict("records"):
        failed = f" ({row['failed']} of {row['runs']} failed)" if row["failed"] else ""
        if len(table) > LONG:
            names.append(fitted(row["method"], NAME[width] - text_width(failed, ROW_SIZE), ROW_SIZE) + failed)
        else:
            names.append(plain("\n".join(wrapped(f"{row['method']}{failed}", NAME[width], ROW_SIZE))))
    return [*names, f"{len(together)} other methods"] if together else names


# --- both ----------------------------------------------------------------------------------------------------------


def _numbers(rows: pd.DataFrame, metric: Metric, column: str) -> ndarray:
    return (100.0 if metric.share else 1.0) * rows[column].to_numpy(dtype=np.float64)


def _ends(rows: pd.DataFrame, metric: Metric) -> tuple[ndarray, ndarray]:
    """The ends of the intervals; an infinite end is placed beyond the axis."""
    if f"{metric.column}_low" not in rows:
        return np.full(len(rows), math.nan), np.full(len(rows), math.nan)
    low, high = (_numbers(rows, metric, f"{metric.column}_{end}") for end in ("low", "high"))
    return low, np.where(np.isposinf(high), BEYOND * np.where(low > 0, low, 1.0), high)


def _scale(axes: Sequence[Axes], which: Literal["x", "y"], metric: Metric, parts: list[Drawn]) -> None:
    """Set one scale for all panels of a metric, wide enough for everything that is drawn in them."""
    if metric.share:
        worst = 100 * max(part.table[metric.column].max() for part in parts)
        top = next((top for top in (4, 10, 20, 50) if top >= worst), 100)
        for ax in axes:
            getattr(ax, f"set_{which}lim")(-0.06 * top, 1.06 * top)
            getattr(ax, f"set_{which}ticks")([0, top // 2, top] if which == "y" else [0, top])
        return
    columns = [metric.column, f"{metric.column}_low", f"{metric.column}_high", *metric.bounds]
    error_axis(axes, which, [v for part in parts for name in columns if name in part.table for v in part.table[name]])


def _legend(
    figure: Figure,
    parts: list[Drawn],
    metrics: list[Metric],
    *,
    joined: bool,
    methods: bool = True,
    but: Collection[str] = (),
) -> None:
    """Add the legend. but: methods that are named in the panels."""
    shown = set(parts[0].methods) - set(but)
    handles = method_handles(parts[0], joined, shown) if methods and shown else {}
    handles |= bound_handles(parts, metrics)
    if handles:
        legend_below(figure, handles, below_bound(parts, metrics))


def bound_handles(parts: list[Drawn], metrics: Sequence[Metric]) -> dict[str, Artist]:
    """The legend entries of the bounds that are drawn."""
    names = dict.fromkeys(name for metric in metrics for name in metric.bounds)
    found = [bound_look(name) for name in names if any(len(part.bound(name)) for part in parts)]
    return {text: Line2D([], [], **look) for text, look in found}


def below_bound(parts: list[Drawn], metrics: Sequence[Metric]) -> str:
    """Why an error can be below the Cramér–Rao bound, if one of those that are drawn is."""
    shown = [(part.table, metric.column, bound) for part in parts for metric in metrics for bound in metric.bounds]
    for table, column, bound in shown:
        if bound.startswith("crb") and bound in table and (table[column] < BELOW * table[bound]).any():
            return BIAS
    return ""
