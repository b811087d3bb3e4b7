"""Best objective against evaluations, which shows what a larger or smaller budget would have given."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

from nfbench.core import Status, Trace
from nfbench.results import Results

from .axes import error_axis, legend_below, new_figure
from .data import Drawn
from .error import named
from .labels import plain
from .runtime import chosen
from .style import WIDTHS

__all__ = ["convergence_figure"]

POINTS = 60  # points of a curve
MARKS = 10  # points between two markers of a curve; the markers of different methods are staggered


def convergence_figure(study: Drawn, results: Results, width: str) -> Figure | None:
    """Median and quartiles over runs of the best value of the first problem; None if no run has a trace.

    There is one column of panels per formulation, because their objectives have no common scale, and one row for each
    of up to four scenario points. With NEMO, the first problem is that of the first source; later problems depend on
    what the solver found before.
    """
    parts = chosen(study.by(study.swept))
    shown = {run_id for part in parts for run_id in part.runs.loc[part.runs["status"] == Status.OK, "run_id"]}
    traces = {run_id: found[0] for run_id, found in results.run_traces() if run_id in shown and found and len(found[0])}
    if not traces:
        return None
    runs = study.runs[study.runs["run_id"].isin(list(traces))]
    formulations = list(dict.fromkeys(runs["formulation"]))
    figure = new_figure(WIDTHS[width], 1.45 * len(parts) + 0.35, study.title)
    grid = figure.subplots(len(parts), len(formulations), squeeze=False, sharex="col")
    everything: dict[str, list[float]] = {name: [] for name in formulations}
    for column, formulation in enumerate(formulations):
        own_runs = runs[runs["formulation"] == formulation]
        for part, ax in zip(parts, grid[:, column], strict=True):
            ids, values = set(part.runs["run_id"]), list[float]()
            for number, name in enumerate(study.methods):
                own = [traces[run] for run in own_runs.loc[own_runs["method"] == name, "run_id"] if run in ids]
                if not own:
                    continue
                evaluations, quartiles = _quartiles(own)
                style = study.styles[name]
                marks = (number * MARKS // max(len(study.methods), 1), MARKS)
                ax.plot(evaluations, quartiles[1], **style.joined, markevery=marks, label=plain(name), zorder=3)
                ax.fill_between(evaluations, quartiles[0], quartiles[2], color=style.colour, alpha=0.16, linewidth=0)
                values += quartiles.ravel().tolist()
                everything[formulation] += evaluations.tolist()
            if min(values, default=1.0) >= 0:
                error_axis([ax], "y", values)
            heading = [plain(formulation), *([named(part)] if part.where else [])]
            ax.set_title(", ".join(heading), loc="left")
        error_axis(grid[:, column], "x", everything[formulation])
        grid[-1, column].set_xlabel("Evaluations")
    for ax in grid[:, 0]:
        ax.set_ylabel("Best objective")
    figure.align_ylabels()
    legend_below(figure, [Line2D([], [], **style.joined) for style in study.styles.values()], list(study.styles))
    return figure


def _quartiles(traces: list[Trace]) -> tuple[Float[ndarray, " p"], Float[ndarray, "3 p"]]:
    """Evaluations, and quartiles over runs of the best value so far. A run keeps its last value to the end."""
    first = max(int(trace.evaluations[0]) for trace in traces)
    last = max(int(trace.evaluations[-1]) for trace in traces)
    grid = np.unique(np.geomspace(first, last, POINTS).round())
    values = [trace.values[np.searchsorted(trace.evaluations, grid, side="right") - 1] for trace in traces]
    return grid, np.quantile(values, [0.25, 0.5, 0.75], axis=0)
