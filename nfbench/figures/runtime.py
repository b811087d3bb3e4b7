"""Run time against error: the cost and the accuracy of each method."""

from __future__ import annotations

from matplotlib.figure import Figure

from .axes import error_axis, legend_below, name_x, name_y, new_figure, panel_rows, panels
from .data import Drawn, chosen
from .drawing import Drawing
from .error import below_bound, bound_handles, bound_look, headed, method_handles
from .labels import plain
from .style import WIDTHS

__all__ = ["runtime_figure"]

TIME = "runtime_median_s"


def runtime_figure(study: Drawn, how: Drawing) -> Figure:
    """One point per method, in one panel or in one for each of up to four scenario points."""
    (metric, *_) = study.metrics(how.metric or "rmse")
    parts = chosen(study.by(study.swept))
    rows = panel_rows(len(parts), how.width)
    height = 1.75 if len(parts) == 1 or how.width == "double" else 1.35
    figure = new_figure(WIDTHS[how.width], height * rows + 0.35, study.title)
    axes, left, lowest = panels(figure, len(parts), how.width, sharex=True, sharey=True)
    for ax, part in zip(axes, parts, strict=True):
        headed(ax, part)
        for name, style in part.styles.items():
            point = part.of(name)
            x, x_low, x_high = (point[f"{TIME}{end}"] for end in ("", "_low", "_high"))
            ax.plot(x, point[metric.column], **style.points, label=plain(name))
            if style.pale:
                continue
            ax.hlines(point[metric.column], x_low, x_high, color=style.colour, linewidth=0.8, zorder=2)
            if f"{metric.column}_low" in point and point[f"{metric.column}_low"].notna().all():
                y_low, y_high = (point[f"{metric.column}_{end}"] for end in ("low", "high"))
                ax.vlines(x, y_low, y_high.clip(upper=1e6 * y_low), color=style.colour, linewidth=0.8, zorder=2)
        for name in metric.bounds:
            for value in part.bound(name)[name] if name in part.table else ():
                ax.axhline(value, **bound_look(name)[1], label=name, zorder=1)
    shown = [f"{metric.column}{end}" for end in ("", "_low", "_high")] + [*metric.bounds]
    error_axis(axes, "y", [v for part in parts for name in shown if name in part.table for v in part.table[name]])
    times = [f"{TIME}{end}" for end in ("", "_low", "_high")]
    error_axis(axes, "x", [v for part in parts for name in times for v in part.table[name]])
    for ax in left:
        name_y(ax, metric.label, height)
    name_x(lowest, study.time_label)
    handles = method_handles(study, joined=False)
    legend_below(figure, handles | bound_handles(parts, [metric]), below_bound(parts, [metric]))
    return figure
