"""How the gap to the reference optimum falls, which shows what a larger or smaller budget would have given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nfbench.analysis import fixed_budget_table
from nfbench.results import find_progress

from .axes import error_axis, legend_below, new_figure
from .data import Drawn, chosen
from .drawing import Drawing, NotDrawnError
from .error import BESIDE, heading, method_handles
from .labels import plain
from .style import WIDTHS

__all__ = ["convergence_figure"]

POINTS = 60  # points of a curve
MARKS = 10  # points between two markers of a curve; the markers of different methods are staggered
BAND = 4  # with more methods in colour, only medians are drawn, because bands would hide each other


def convergence_figure(study: Drawn, how: Drawing) -> Figure:
    """Median and quartiles over scenes of the gap of the first problem.

    There is one column of panels per formulation, because their objectives have no common scale, and one row for each
    of up to four swept points. With NEMO, the first problem is that of the first source; later problems depend on
    what the solver found before. Raises NotDrawnError if no run has a trace.
    """
    parts = chosen(study.by(study.swept))
    runs = pd.concat([part.runs for part in parts])
    progress = find_progress(study.evidence.results, "gap", runs=study.runs).frame
    progress = progress[progress["run_id"].isin(runs["run_id"])]
    if not np.isfinite(progress["value"]).any():
        raise NotDrawnError("no run has a trace")
    last = float(progress["cap"].max())
    budgets = np.unique(np.append(np.geomspace(1, max(last, 2), POINTS).round(), progress["cap"].unique()))
    table = fixed_budget_table(progress, budgets.tolist())
    formulation = dict(zip(study.runs["method"], study.runs["formulation"], strict=True))
    table = table.assign(formulation=table["method"].map(formulation))
    columns = list(dict.fromkeys(table["formulation"]))
    most = (WIDTHS[how.width] - BESIDE) / len(columns)
    extra = max(len(heading(part, most)) for part in parts) - 1 + (len(columns) > 1)
    figure = new_figure(WIDTHS[how.width], (1.45 + 0.12 * max(extra, 0)) * len(parts) + 0.35, study.title)
    grid = figure.subplots(len(parts), len(columns), squeeze=False, sharex="col")
    for row, part in enumerate(parts):
        for column, kind in enumerate(columns):
            own = part.at(table[table["formulation"] == kind])
            _draw(grid[row, column], part, own)
            lines = [*([plain(kind)] if len(columns) > 1 else []), *heading(part, most)]
            grid[row, column].set_title("\n".join(lines), loc="left")
    for column, kind in enumerate(columns):
        own = table[(table["formulation"] == kind) & np.isfinite(table["q25"])]
        error_axis(grid[:, column], "x", own["evaluations"])
        grid[-1, column].set_xlabel("Evaluations")
    for ax in grid[:, 0]:
        ax.set_ylabel("Gap")
    figure.align_ylabels()
    in_colour = table[table["method"].isin(study.coloured)]
    banded = in_colour.groupby("formulation")["method"].nunique().min() <= BAND
    quartiles = " and quartiles" if banded else ""
    origin = study.evidence.origin_of_gaps(runs["run_id"])
    note = f"Median{quartiles} over scenes of the gap to the {origin}"
    legend_below(figure, method_handles(study, joined=True, names=set(table["method"])), note)
    return figure


def _draw(ax: Axes, part: Drawn, table: pd.DataFrame) -> None:
    """Draw the curves of one part; before the median run's first evaluation there is none."""
    drawn: list[float] = []
    bands = len(set(part.coloured) & set(table["method"])) <= BAND
    for number, name in enumerate(part.methods):
        own = table[(table["method"] == name) & np.isfinite(table["median"])]
        if own.empty:
            continue
        style, x = part.styles[name], own["evaluations"].to_numpy(dtype=np.float64)
        marks: dict[str, Any] = (
            {} if style.pale else {"markevery": (number * MARKS // max(len(part.methods), 1), MARKS)}
        )
        ax.plot(x, own["median"], **style.joined, **marks, label=plain(name))
        drawn += own["median"].tolist()
        if not style.pale and bands:
            high = np.where(np.isfinite(own["q75"]), own["q75"], 1e6 * own["median"])
            ax.fill_between(x, own["q25"], high, color=style.colour, alpha=0.16, linewidth=0)
            drawn += own["q25"].tolist()
    error_axis([ax], "y", drawn)
