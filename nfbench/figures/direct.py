"""Names at the ends of lines, in place of a long legend."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from numpy import ndarray

from .labels import plain

__all__ = ["direct", "name_ends", "spread"]

FEW = 4  # lines that a legend names well
CHARACTER, LINE = 0.058, 0.11  # width of a character and height of a line [in]
SHARE = 0.3  # of the figure's width, the most that names may take
SIZE = 6.5  # of the names [pt]
DARKER = 0.8  # of a line's colour, so that pale colours can be read


def direct(names: Sequence[str], width: float, height: float) -> bool:
    """Whether the lines are named at their ends: there are more than four of them, and their names fit.

    width: of the figure [in]. height: of a panel [in].
    """
    return len(names) > FEW and max(map(len, names)) * CHARACTER <= SHARE * width and len(names) * LINE <= height


def name_ends(ax: Axes, ends: Mapping[str, tuple[float, float]], colours: Mapping[str, str], height: float) -> None:
    """Write the names right of a panel whose axes are scaled, each joined to the end of its line.

    ends: last point of each line, in data coordinates. height: of the panel [in].
    """
    shown = {name: end for name, end in ends.items() if np.isfinite(end).all()}
    if not shown:
        return
    at = ax.transAxes.inverted().transform(ax.transData.transform(np.array(list(shown.values()))))
    places = spread(np.clip(at[:, 1], 0.0, 1.0), LINE / height)
    for name, (x, y), place in zip(shown, at.tolist(), places.tolist(), strict=True):
        colour = tuple(DARKER * part for part in to_rgb(colours[name]))
        line = {"arrowstyle": "-", "linewidth": 0.4, "color": colour, "shrinkA": 0.0, "shrinkB": 2.0}
        ax.annotate(
            plain(name),
            (x, min(max(y, 0.0), 1.0)),
            (1.06, place),
            xycoords="axes fraction",
            textcoords="axes fraction",
            arrowprops=line,
            color=colour,
            fontsize=SIZE,
            verticalalignment="center",
            annotation_clip=False,
        )


def spread(places: Iterable[float], gap: float) -> ndarray:
    """The places, moved as little as needed to be at least a gap apart within 0 to 1 where there is room."""
    wanted = np.array(list(places), dtype=np.float64)
    order = np.argsort(wanted, kind="stable")
    moved = wanted[order]
    for i in range(1, len(moved)):
        moved[i] = max(moved[i], moved[i - 1] + gap)
    top = 1.0
    for i in range(len(moved) - 1, -1, -1):
        moved[i] = min(moved[i], top)
        top = moved[i] - gap
    found = np.empty_like(moved)
    found[order] = moved
    return found
