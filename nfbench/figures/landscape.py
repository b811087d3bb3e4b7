"""What solvers minimize: planes through the objectives of a scene, with their local minima."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

from nfbench.analysis import Minima, find_minima
from nfbench.core import Cut, NfbenchError, explain
from nfbench.results import Results

from .axes import headline, legend_below, new_figure
from .data import Drawn
from .drawing import Drawing, NotDrawnError
from .error import named, slug
from .labels import plain
from .scenes import first_scenes
from .style import WIDTHS

__all__ = ["landscape_figures"]

GRID = (361, 181)  # points along the two axes of a panel
STARTS = 100  # local searches in a plane
HEIGHT = {"single": 1.55, "double": 1.9}  # of a panel [in]
DEEPEST = -30.0  # of the level of a spectrum below its peak [dB]
LABELS = ("Relative level", "Level [dB]")
TRUTH: dict[str, Any] = {
    "color": "white", "marker": "*", "markersize": 8.0, "markeredgecolor": "black", "markeredgewidth": 0.6,
    "linestyle": "", "zorder": 3,
}  # fmt: skip
MINIMUM: dict[str, Any] = {
    "color": "white", "marker": "o", "markersize": 3.4, "markeredgecolor": "black", "markeredgewidth": 0.6,
    "linestyle": "", "zorder": 4,
}  # fmt: skip
LOWEST: dict[str, Any] = {
    **MINIMUM, "marker": "s", "markersize": 5.0, "markerfacecolor": "none", "markeredgecolor": "#FF4D4D",
    "markeredgewidth": 1.0,
}  # fmt: skip


def landscape_figures(study: Drawn, results: Results, how: Drawing) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) of the first scene at up to four swept points: the cuts that its instance names.

    Local minima are those in the plane; there are more in all coordinates. Raises NotDrawnError if the instances have
    no cuts.
    """
    for part, instance, seed in first_scenes(study, results, how):
        try:
            cuts = list(instance.cuts())
            if not cuts:
                raise NotDrawnError("the scenario's instances have no cuts, or the truth is not known")
            stem = f"landscape-{slug(part)}" if part.where else "landscape"
            yield stem, _figure(part, cuts, how.width, seed)
        except NfbenchError:
            raise
        except Exception as error:  # of the scenario
            raise NfbenchError(f"{results.folder}: the landscape cannot be drawn: {explain(error)}") from error


def _figure(part: Drawn, cuts: list[Cut], width: str, seed: int) -> Figure:
    columns = 1 if width == "single" else min(3, len(cuts))
    order = cuts if columns < 3 or len(cuts) != 6 else [*cuts[::2], *cuts[1::2]]  # the cuts of one plane in a row
    rows = -(-len(order) // columns)
    figure = new_figure(WIDTHS[width], HEIGHT[width] * rows + 0.35, part.title)
    grid = figure.subplots(rows, columns, squeeze=False)
    for ax in grid.flat[len(order) :]:
        ax.set_visible(False)
    for ax, cut in zip(grid.flat, order, strict=False):
        _draw(figure, ax, cut, find_minima(cut.plane(), STARTS, np.random.default_rng(seed), cut.marks))
    if part.where:
        headline(figure, named(part))
    handles = {
        "True source": Line2D([], [], **TRUTH),
        "Local minimum": Line2D([], [], **MINIMUM),
        "Lowest minimum": Line2D([], [], **LOWEST),
    }
    legend_below(figure, handles, f"Minima that {STARTS} local searches in each plane found")
    return figure


def _draw(figure: Figure, ax: Axes, cut: Cut, found: Minima) -> None:
    plane, scale = cut.plane(), np.array(cut.scale)
    x, y = (np.linspace(low, high, n) for low, high, n in zip(plane.lower, plane.upper, GRID, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    level = _level(plane.evaluate(points).reshape(len(y), len(x)), float(found.values[0]), cut.spectrum)
    image = ax.pcolormesh(x * scale[0], y * scale[1], level, cmap="viridis", shading="nearest", rasterized=True)
    bar = figure.colorbar(image, ax=ax, pad=0.02, aspect=14)
    bar.set_label(LABELS[cut.spectrum])
    bar.outline.set_linewidth(0.6)
    minima, marks = found.places * scale, cut.marks * scale
    ax.plot(marks[:, 0], marks[:, 1], **TRUTH, label="truth")
    ax.plot(minima[1:, 0], minima[1:, 1], **MINIMUM, label="minima", clip_on=False)  # many are at the edges
    ax.plot(minima[0, 0], minima[0, 1], **LOWEST, label="lowest", clip_on=False)
    ax.grid(visible=False)
    ax.set(xlim=scale[0] * x[[0, -1]], ylim=scale[1] * y[[0, -1]], xlabel=cut.axes[0], ylabel=cut.axes[1])
    kind = "peaks" if cut.spectrum else "minima"
    ax.set_title(plain(f"{cut.name}: {len(minima)} local {kind}"), loc="left")


def _level(J: ndarray, lowest: float, spectrum: bool) -> ndarray:
    """The objective between 0 and 1; or a spectrum, the reciprocal of its distance to the floor, in dB below the peak.

    The floor lies below the lowest value by a thousandth of the range of values, so that the peak is finite.
    """
    low, high = min(lowest, float(J.min())), float(J.max())
    span = (high - low) or 1.0
    if not spectrum:
        return np.asarray((J - low) / span)
    return np.maximum(-10 * np.log10((J - low) / span * 1e3 + 1.0), DEEPEST)
