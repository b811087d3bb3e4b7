"""How every figure looks: sizes for print, and for each method a colour, marker and line that read in grey too."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import matplotlib as mpl

__all__ = ["GREY", "WIDTHS", "Style", "styled", "styles"]

WIDTHS = {"single": 3.5, "double": 7.16}  # of an IEEE column and of the page [in]
GREY = "0.45"

# Okabe & Ito 2008, without black, which is the bounds', and yellow, which fades on paper
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6B4C9A")
_MARKERS = ("o", "s", "^", "D", "v", "<", "p", ">", "P", "h", "X")
_LINES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
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
    "svg.fonttype": "path",  # the same picture without our font
    "svg.hashsalt": "nfbench",  # ids that do not change from one drawing to the next
    "pdf.fonttype": 42,  # TrueType: publishers refuse Type 3
}


@final
@dataclass(frozen=True)
class Style:
    """How one method is drawn, in every panel and file of its study."""

    colour: str
    marker: str
    line: Any

    @property
    def points(self) -> dict[str, Any]:
        """Keywords for markers alone."""
        edge = {"markeredgecolor": "white", "markeredgewidth": 0.3}
        return {"color": self.colour, "marker": self.marker, "linestyle": "", **edge}

    @property
    def joined(self) -> dict[str, Any]:
        """Keywords for markers joined by a line."""
        return {**self.points, "linestyle": self.line}


def styles(methods: Sequence[str]) -> dict[str, Style]:
    """A style each; the pairs of marker and line differ for 44 methods, with the colour for 308."""
    looks = zip(itertools.cycle(_COLOURS), itertools.cycle(_MARKERS), itertools.cycle(_LINES), strict=False)
    return {method: Style(*look) for method, look in zip(methods, looks, strict=False)}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Within: our settings alone, whatever the user's own matplotlibrc says."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield
