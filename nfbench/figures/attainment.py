"""Attainment surfaces: the value that a share of the runs has reached by a cost."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy import ndarray

from nfbench.analysis import Axis, attainment
from nfbench.results import find_progress

from .axes import error_axis, legend_below, name_y, new_figure, panel_rows, panels
from .data import Drawn, chosen
from .drawing import Drawing, NotDrawnError
from .error import headed, method_handles
from .highlights import best_first
from .labels import plain
from .style import GREY, WIDTHS
from .target_axes import AXIS_LABELS, axis_of

__all__ = ["attainment_figure"]

MOST = 3  # methods, because the surfaces of more would hide each other
SHARES = (25, 50, 75)


def attainment_figure(study: Drawn, how: Drawing) -> Figure:
    """The surfaces of 25, 50 and 75 % of the runs of the best few methods, at up to four swept points.

    The value is the gap if the targets are gaps, or if the error is known at the end of the runs only; else it is the
    error. Gaps are those of one formulation. Raises NotDrawnError if moocore is not installed, or no run has a trace.
    """
    axis = axis_of(study, how)
    if axis == "evaluation_equivalents":
        raise NotDrawnError("surfaces are known over evaluations and seconds only")
    parts = chosen(study.by(study.swept))
    progress, measure = _progress(study, axis, how.methods)
    progress = pd.concat([part.at(progress) for part in parts])
    try:
        table = attainment(progress, SHARES, cost=axis)
    except ImportError as error:
        raise NotDrawnError(str(error)) from error
    table = table[table[axis] > 0]
    if table.empty:
        raise NotDrawnError("no run has a trace")
    end = float(progress["cap" if axis == "evaluations" else "seconds"].max())
    rows = panel_rows(len(parts), how.width)
    figure = new_figure(WIDTHS[how.width], (1.9 if len(parts) == 1 else 1.5) * rows + 0.35, study.title)
    axes, left, lowest = panels(figure, len(parts), how.width, sharex=True, sharey=True)
    for ax, part in zip(axes, parts, strict=True):
        headed(ax, part)
        _draw(ax, part, part.at(table), end, axis)
    error_axis(axes, "x", [*table[axis], end])
    error_axis(axes, "y", table["value"])
    for ax in left:
        name_y(ax, "Gap" if measure == "gap" else study.median_label.replace("Median [m]", "Error [m]"), 1.5)
    for ax in lowest:
        ax.set_xlabel(AXIS_LABELS[axis])
    handles = method_handles(study, joined=True, names=set(table["method"]))
    handles["25 to 75 % of the runs"] = Patch(facecolor=GREY, alpha=0.3, linewidth=0)
    value = f"Gap to the {study.evidence.origin_of_gaps(progress['run_id'])}" if measure == "gap" else "Value"
    legend_below(figure, handles, f"{value} that 50 % of the runs have reached, and 25 to 75 % of them")
    return figure


def _progress(study: Drawn, axis: Axis, named: tuple[str, ...]) -> tuple[pd.DataFrame, str]:
    """How the gap or the error of the best few methods fell, the named ones first, and which of the two it is."""
    results, runs = study.evidence.results, study.runs
    columns = (runs["formulation"], runs["solver"])
    formulation = dict(zip(runs["method"], zip(*columns, strict=True), strict=True))
    gaps = any(target.kind == "gap" for target in study.evidence.targets)
    for measure in ("gap",) if gaps else ("error", "gap"):
        making = runs.loc[(runs["evaluations"] > 0) | (axis == "seconds"), "method"].unique()
        order = dict.fromkeys([*named, *best_first(study.evidence), *study.methods])
        methods = [name for name in order if name in making and (measure == "error" or formulation[name][1])]
        if measure == "gap":  # the objectives of different formulations have no common scale
            methods = [name for name in methods if formulation[name][0] == formulation[methods[0]][0]]
        methods = methods[:MOST]
        progress = find_progress(results, measure, runs=runs, methods=methods).frame  # type: ignore[arg-type]
        if np.isfinite(progress["value"]).any() and not (measure == "error" and progress["at_end"].any()):
            return progress, measure
    raise NotDrawnError("no run has a trace")


def _draw(ax: Axes, part: Drawn, table: pd.DataFrame, end: float, cost: Axis) -> None:
    """Draw each method's surfaces as steps that hold to the end of the axis."""
    for name in dict.fromkeys(table["method"]):
        own = table[table["method"] == name]
        style = part.styles[str(name)]
        grid = np.unique(np.append(own[cost], end))
        low, middle, high = (_steps(own[own["percentile"] == share], cost, grid) for share in SHARES)
        look = {key: value for key, value in style.joined.items() if key != "marker"}
        ax.plot(
            grid, np.where(np.isfinite(middle), middle, np.nan), drawstyle="steps-post", **look, label=plain(str(name))
        )
        top = np.where(np.isfinite(high), high, 1e6 * np.where(np.isfinite(low), low, np.nan))
        ax.fill_between(grid, low, top, step="post", color=style.colour, alpha=0.2, linewidth=0)


def _steps(corners: pd.DataFrame, cost: Axis, grid: ndarray) -> ndarray:
    """The value that has been reached at each cost; infinite before the first corner."""
    ordered = corners.sort_values(cost)
    values = np.append(np.inf, ordered["value"].to_numpy(dtype=np.float64))
    return values[np.searchsorted(ordered[cost].to_numpy(dtype=np.float64), grid, side="right")]
