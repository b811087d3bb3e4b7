"""Runtime distributions: the share of runs that have reached the targets after a cost."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from nfbench.analysis import Axis, runtime_distribution

from .axes import error_axis, legend_below, new_figure, panel_rows, panels
from .data import Drawn, chosen
from .drawing import Drawing
from .error import headed, method_handles
from .labels import plain
from .style import GREY, WIDTHS
from .target_axes import AXIS_LABELS, axis_of, gap_note, hits_on, reached, target_of

__all__ = ["distribution_figure"]

BANDS = 4  # with more methods in colour, there are no bands, because they would hide each other
POINTS = 60  # points of a curve
LISTED = 6  # targets that the note lists


def distribution_figure(study: Drawn, how: Drawing) -> Figure:
    """The share of runs and targets reached, in one panel or in one for each of up to four swept points.

    All curves of a panel end at the smallest cap of its methods. Raises NotDrawnError if no method makes evaluations,
    or if no target is reached.
    """
    axis, target = axis_of(study, how), target_of(study, how.target)
    hits = hits_on(study, axis, target)
    hits = hits.assign(cap=hits["common_cap"], spent_s=hits["common_s"])
    points, unreached = reached(study, hits)
    parts = chosen(points)
    hits = pd.concat([part.at(hits) for part in parts])
    bands = len(set(study.coloured) & set(hits["method"])) <= BANDS
    figure = new_figure(WIDTHS[how.width], 1.5 * panel_rows(len(parts), how.width) + 0.35, study.title)
    axes, left, lowest = panels(figure, len(parts), how.width, sharex=True, sharey=True)
    costs = hits.loc[hits["hit"] & (hits[axis] > 0), axis]
    start = float(costs.min()) / 2 if len(costs) else float(hits["common_cap"].max()) / 100
    shown = [_draw(ax, part, part.at(hits), axis, bands, start) for ax, part in zip(axes, parts, strict=True)]
    error_axis(axes, "x", np.concatenate(shown))
    several = hits["target"].nunique() > 1
    for ax in left:
        ax.set_ylabel("Share reached [%]")
    for ax in lowest:
        ax.set_xlabel(AXIS_LABELS[axis])
    axes[0].set_ylim(-3, 103)
    axes[0].set_yticks([0, 25, 50, 75, 100])
    handles = method_handles(study, joined=True, names=set(hits["method"]))
    if bands:
        handles["95 % band, pointwise"] = Patch(facecolor=GREY, alpha=0.3, linewidth=0)
    labels = list(dict.fromkeys(hits["target"]))
    listed = "; ".join(labels[:LISTED]) + (f"; and {len(labels) - LISTED} more" if len(labels) > LISTED else "")
    note = "Share of runs and targets" if several else "Share of runs"
    remarks = "; ".join(text for text in (gap_note(study, hits), unreached) if text)
    legend_below(figure, handles, f"{note}: {listed}{f' ({remarks})' if remarks else ''}")
    return figure


def _draw(ax: Axes, part: Drawn, hits: pd.DataFrame, axis: Axis, bands: bool, start: float) -> np.ndarray:
    """Draw one panel, and return the costs above 0 that it shows."""
    headed(ax, part)
    in_colour = hits["method"].isin(part.coloured)
    curves = [
        runtime_distribution(some, axis, points=POINTS, bands=with_bands)
        for some, with_bands in ((hits[in_colour], bands), (hits[~in_colour], False))
    ]
    shown: list[np.ndarray] = []
    table = pd.concat([curve for curve in curves if len(curve)], ignore_index=True) if len(hits) else hits
    for number, name in enumerate(part.methods):
        own = table[table["method"] == name] if len(hits) else hits
        if own.empty:
            continue
        own = _with_start(own, axis, start)
        style, x = part.styles[name], own[axis].to_numpy(dtype=np.float64)
        marks: dict[str, Any] = {} if style.pale else {"markevery": (number * 3 % 10, 10)}
        shown.append(x[x > 0])
        ax.plot(x, 100 * own["share"], drawstyle="steps-post", **style.joined, **marks, label=plain(name))
        if bands and not style.pale:
            edges = 100 * own["low"], 100 * own["high"]
            ax.fill_between(x, *edges, step="post", color=style.colour, alpha=0.16, linewidth=0)
    return np.concatenate(shown) if shown else np.empty(0)


def _with_start(curve: pd.DataFrame, axis: Axis, start: float) -> pd.DataFrame:
    """The curve with a point before its first cost, at which nothing is reached."""
    if curve[axis].iloc[0] <= start:
        return curve.assign(**{axis: curve[axis].clip(lower=start)})  # a cost of 0 is not on a logarithmic axis
    before = curve.iloc[:1].assign(share=0.0, low=math.nan, high=math.nan, **{axis: start})
    return pd.concat([before, curve], ignore_index=True)
