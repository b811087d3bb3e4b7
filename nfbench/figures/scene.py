"""One scene of a study: the array, the box, the true sources with error ellipses, and what methods estimated."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

from nfbench.core import Instance, NfbenchError, Picture, Status, explain
from nfbench.results import Results

from .axes import headline, legend_below, new_figure
from .data import Drawn
from .drawing import Drawing, NotDrawnError
from .error import named, slug
from .geometry import AXES, planes_of
from .localization import BOX, ELEMENTS, TRUTH, ellipse
from .scenes import first_scenes, picture_of
from .style import WIDTHS, Style

__all__ = ["hollow", "scene_figures"]

CLOSE = {"single": 3, "double": 6}  # sources with a panel of their own
HIGHEST = 2.2  # height of such a panel [in]
WINDOW = 3.0  # half width of such a panel, relative to the largest semi-axis of the ellipse
UNITS = (("m", 1.0, 0.05), ("mm", 1e3, 5e-5), ("µm", 1e6, 0.0))  # with factor, and least tick that is short in it [m]
ELLIPSE: dict[str, Any] = {"color": "0.25", "linewidth": 0.8}


def scene_figures(study: Drawn, results: Results, how: Drawing) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) of the first scene at up to four swept points, with the estimates of methods in colour.

    Raises NotDrawnError if the instances have no positions or their truth is not known.
    """
    estimates = dict(results.estimates())
    for part, instance, seed in first_scenes(study, results, how):
        picture = picture_of(instance)
        try:
            found = _found(part, instance, seed, estimates)
        except NfbenchError:
            raise
        except Exception as error:  # of the scenario, which may meet estimates that are not its own
            raise NfbenchError(f"{results.folder}: the scene cannot be drawn: {explain(error)}") from error
        yield f"scene-{slug(part)}" if part.where else "scene", _figure(part, picture, found, how.width)


def _found(part: Drawn, instance: Instance, seed: int, estimates: dict[str, Any]) -> dict[str, Float[ndarray, "n 3"]]:
    """The positions that each method in colour found in the scene: those assigned to the sources come first."""
    runs = part.runs[(part.runs["status"] == Status.OK) & (part.runs["instance_seed"] == seed)]
    found: dict[str, Float[ndarray, "n 3"]] = {}
    for run in runs.to_dict("records"):
        if run["method"] not in part.coloured or run["method"] in found:
            continue
        placed = instance.positions(np.array(estimates[run["run_id"]], dtype=np.float64))
        if placed is None:
            raise NotDrawnError("the scenario's instances have no positions")
        found[run["method"]] = placed[1][:, :3]
    return found


def _figure(part: Drawn, picture: Picture, found: dict[str, Float[ndarray, "n 3"]], width: str) -> Figure:
    views = planes_of(np.concatenate([picture.elements, *picture.box]))
    close = min(len(picture.sources), CLOSE[width])
    across = WIDTHS[width] / len(views) - 0.5
    below = min(WIDTHS[width] / close * 0.9, HIGHEST)
    figure = new_figure(WIDTHS[width], min(across, 2.6) + below + 0.5, part.title)
    above, under = figure.subfigures(2, 1, squeeze=False, height_ratios=[min(across, 2.6), below])[:, 0]
    for ax, view in zip(above.subplots(1, len(views), squeeze=False)[0], views, strict=True):
        _draw(ax, part, picture, found, view)
    panels = list(under.subplots(1, close, squeeze=False)[0])
    widths = [_draw_close(ax, part, picture, found, k, views[0]) for k, ax in enumerate(panels)]
    _name_displacements(panels, widths, views[0])
    handles = {
        "Element": Line2D([], [], **ELEMENTS),
        "Search box": Line2D([], [], **BOX),
        "True source": Line2D([], [], **TRUTH),
        "2 standard errors": Line2D([], [], **ELLIPSE),
        **{name: Line2D([], [], **hollow(part.styles[name])) for name in part.coloured if name in found},
    }
    if part.where:
        headline(figure, named(part))
    legend_below(figure, handles, "Below: displacements from each source; ellipses from the Cramér–Rao bound")
    return figure


def hollow(style: Style) -> dict[str, Any]:
    """Keywords for hollow markers, through which what they cover stays visible."""
    edge = {"markerfacecolor": "none", "markeredgecolor": style.colour, "markeredgewidth": 0.8, "markersize": 4.5}
    return {**style.points, **edge}


def _draw(
    ax: Axes, part: Drawn, picture: Picture, found: dict[str, Float[ndarray, "n 3"]], view: tuple[int, int]
) -> None:
    i, j = view
    for line in picture.box:
        ax.plot(line[:, i], line[:, j], **BOX)
    ax.plot(picture.elements[:, i], picture.elements[:, j], **ELEMENTS)
    for name, places in found.items():
        ax.plot(places[:, i], places[:, j], **hollow(part.styles[name]), label=name)
    ax.plot(picture.sources[:, i], picture.sources[:, j], **TRUTH, zorder=4)
    for k, place in enumerate(picture.sources, start=1):
        ax.annotate(str(k), place[[i, j]], (4, 4), textcoords="offset points", fontsize=7)
    ax.set(xlabel=f"{AXES[i]} [m]", ylabel=f"{AXES[j]} [m]", aspect="equal")


def _draw_close(
    ax: Axes, part: Drawn, picture: Picture, found: dict[str, Float[ndarray, "n 3"]], k: int, view: tuple[int, int]
) -> float:
    """Draw the surroundings of one source, and return half of their width [m]; estimates outside are counted.

    They are as wide as the error ellipse needs, or as half of the estimates need if all would be outside.
    """
    i, j = view
    truth = picture.sources[k]
    covariance = picture.covariances[k][np.ix_(view, view)]
    known = bool(np.isfinite(covariance).all())
    near = {name: places[k, [i, j]] - truth[[i, j]] for name, places in found.items() if k < len(places)}
    distances = [float(np.abs(d).max()) for d in near.values() if np.isfinite(d).all()]
    half = WINDOW * 2 * math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])) if known else 0.0
    if distances and min(distances) > half:
        half = 1.2 * float(np.median(distances))
    half = half or 1.0
    if known:
        ax.add_patch(ellipse(np.zeros(2), covariance, 1, ELLIPSE["color"]))
    for name, place in near.items():
        ax.plot(*place, **hollow(part.styles[name]), label=name)
    ax.plot(0, 0, **TRUTH, zorder=4)
    outside = sum(distance > half for distance in distances)
    if outside:
        ax.annotate(f"{outside} outside", (0.04, 0.95), xycoords="axes fraction", va="top", fontsize=6, zorder=5)
    ax.set_title(f"Source {k + 1}", loc="left")
    ax.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    return half


def _name_displacements(axes: list[Axes], widths: list[float], view: tuple[int, int]) -> None:
    """Label the panels of sources, all in the unit that gives short numbers. widths: half of each panel's width [m]."""
    ticks = [float(f"{half / 2:.0e}") for half in widths]
    unit, factor = next(((u, f) for u, f, least in UNITS if min(ticks) >= least), UNITS[-1][:2])
    for ax, tick in zip(axes, ticks, strict=True):
        text = f"{tick * factor:.6g}"
        ax.set_xticks([-tick, tick], [f"−{text}", text])  # more would not fit
        ax.set_yticks([-tick, 0, tick], [f"−{text}", "0", text])
        ax.set_xlabel(f"Δ{AXES[view[0]]} [{unit}]")
    axes[0].set_ylabel(f"Δ{AXES[view[1]]} [{unit}]")
