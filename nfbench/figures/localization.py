"""The picture of an estimate: the array, the box in which sources are searched, and estimates with error ellipses."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from numpy import ndarray

from nfbench.core import NfbenchError, Picture

from .axes import legend_below, new_figure
from .style import GREY, WIDTHS, styled

__all__ = ["BOX", "ELEMENTS", "TRUTH", "ellipse", "localization_figure", "write_localization_figure"]

VIEWS = ((0, 1), (2, 1), (0, 2))  # horizontal and vertical axis of each panel
AXES = "xyz"
FLAT = 1e-6  # extent of an axis, relative to the largest, below which there is nothing to see along it
HIGHEST = 5.5  # of the panels together [in]
VISIBLE = 0.015  # least semi-axis of an ellipse, relative to the width of a panel
TWO_SIGMA = 2.0  # semi-axes of an ellipse in standard errors
COLOUR = "#D55E00"
ELEMENTS: dict[str, Any] = {"color": "#0072B2", "marker": ".", "markersize": 2.5, "linestyle": "", "zorder": 2}
SOURCES: dict[str, Any] = {"color": COLOUR, "marker": "+", "markersize": 6.0, "markeredgewidth": 1.0, "linestyle": ""}
TRUTH: dict[str, Any] = {"color": "black", "marker": "*", "markersize": 5.0, "markeredgewidth": 0.0, "linestyle": ""}
BOX: dict[str, Any] = {"color": GREY, "linewidth": 0.5, "zorder": 1}


def localization_figure(picture: Picture, title: str = "") -> Figure:
    """Draw a picture in up to three views along the axes of the user's coordinates, all with the same scale.

    Ellipses show two standard errors in each view. If the largest of them would be too small to see, all are drawn
    enlarged by a power of ten that the legend states.
    """
    truth = np.empty((0, 3)) if picture.truth is None else picture.truth
    points = np.concatenate([picture.elements, picture.sources, truth, *picture.box])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max()) or 1.0
    views = [view for view in VIEWS if all((high - low)[i] > FLAT * extent for i in view)] or [VIEWS[0]]
    margin = 0.05 * extent
    low, high = low - margin, high + margin
    shown = _sizes(picture.covariances, views)
    factor = _enlargement(shown, extent)
    figure, axes = _panels(views, high - low, title)
    for ax, view in zip(axes, views, strict=True):
        _draw(ax, picture, truth, view, factor)
        i, j = view
        ax.set(xlim=(low[i], high[i]), ylim=(low[j], high[j]), aspect="equal")
        ax.set(xlabel=f"{AXES[i]} [m]", ylabel=f"{AXES[j]} [m]")
    handles = {"Element": Line2D([], [], **ELEMENTS), "Search box": Line2D([], [], **BOX)}
    handles["Estimate"] = Line2D([], [], **SOURCES)
    if shown:
        enlarged = "" if factor == 1 else f", enlarged {factor:,} times"
        handles[f"2 standard errors{enlarged}"] = Line2D([], [], color=COLOUR, linewidth=0.8)
    if len(truth):
        handles["True position"] = Line2D([], [], **TRUTH)
    legend_below(figure, handles)
    return figure


def _panels(views: list[tuple[int, int]], size: Float[ndarray, " 3"], title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel per view: three as in a technical drawing, side and top view at the front view."""
    full = len(views) == len(VIEWS)
    wide = [float(size[i]) for i in ((0, 2) if full else (view[0] for view in views))]
    high = [float(size[j]) for j in ((1, 2) if full else (views[0][1],))]
    if not full:
        high = [max(float(size[j]) for _, j in views)]
    scale = min((WIDTHS["double"] - 0.6 * len(wide)) / sum(wide), HIGHEST / sum(high))  # [in/m]
    height = sum(high) * scale + 0.5 * len(high)
    figure = new_figure(sum(wide) * scale + 0.6 * len(wide), height, title, compress=True)
    grid = figure.subplots(len(high), len(wide), squeeze=False, width_ratios=wide, height_ratios=high)
    if full:
        grid[1, 1].set_visible(False)
        return figure, [grid[0, 0], grid[0, 1], grid[1, 0]]
    return figure, list(grid[0])


def write_localization_figure(picture: Picture, path: Path, title: str = "") -> None:
    """Write the figure in the format that the suffix of the path names, png, svg or pdf.

    Raises NfbenchError if the suffix is another one, or if the file cannot be written.
    """
    kind = path.suffix.lstrip(".").lower()
    if kind not in ("png", "svg", "pdf"):
        raise NfbenchError(f"figure: expected a file that ends in .png, .svg or .pdf, got {path.name}")
    with styled():
        content = io.BytesIO()
        localization_figure(picture, title).savefig(content, format=kind)
    try:
        path.write_bytes(content.getvalue())
    except OSError as error:
        raise NfbenchError(f"{path}: {error.strerror or error}") from error


def _draw(ax: Axes, picture: Picture, truth: Float[ndarray, "n 3"], view: tuple[int, int], factor: int) -> None:
    i, j = view
    for line in picture.box:
        ax.plot(line[:, i], line[:, j], **BOX)
    ax.plot(picture.elements[:, i], picture.elements[:, j], **ELEMENTS)
    for k, (place, covariance) in enumerate(zip(picture.sources, picture.covariances, strict=True), start=1):
        ax.plot(place[i], place[j], **SOURCES, zorder=4)
        ax.annotate(str(k), (place[i], place[j]), (4, 4), textcoords="offset points", fontsize=7)
        part = covariance[np.ix_(view, view)]
        if np.isfinite(part).all():
            ax.add_patch(ellipse(place[[i, j]], part, factor))
    ax.plot(truth[:, i], truth[:, j], **TRUTH, zorder=3)


def ellipse(
    centre: Float[ndarray, " 2"], covariance: Float[ndarray, "2 2"], factor: int, colour: str = COLOUR
) -> Ellipse:
    """The contour at two standard errors along its principal axes."""
    variances, axes = np.linalg.eigh(covariance)
    minor, major = 2 * TWO_SIGMA * factor * np.sqrt(np.maximum(variances, 0.0))
    angle = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
    xy = float(centre[0]), float(centre[1])
    return Ellipse(xy, major, minor, angle=angle, fill=False, edgecolor=colour, linewidth=0.8, zorder=3)


def _sizes(covariances: Float[ndarray, "k 3 3"], views: list[tuple[int, int]]) -> list[float]:
    """The largest semi-axis of each ellipse [m]."""
    sizes = []
    for covariance in covariances:
        for view in views:
            part = covariance[np.ix_(view, view)]
            if np.isfinite(part).all():
                sizes.append(TWO_SIGMA * math.sqrt(max(float(np.linalg.eigvalsh(part)[-1]), 0.0)))
    return sizes


def _enlargement(sizes: list[float], extent: float) -> int:
    """The power of ten by which ellipses are enlarged, so that the largest of them can be seen."""
    largest = max(sizes, default=0.0)
    if not 0 < largest < VISIBLE * extent:
        return 1
    return int(10 ** min(math.ceil(math.log10(VISIBLE * extent / largest)), 9))
