"""Run time against error: the cost and the accuracy of each method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .axes import error_axis, legend_below, new_figure
from .data import Drawn, Wanted
from .error import BOUNDS, headed, method_handles
from .labels import plain
from .style import WIDTHS

__all__ = ["chosen", "runtime_figure"]

PANELS = 4


def runtime_figure(study: Drawn, width: str, wanted: Wanted | None) -> Figure:
    """One point per method, in one panel or in one for each of up to four scenario points."""
    (metric, *_) = study.metrics(wanted or "rmse")
    parts = chosen(study.by(study.swept))
    columns = min(len(parts), 2 if width == "single" else PANELS)
    rows = -(-len(parts) // columns)
    figure = new_figure(WIDTHS[width], (1.75 if columns == 1 or width == "double" else 1.35) * rows + 0.35, study.title)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for ax, part in zip(grid.flat, parts, strict=False):
        headed(ax, part)
        for name, style in part.styles.items():
            point = part.of(name)
            x, x_low, x_high = (point[f"runtime_s{end}"] for end in ("", "_low", "_high"))
            y, y_low, y_high = (point[f"{metric.column}{end}"] for end in ("", "_low", "_high"))
            ax.hlines(y, x_low, x_high, color=style.colour, linewidth=0.8, zorder=2)
            ax.vlines(x, y_low, y_high, color=style.colour, linewidth=0.8, zorder=2)
            ax.plot(x, y, **style.points, label=plain(name), zorder=3)
        for name, (_, look) in BOUNDS.items():
            for value in part.bound(name)[name] if metric.bounded and name in part.table else ():
                ax.axhline(value, **look, label=name, zorder=1)
    for ax in grid.flat[len(parts) :]:
        ax.set_visible(False)
    shown = [f"{metric.column}{end}" for end in ("", "_low", "_high")] + [name for name in BOUNDS if metric.bounded]
    error_axis(grid.flat, "y", [v for part in parts for name in shown if name in part.table for v in part.table[name]])
    times = ["runtime_s", "runtime_s_low", "runtime_s_high"]
    error_axis(grid.flat, "x", [v for part in parts for name in times for v in part.table[name]])
    for ax in grid[:, 0]:
        ax.set_ylabel(metric.label)
    for ax in grid.flat[max(len(parts) - columns, 0) : len(parts)]:
        ax.set_xlabel("Run time [s]")
        ax.tick_params(labelbottom=True)
    handles = method_handles(study, joined=False)
    for name, (text, look) in BOUNDS.items():
        if metric.bounded and any(len(part.bound(name)) for part in parts):
            handles[text] = Line2D([], [], **look)
    legend_below(figure, list(handles.values()), list(handles))
    return figure


def chosen(parts: Sequence[Drawn]) -> list[Drawn]:
    """All parts, or four of them: the first, the last and two evenly spaced between."""
    picks = np.unique(np.linspace(0, len(parts) - 1, PANELS).round().astype(int))
    return [parts[i] for i in picks] if len(parts) > PANELS else list(parts)
