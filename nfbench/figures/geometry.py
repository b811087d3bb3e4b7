"""The geometry of a study: the array, the limits of its near field, and the box in which sources are searched."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

from nfbench.core import Picture
from nfbench.results import Results

from .axes import legend_below, new_figure
from .data import Drawn
from .drawing import Drawing
from .error import slug
from .labels import plain
from .localization import BOX, ELEMENTS
from .scenes import first_scenes, picture_of
from .style import WIDTHS

__all__ = ["AXES", "geometry_figures", "planes_of"]

AXES = "xyz"
FLAT = 1e-6  # extent relative to the largest, below which there is nothing to see along an axis
RINGS: tuple[dict[str, Any], ...] = (
    {"color": "#D55E00", "linestyle": (0, (5, 1.5)), "linewidth": 0.9},
    {"color": "#009E73", "linestyle": (0, (1.5, 1.2)), "linewidth": 1.1},
)
CLOSE = 0.15  # margin around the array in its own panel, relative to its extent


def geometry_figures(study: Drawn, results: Results, how: Drawing) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) for each different geometry of up to four swept points.

    One panel shows the box and the distances at the scale of the scene, and one the array alone. Raises NotDrawnError
    if the instances have no picture.
    """
    seen: list[Picture] = []
    for part, instance, _ in first_scenes(study, results, how):
        picture = picture_of(instance)
        if any(_same(picture, other) for other in seen):
            continue
        seen.append(picture)
        stem = f"geometry-{slug(part)}" if len(seen) > 1 else "geometry"
        yield stem, _figure(part, picture, how.width)


def _same(a: Picture, b: Picture) -> bool:
    return (
        a.distances == b.distances
        and np.array_equal(a.elements, b.elements)
        and len(a.box) == len(b.box)
        and all(np.array_equal(one, other) for one, other in zip(a.box, b.box, strict=True))
    )


def planes_of(points: Float[ndarray, "n 3"]) -> list[tuple[int, int]]:
    """The pairs of axes along both of which the points extend: top view first, then the side view."""
    extent = np.ptp(points[np.isfinite(points).all(axis=1)], axis=0)
    found = [(i, j) for i, j in ((0, 1), (0, 2), (1, 2)) if min(extent[[i, j]]) > FLAT * extent.max()]
    if found:
        return found[:2]
    along = int(np.argmax(extent))
    return [(0, 1) if along < 2 else (0, 2)]


def _figure(part: Drawn, picture: Picture, width: str) -> Figure:
    scene = planes_of(np.concatenate([picture.elements, *picture.box]))
    close = planes_of(picture.elements)[:1]
    count = len(scene) + 1
    columns = count if width == "double" else 1
    rows = 1 if width == "double" else count
    figure = new_figure(WIDTHS[width], 2.3 * rows + 0.35, part.title, compress=True)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, view in zip(axes, scene, strict=False):
        _draw_scene(ax, picture, view)
    _draw_array(axes[len(scene)], picture, close[0])
    handles = {"Element": Line2D([], [], **{**ELEMENTS, "markersize": 4.0}), "Search box": Line2D([], [], **BOX)}
    for (name, length), look in zip(picture.distances, RINGS, strict=False):
        seen = any(_crosses(ax, picture, view, length) for ax, view in zip(axes, scene, strict=False))
        handles[f"{name}, {length:.3g} m{'' if seen else ' (outside)'}"] = Line2D([], [], **look)
    legend_below(figure, handles)
    return figure


def _crosses(ax: Axes, picture: Picture, view: tuple[int, int], length: float) -> bool:
    """Whether the circle of this radius about the origin crosses a panel."""
    origin = np.zeros(3) if picture.origin is None else picture.origin
    turn = np.linspace(0, 2 * np.pi, 721)
    x, y = origin[view[0]] + length * np.cos(turn), origin[view[1]] + length * np.sin(turn)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    return bool(((left <= x) & (x <= right) & (bottom <= y) & (y <= top)).any())


def _draw_scene(ax: Axes, picture: Picture, view: tuple[int, int]) -> None:
    """Draw the box and the distances; circles that are larger than the box show where they cross the panel."""
    i, j = view
    origin = np.zeros(3) if picture.origin is None else picture.origin
    everything = np.concatenate([picture.elements, *picture.box, origin[None]])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.06 * float((high - low).max())
    for line in picture.box:
        ax.plot(line[:, i], line[:, j], **BOX)
    turn = np.linspace(0, 2 * np.pi, 361)
    for (_, length), look in zip(picture.distances, RINGS, strict=False):
        ax.plot(origin[i] + length * np.cos(turn), origin[j] + length * np.sin(turn), **look, zorder=1.5)
    ax.plot(picture.elements[:, i], picture.elements[:, j], **ELEMENTS)
    ax.set(xlim=(low[i] - margin, high[i] + margin), ylim=(low[j] - margin, high[j] + margin), aspect="equal")
    ax.set(xlabel=f"{AXES[i]} [m]", ylabel=f"{AXES[j]} [m]")
    ax.set_title("Scene", loc="left")


def _draw_array(ax: Axes, picture: Picture, view: tuple[int, int]) -> None:
    i, j = view
    Q = picture.elements
    ax.plot(Q[:, i], Q[:, j], **{**ELEMENTS, "markersize": 3.5})
    extent = float(np.ptp(Q, axis=0).max()) or 1.0
    middle, half = (Q.max(axis=0) + Q.min(axis=0)) / 2, extent * (0.5 + CLOSE)
    ax.set(xlim=(middle[i] - half, middle[i] + half), ylim=(middle[j] - half, middle[j] + half), aspect="equal")
    ax.set(xlabel=f"{AXES[i]} [m]", ylabel=f"{AXES[j]} [m]")
    ax.set_title(plain(f"Array, {len(Q)} elements"), loc="left")
