"""Mean ranks of the methods on a line, with the best set of the ranking marked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from nfbench.analysis import ALL, Block

from .axes import legend_below, new_figure
from .data import Drawn, chosen
from .drawing import Drawing, NotDrawnError
from .error import named
from .highlights import listed
from .labels import plain
from .style import GREY, WIDTHS
from .text import fitted_apart

__all__ = ["ranks_figure"]

ROW = 0.15  # height of a row [in]
NAME = {"single": 1.8, "double": 3.6}  # width of a method's name [in]
ROW_SIZE = 7.0  # of the names of rows [pt]
AXIS = 0.65  # height of the axis below the rows [in]
LEAST = 3  # methods; mean ranks of two say no more than who wins how often


def ranks_figure(study: Drawn, how: Drawing) -> Figure:
    """Mean ranks of the errors, over all swept points if there are several, else at the only one.

    The line joins the members of the best set, which tests of the ranking decide and not the distance of mean ranks.
    Raises NotDrawnError if there are fewer than three methods, or no scene that all of them have.
    """
    ranking = study.evidence.ranking
    blocks = _shown(study, ranking.blocks)
    if not blocks:
        raise NotDrawnError(f"there is no scene on which at least {LEAST} methods ran")
    heights = [ROW * _rows(study, block) + AXIS for _, block in blocks]
    figure = new_figure(WIDTHS[how.width], sum(heights), study.title)
    grid = figure.subplots(len(blocks), 1, squeeze=False, height_ratios=heights)[:, 0]
    for ax, (heading, block) in zip(grid, blocks, strict=True):
        frame = ranking.frame
        for column, value in block.swept.items():
            frame = frame[frame[column] == value]
        _draw(ax, study, frame.set_index("method"), NAME[how.width])
        scenes = f"{block.n} scene{'s' * (block.n > 1)}"
        points = f" × {len(block.points)} swept points" if len(block.points) > 1 else ""
        ax.set_title(f"{heading + ': ' if heading else ''}{scenes}{points}", loc="left")
    grid[-1].set_xlabel("Mean rank of the error")
    tested = any(block.stages for _, block in blocks)
    best = Line2D([], [], color="black", linewidth=2.0, marker="o", markersize=4.0)
    rest = Line2D([], [], **_look(GREY, best=False))
    handles = {"Best set": best, "Not in the best set" if tested else "Too few scenes to rank": rest}
    legend_below(figure, handles if tested else {"Too few scenes to rank": rest})
    return figure


def _rows(study: Drawn, block: Block) -> int:
    alone, together = listed(block.methods, study.coloured)
    return len(alone) + bool(together)


def _shown(study: Drawn, blocks: tuple[Block, ...]) -> list[tuple[str, Block]]:
    """The block over all points, or the chosen points if there is none, with headings."""
    known = [block for block in blocks if len(block.methods) >= LEAST and block.n]
    overall = [block for block in known if ALL in [v for v in block.swept.values() if isinstance(v, str)]]
    if overall:
        return [("All swept points", overall[0])]
    found = []
    for part in chosen(study.by(study.swept)):
        own = [block for block in known if all(block.swept.get(column) == value for column, value in part.where)]
        found += [(named(part), block) for block in own[:1]]
    return found


def _draw(ax: Axes, study: Drawn, table: pd.DataFrame, longest: float) -> None:
    """Draw stems from the axis of ranks up to the methods, the best on top."""
    table = table[table["mean_rank"].notna()].sort_values("mean_rank", kind="stable")
    best = table["in_best_set"].fillna(False).astype(bool).to_numpy()
    ranks = table["mean_rank"].to_numpy(dtype=np.float64)
    alone, together = listed([str(name) for name in table.index], study.coloured)
    count = len(alone) + bool(together)
    row_of = dict(zip(alone, range(count, 0, -1), strict=False)) | dict.fromkeys(together, 1)
    rows = np.array([row_of[str(name)] for name in table.index])
    low, high = float(math.floor(ranks[0])), float(max(math.ceil(ranks[-1]), math.floor(ranks[0]) + 1))
    margin = 0.03 * (high - low)
    for name, rank, row, inside in zip(table.index, ranks.tolist(), rows.tolist(), best.tolist(), strict=True):
        style = study.styles[name]
        colour = GREY if style.pale else style.colour
        if name not in together:
            ax.plot([rank, rank, high + margin], [0, row, row], color="0.8", linewidth=0.6, zorder=1)
        look = study.styles[name].points if name in together else _look(colour, inside)
        ax.plot(rank, row, **look, label=plain(name))
    if best.any():
        ax.plot([ranks[best][0], ranks[best][-1]], [0, 0], color="black", linewidth=2.0, zorder=2)
        ax.plot(
            ranks[best],
            np.zeros(best.sum()),
            "o",
            color="black",
            markersize=3.0,
            label="best set",
            clip_on=False,
            zorder=4,
        )
    ax.set_xlim(low - margin, high + margin)
    ticks = MaxNLocator(nbins=9 if high < 100 else 6, integer=True).tick_values(low, high)
    ax.set_xticks([tick for tick in ticks if low <= tick <= high])
    ax.set_ylim(0, count + 0.6)
    ax.yaxis.tick_right()
    names = fitted_apart(alone, longest, ROW_SIZE) + [f"{len(together)} other methods"] * bool(together)
    ax.set_yticks(range(count, 0, -1), names)
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False)
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    inside_of = dict(zip(table.index, best.tolist(), strict=True))
    for label, name in zip(ax.get_yticklabels(), [*alone, *[""] * bool(together)], strict=True):
        label.set_color("black" if inside_of.get(name, False) or not best.any() else GREY)


def _look(colour: str, best: bool) -> dict[str, Any]:
    """Keywords of ``plot`` for a mean rank: filled in the best set, hollow outside."""
    face = colour if best else "white"
    return {
        "color": colour,
        "marker": "o",
        "markersize": 4.0,
        "markerfacecolor": face,
        "markeredgecolor": colour,
        "linestyle": "",
        "zorder": 3,
    }
