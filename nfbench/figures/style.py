"""The look of all figures: sizes for print, and a colour, marker and line per method that also work in grey."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import matplotlib as mpl

__all__ = ["GREY", "MANY", "WIDTHS", "Style", "styled", "styles"]

WIDTHS = {"single": 3.5, "double": 7.16}  # width of an IEEE column and page [in]
GREY = "0.45"
PALE = "0.72"  # of methods that are not shown in colour

# Okabe & Ito 2008, without black, which the bounds use, and yellow, which is too pale on paper
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6B4C9A", "#882255")
MANY = len(_COLOURS)  # most methods in colour, so that no two have the same
_MARKERS = ("o", "s", "^", "D", "v", "<", "p", ">", "P", "h", "X")
_LINES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # part of matplotlib, so the same everywhere
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.title_fontsize": 7.0,
    "figure.titlesize": 8.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "legend.columnspacing": 1.2,
    "legend.borderaxespad": 0.2,
    "savefig.dpi": 300,
    "svg.fonttype": "path",  # looks the same without our font
    "svg.hashsalt": "nfbench",  # the same ids in every drawing
    "pdf.fonttype": 42,  # TrueType, because publishers refuse Type 3
}


@final
@dataclass(frozen=True)
class Style:
    """How one method is drawn, in every panel and file of its study.

    colour, marker, line: in matplotlib's notation.
    pale: whether the method is drawn in grey, below those in colour.
    """

    colour: str
    marker: str
    line: Any
    pale: bool = False

    @property
    def points(self) -> dict[str, Any]:
        """Keywords of ``plot`` for markers without a line."""
        if self.pale:
            return {"color": PALE, "marker": "o", "markersize": 2.5, "markeredgewidth": 0, "linestyle": "", "zorder": 2}
        edge = {"markeredgecolor": "white", "markeredgewidth": 0.3}
        return {"color": self.colour, "marker": self.marker, "linestyle": "", "zorder": 3, **edge}

    @property
    def joined(self) -> dict[str, Any]:
        """Keywords of ``plot`` for markers joined by a line; methods in grey have no markers."""
        if self.pale:
            return {"color": PALE, "linewidth": 0.6, "linestyle": "-", "zorder": 2}
        return {**self.points, "linestyle": self.line}


def styles(methods: Sequence[str], coloured: Collection[str] | None = None) -> dict[str, Style]:
    """The style of each method. Up to eight have colours of their own; the others are grey.

    methods: labels, in the study's order. coloured: labels of those in colour; None for the first eight.
    """
    chosen = [method for method in methods if coloured is None or method in coloured][:MANY]
    looks = zip(_COLOURS, _MARKERS, itertools.cycle(_LINES), strict=False)
    own = {method: Style(*look) for method, look in zip(chosen, looks, strict=False)}
    return {method: own.get(method, Style(PALE, "o", "-", pale=True)) for method in methods}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Use only our settings in this context, whatever the user's matplotlibrc contains."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield
