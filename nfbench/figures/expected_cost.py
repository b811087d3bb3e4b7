"""Expected running times: what it costs each method to reach a target, one line per method."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nfbench.analysis import target_table

from .axes import error_axis, new_figure
from .data import Drawn, chosen
from .drawing import Drawing, NotDrawnError
from .error import heading
from .highlights import listed
from .labels import plain
from .style import GREY, PALE, WIDTHS
from .target_axes import axis_of, gap_note, hits_on, reached, target_of
from .text import fitted_apart, text_width, wrapped

__all__ = ["ert_figure"]

ROW = 0.15  # height of a row [in]
LINE = 0.13  # height of a line of text [in]
NAME = {"single": 1.7, "double": 3.0}  # width of a method's name with one panel [in]
SIZE, ROW_SIZE = 7.5, 7.0  # of headings and of the names of rows [pt]
GAP = 0.12  # around panels [in]
TOGETHER = 4  # grey methods that never reach the target and share a row; fewer have rows of their own
FAR = 30.0  # times the largest expected running time: where an interval is cut


def ert_figure(study: Drawn, how: Drawing) -> Figure:
    """The expected running time of each method to one target, with its interval, the cheapest method first.

    With a sweep there are up to two panels, or four in a wide figure, and the order is that over all of them. Raises
    NotDrawnError if no method makes evaluations or none reaches the target.
    """
    axis = axis_of(study, how)
    if axis == "evaluation_equivalents":
        raise NotDrawnError("the expected running time is known in evaluations and in seconds only")
    target = target_of(study, 1 if how.target is None else how.target)
    hits = hits_on(study, axis, target)
    points, unreached = reached(study, hits)
    parts = chosen(points)
    if how.width == "single" and len(parts) > 2:
        parts = [parts[0], parts[-1]]
    hits = pd.concat([part.at(hits) for part in parts])
    column = "ert_s" if axis == "seconds" else "ert"
    overall = target_table(hits, ["method"]).set_index("method")
    order = overall.sort_values([column, "share"], ascending=[True, False], kind="stable").index.tolist()
    order, rest = _shown(order, overall[column], study)
    table = target_table(hits) if study.swept else overall.reset_index()
    width = WIDTHS[how.width]
    longest = NAME[how.width] * (0.75 if how.width == "single" and len(parts) > 1 else 1.0)
    names = fitted_apart(order, longest, ROW_SIZE) + [f"{len(rest)} other methods"] * bool(rest)
    across = (width - max(text_width(name, ROW_SIZE) for name in names) - GAP) / len(parts) - GAP
    headings = [heading(part, across) for part in parts]
    unit = "seconds" if axis == "seconds" else "evaluations"
    remarks = "; ".join(text for text in (gap_note(study, hits), unreached) if text)
    note = f"\n({remarks})" if remarks else ""
    label = wrapped(f"Expected {unit} until {target.label if target else ''}{note}", width - GAP, SIZE)
    above = LINE * (max(map(len, headings)) + len(label) - 1)
    figure = new_figure(width, ROW * (len(order) + bool(rest)) + above + 0.5, study.title)
    axes = figure.subplots(1, len(parts), sharey=True, sharex=True, squeeze=False)[0]
    for ax, part, lines in zip(axes, parts, headings, strict=True):
        own = part.at(table).set_index("method")
        _draw(ax, part, own, order, column)
        if rest:
            _draw_together(ax, own, rest, len(order), column)
        ax.set_title("\n".join(lines), loc="left")
    values = table[[column, f"{column}_low", f"{column}_high"]].to_numpy(dtype=np.float64)
    most = FAR * values[:, 0][np.isfinite(values[:, 0])].max()
    error_axis(axes, "x", values[(values <= most) & (values > 0)])
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.4, -0.6)
    figure.supxlabel(plain("\n".join(label)), fontsize=SIZE)
    return figure


def _shown(order: list[str], costs: pd.Series, study: Drawn) -> tuple[list[str], list[str]]:
    """The methods with a row of their own, and those that share one: also the grey ones that never reach the target."""
    alone, rest = listed(order, study.coloured)
    never = [name for name in alone if name in study.others and not math.isfinite(costs[name])]
    if len(never) < TOGETHER:
        return alone, rest
    return [name for name in alone if name not in never], [*rest, *never]


def _draw(ax: Axes, part: Drawn, table: pd.DataFrame, order: list[str], column: str) -> None:
    """Draw one panel; a method that never reaches the target says so."""
    ax.tick_params(axis="y", length=0)
    for place, name in enumerate(order):
        if name not in table.index:
            continue
        row: dict[Any, Any] = table.loc[name].to_dict()
        if not math.isfinite(row[column]):
            at = ax.get_yaxis_transform()
            ax.text(0.98, place, "never", color=GREY, va="center", ha="right", transform=at)
            continue
        style = part.styles[name]
        colour = GREY if style.pale else style.colour
        high = min(row[f"{column}_high"], 1e6 * row[column])  # beyond the axis if there is no upper end
        ax.hlines([place], row[f"{column}_low"], high, color=colour, linewidth=1.0, zorder=2)
        look = {**style.points, "color": colour, "markersize": 3.0 if style.pale else 4.0}
        ax.plot(row[column], [place], **look, label=plain(name))


def _draw_together(ax: Axes, table: pd.DataFrame, names: list[str], place: int, column: str) -> None:
    """Draw many methods in one row, and say how many of them never reach the target."""
    values = table.loc[[name for name in names if name in table.index], column].to_numpy(dtype=np.float64)
    finite = values[np.isfinite(values)]
    ax.plot(finite, np.full(len(finite), place), "o", color=PALE, markersize=2.5, markeredgewidth=0)
    if len(finite) < len(values):
        text = f"{len(values) - len(finite)} never"
        ax.text(0.98, place, text, color=GREY, va="center", ha="right", transform=ax.get_yaxis_transform())
