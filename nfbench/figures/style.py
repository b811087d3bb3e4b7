"""The look of all figures: sizes for print, and a colour, marker and line per method that also work in grey."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import matplotlib as mpl

__all__ = ["GREY", "WIDTHS", "Style", "styled", "styles"]

WIDTHS = {"single": 3.5, "double": 7.16}  # width of an IEEE column and page [in]
GREY = "0.45"

# Okabe & Ito 2008, without black, which the bounds use, and yellow, which is too pale on paper
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6B4C9A")
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
    """

    colour: str
    marker: str
    line: Any

    @property
    def points(self) -> dict[str, Any]:
        """Keywords of ``plot`` for markers without a line."""
        edge = {"markeredgecolor": "white", "markeredgewidth": 0.3}
        return {"color": self.colour, "marker": self.marker, "linestyle": "", **edge}

    @property
    def joined(self) -> dict[str, Any]:
        """Keywords of ``plot`` for markers joined by a line."""
        return {**self.points, "linestyle": self.line}


def styles(methods: Sequence[str]) -> dict[str, Style]:
    """The style of each method. Marker and line together differ for 44 methods, with the colour for 308."""
    looks = zip(itertools.cycle(_COLOURS), itertools.cycle(_MARKERS), itertools.cycle(_LINES), strict=False)
    return {method: Style(*look) for method, look in zip(methods, looks, strict=False)}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Use only our settings in this context, whatever the user's matplotlibrc contains."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield
