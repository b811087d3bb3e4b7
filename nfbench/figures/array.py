"""A drawing of an array: its elements, where its front is, and where up is."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy import ndarray

from nfbench.core import NfbenchError, Survey

from .labels import plain
from .style import styled

__all__ = ["array_figure", "write_array_figure"]

PANEL, LEFT = 3.2, 0.25  # width of a panel, and height that is left for the title [in]
THICK = 1e-3  # share of the largest extent from which an array has an extent along an axis
NAMED = 40  # elements; more have no room for their names
FORMATS = ("svg", "png", "pdf")
HALO = [withStroke(linewidth=1.5, foreground="white")]  # so that names are readable across arrows
_COLOURS = {"elements": "#0072B2", "broadside": "#D55E00", "up": "#009E73"}


def array_figure(survey: Survey) -> Figure:
    """Return a figure with a panel for each plane of the user's coordinates in which the array has an area.

    Arrows show the broadside (front) and the direction upwards; one that points at the viewer is a circle with a dot,
    and one that points away a circle with a cross.
    """
    planes = _planes(np.ptp(survey.elements, axis=0))
    figure = Figure(figsize=(PANEL * len(planes), PANEL + LEFT), layout="constrained")
    figure.suptitle(plain(f"{survey.title}: {len(survey.elements)} elements"))
    for ax, (i, j) in zip(figure.subplots(1, len(planes), squeeze=False)[0], planes, strict=True):
        _panel(ax, survey, i, j)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def write_array_figure(survey: Survey, path: Path) -> None:
    """Write the figure to a file in the format of its suffix: .svg, .png or .pdf. Raises NfbenchError."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise NfbenchError(f"{path}: expected a file that ends in {', '.join(f'.{kind}' for kind in FORMATS)}")
    content = io.BytesIO()
    with styled():
        array_figure(survey).savefig(content, format=kind)
    try:
        path.write_bytes(content.getvalue())
    except OSError as error:
        raise NfbenchError(f"{path}: {error.strerror or error}") from error


def _planes(sides: ndarray) -> list[tuple[int, int]]:
    """Return the pairs of axes along both of which the array extends; one pair for a line."""
    extends = sides > THICK * sides.max()
    found = [(i, j) for i, j in ((0, 1), (1, 2), (0, 2)) if extends[i] and extends[j]]
    if found:
        return found
    along = int(np.argmax(sides))
    return [(0, 1) if along < 2 else (1, 2)]


def _panel(ax: Axes, survey: Survey, i: int, j: int) -> None:
    Q = survey.elements
    ax.plot(Q[:, i], Q[:, j], "o", color=_COLOURS["elements"], markersize=3, label="elements", zorder=3)
    if survey.names and len(Q) <= NAMED:
        for q, name in zip(Q, survey.names, strict=True):
            ax.annotate(
                plain(name), q[[i, j]], (2, 2), textcoords="offset points", fontsize=5, path_effects=HALO, zorder=5
            )
    centre, length = (Q.max(axis=0) + Q.min(axis=0)) / 2, 0.35 * float(np.ptp(Q, axis=0).max())
    ahead = np.cross(np.eye(3)[i], np.eye(3)[j])  # from the picture to the viewer
    for name, axis in (("broadside", survey.broadside), ("up", survey.up)):
        start, tip = centre[[i, j]], centre[[i, j]] + length * axis[[i, j]]
        colour, label = _COLOURS[name], "front (broadside)" if name == "broadside" else name
        if np.hypot(*axis[[i, j]]) > 0.1:
            ax.annotate("", tip, start, arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.2})
            ax.plot([], [], "-", color=colour, label=label)
            ax.update_datalim([tip])
        else:
            inner = "." if axis @ ahead > 0 else "x"
            ax.plot(*start, "o", color=colour, markerfacecolor="none", markersize=8, label=label, zorder=4)
            ax.plot(*start, inner, color=colour, markersize=4, zorder=4)
    ax.set_xlabel(f"{'xyz'[i]} [m]")
    ax.set_ylabel(f"{'xyz'[j]} [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.1)
