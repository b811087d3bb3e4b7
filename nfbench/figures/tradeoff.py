"""Error against cost, with the efficient methods: those that no other method beats in both."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, cast

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Affine2D, Bbox
from numpy import ndarray

from nfbench.core import Status

from .axes import error_axis, legend_below, name_x, name_y, new_figure, panel_rows, panels
from .data import Drawn, chosen, median_over_scenes
from .drawing import Drawing, NotDrawnError
from .error import headed, method_handles
from .labels import plain
from .style import GREY, WIDTHS
from .target_axes import AXIS_LABELS, axis_of

__all__ = ["efficient", "spread_of_costs", "tradeoff_figure"]

RING: dict[str, Any] = {
    "color": "black",
    "linewidth": 0.7,
    "marker": "o",
    "markersize": 7.5,
    "markerfacecolor": "none",
    "markeredgewidth": 0.7,
}
ENDS = ("", "_low", "_high")
NUMBER = 6  # size of the numbers of grey methods [pt]
# where a number may stand: displacements from its point [pt], and which part of the number is there
PLACES: tuple[tuple[float, float, Literal["left", "center", "right"]], ...] = (
    (0, 4.5, "center"),
    (4.5, -2, "left"),
    (-4.5, -2, "right"),
    (0, -9, "center"),
    (3.5, 3, "left"),
    (-3.5, 3, "right"),
    (3.5, -7, "left"),
    (-3.5, -7, "right"),
)


def efficient(costs: Float[ndarray, " n"], errors: Float[ndarray, " n"]) -> Bool[ndarray, " n"]:
    """Whether no other point has at most the cost and at most the error of a point, and less of one of the two."""
    no_more = (costs[None] <= costs[:, None]) & (errors[None] <= errors[:, None])
    less = (costs[None] < costs[:, None]) | (errors[None] < errors[:, None])
    return np.asarray(np.isfinite(errors) & ~(no_more & less).any(axis=1))


def tradeoff_figure(study: Drawn, how: Drawing) -> Figure:
    """Median error against median cost, one point per method, and per budget if budgets are swept.

    Without a choice, the cost is in evaluations if all methods make evaluations, else in seconds. Runs that are not ok
    count as infinite errors. The panels are up to four points of the other swept keys. Raises
    NotDrawnError if no method makes evaluations, or fewer than two points have a finite median.
    """
    every = bool((study.table.groupby("method")["evaluations"].max() > 0).all())
    axis = axis_of(study, how) if how.axis or every else "seconds"
    if axis == "evaluation_equivalents":
        raise NotDrawnError("the cost is known in evaluations and in seconds only")
    parts = chosen(study.by([column for column in study.swept if not column.startswith("budget.")]))
    tables = [_points(part, "runtime_s" if axis == "seconds" else "evaluations") for part in parts]
    everything = pd.concat(tables)
    if len(everything) < 2:
        raise NotDrawnError("fewer than two methods have a cost and a finite median error")
    rows = panel_rows(len(parts), how.width)
    figure = new_figure(WIDTHS[how.width], (1.9 if len(parts) == 1 else 1.5) * rows + 0.35, study.title)
    axes, left, lowest = panels(figure, len(parts), how.width, sharex=True, sharey=True)
    for ax, part, table in zip(axes, parts, tables, strict=True):
        headed(ax, part)
        _draw(ax, part, table)
    sides: tuple[tuple[Literal["x", "y"], str], ...] = (("x", "cost"), ("y", "error"))
    for which, name in sides:
        shown = everything.loc[~everything["pale"], [f"{name}{end}" for end in ENDS]].to_numpy().ravel()
        error_axis(axes, which, [*everything[name], *shown])
    for ax in left:
        name_y(ax, study.median_label, 1.5)
    name_x(lowest, "Median run time [s]" if axis == "seconds" else f"Median {AXIS_LABELS[axis].lower()}")
    numbers = _numbered(study, tables)
    if numbers:
        figure.draw_without_rendering()  # to know where the points are
    written = [_write_numbers(ax, table, numbers) for ax, table in zip(axes, tables, strict=True)]
    handles = method_handles(study, joined=_swept(study), names=set(everything["method"]))
    for name, number in numbers.items():
        if not any(name in done for done in written):
            continue
        handles[name] = Line2D([], [], color=GREY, marker=f"${number}$", markersize=4.5, linestyle="")
    handles["Efficient"] = Line2D([], [], **RING)
    legend_below(figure, handles)
    return figure


def spread_of_costs(study: Drawn) -> bool:
    """Whether costs differ by design: budgets are swept, evaluations differ by a tenth, or some methods make none."""
    most = study.table.groupby("method")["evaluations"].max()
    making = study.table.loc[study.table["evaluations"] > 0, "evaluations"]
    mixed = bool((most > 0).any() and not (most > 0).all())
    return mixed or _swept(study) or bool(len(making) > 1 and making.max() > 1.1 * making.min())


def _swept(study: Drawn) -> bool:
    return any(column.startswith("budget.") for column in study.swept)


def _points(part: Drawn, column: str) -> pd.DataFrame:
    """One row per method and budget that has a cost and a finite median error."""
    rows = []
    budgets = [name for name in part.swept if name.startswith("budget.")]
    for setting in part.by(budgets):
        for name, runs in setting.runs.groupby("method", sort=False):
            errors = runs.assign(error=runs[part.error].where(runs["status"] == Status.OK))
            row: dict[str, Any] = {"method": name, "pale": part.styles[str(name)].pale}
            spreads = {"cost": median_over_scenes(runs, column), "error": median_over_scenes(errors, "error")}
            for what, values in spreads.items():
                row |= {f"{what}{end}": value for end, value in zip(ENDS, values, strict=True)}
            rows.append(row)
    columns = ["method", "pale", *(f"{what}{end}" for what in ("cost", "error") for end in ENDS)]
    table = pd.DataFrame(rows, columns=columns)
    return table[np.isfinite(table["error"]) & np.isfinite(table["cost"]) & (table["cost"] > 0)]


def _draw(ax: Axes, part: Drawn, table: pd.DataFrame) -> None:
    joined = _swept(part)
    for name, style in part.styles.items():
        own = table[table["method"] == name]
        ax.plot(own["cost"], own["error"], **(style.joined if joined else style.points), label=plain(name))
        if style.pale:
            continue
        highs = {what: own[f"{what}_high"].clip(upper=1e6 * own[what].clip(lower=1e-12)) for what in ("cost", "error")}
        ax.hlines(own["error"], own["cost_low"], highs["cost"], color=style.colour, linewidth=0.7, zorder=2)
        ax.vlines(own["cost"], own["error_low"], highs["error"], color=style.colour, linewidth=0.7, zorder=2)
    best = _efficient_of(table)
    ax.plot(best["cost"], best["error"], **RING, zorder=3.5, label="efficient")


def _efficient_of(table: pd.DataFrame) -> pd.DataFrame:
    return table[efficient(table["cost"].to_numpy(), table["error"].to_numpy())].sort_values("cost")


def _numbered(study: Drawn, tables: list[pd.DataFrame]) -> dict[str, int]:
    """Numbers of the efficient methods that are grey, so that the legend can name them."""
    names = [name for table in tables for name in _efficient_of(table)["method"] if study.styles[name].pale]
    return {name: number for number, name in enumerate(dict.fromkeys(names), start=1)}


def _write_numbers(ax: Axes, table: pd.DataFrame, numbers: dict[str, int]) -> set[str]:
    """Write the numbers beside their points where they cover no other number; return the methods that have one."""
    taken: list[Bbox] = []
    done = set()
    best = _efficient_of(table)
    for name, cost, error in zip(best["method"], best["cost"], best["error"], strict=True):
        if name not in numbers:
            continue
        text = str(numbers[name])
        for (dx, dy, side), box in zip(PLACES, _boxes(ax, (cost, error), len(text)), strict=True):
            if box is not None and not any(box.overlaps(other) for other in taken):
                ax.annotate(text, (cost, error), (dx, dy), textcoords="offset points", ha=side, fontsize=NUMBER)
                taken.append(box)
                done.add(name)
                break
    return done


def _boxes(ax: Axes, point: tuple[float, float], digits: int) -> Iterator[Bbox | None]:
    """The box of a number at each place beside a point [pt]; None where it would leave the panel."""
    to_points = 72 / cast(Figure, ax.get_figure()).dpi
    panel = ax.get_window_extent().transformed(Affine2D().scale(to_points))
    width, height = 0.75 * NUMBER * digits, 0.95 * NUMBER
    x, y = ax.transData.transform(point) * to_points
    for dx, dy, side in PLACES:
        shift = {"left": 0.0, "center": width / 2, "right": width}[side]
        box = Bbox.from_bounds(x + dx - shift, y + dy, width, height)
        yield box if panel.y0 <= box.y0 and box.y1 <= panel.y1 else None
