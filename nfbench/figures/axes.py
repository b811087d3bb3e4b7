"""Legible axes and legends: labelled ticks for any range of values, and a legend below the panels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullFormatter
from numpy import ndarray

from .labels import Places, plain, text_of
from .text import wrapped

__all__ = [
    "error_axis",
    "headline",
    "legend_below",
    "name_x",
    "name_y",
    "new_figure",
    "panel_rows",
    "panels",
    "swept_axis",
]

_PER_INCH = {"x": 2.2, "y": 3.5}  # labels that fit in an inch
_CHARACTER, _LINE, _GAP = 0.07, 0.12, 0.03  # width of a character, height and gap of labels [in]
_LEAST = 1.6  # smallest ratio that an axis spans, so that noise does not look like a difference
_MARGIN = 0.05
_TITLE, _LABEL, _SMALL = 8.0, 7.5, 7.0  # sizes of titles, of labels, and of legends [pt]
_EDGE, _BESIDE, _HANDLE = 0.06, 0.6, 0.48  # margin, room for a y axis and its labels, and handle of a legend [in]


def new_figure(width: float, height: float, title: str, compress: bool = False) -> Figure:
    """An empty figure of that size [in] with a wrapped title. Set ``compress`` for panels with a fixed aspect."""
    figure = Figure(
        figsize=(width, height),
        layout=ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, compress=compress),
    )
    headline(figure, plain(title))
    return figure


def headline(figure: Figure, text: str) -> None:
    """Add a line of text, as ``plain`` returns it, to the title of a figure, which grows by the height of its lines."""
    before = figure.get_suptitle()
    lines = wrapped(text.replace(" = ", "\u00a0=\u00a0"), figure.get_figwidth() - 2 * _EDGE, _TITLE)
    if lines:
        figure.suptitle("\n".join([*([before] if before else []), *lines]))
        figure.set_figheight(figure.get_figheight() + 0.14 * len(lines))


def name_x(axes: Iterable[Axes], text: str) -> None:
    """Label the x axes of panels in one row, in as many lines as fit below them; the figure grows by their height."""
    axes = list(axes)
    figure = cast(Figure, axes[0].get_figure())
    lines = wrapped(text, _inner(figure) / _columns_of(axes[0]) - _EDGE, _LABEL)
    for ax in axes:
        ax.set_xlabel("\n".join(lines))
    figure.set_figheight(figure.get_figheight() + _LINE * (len(lines) - 1))


def name_y(ax: Axes, text: str, height: float) -> None:
    """Label the y axis of a panel of this height [in], in as many lines as fit beside it."""
    ax.set_ylabel("\n".join(wrapped(text, height, _LABEL)))


def _inner(figure: Figure) -> float:
    """The width of all panels together, without the labels of the y axis [in]."""
    return figure.get_figwidth() - _BESIDE


def _columns_of(ax: Axes) -> int:
    place = ax.get_subplotspec()
    return place.get_gridspec().ncols if place else 1


def panels(figure: Figure, count: int, width: str, **share: Any) -> tuple[list[Axes], list[Axes], list[Axes]]:
    """Add this many panels, in rows of two, or of four in a wide figure.

    Returns all panels, those at the left edge, and those with nothing below them.
    """
    columns = _columns(count, width)
    rows = -(-count // columns)
    grid = figure.subplots(rows, columns, squeeze=False, **share)
    for ax in grid.flat[count:]:
        ax.set_visible(False)
    lowest = list(grid.flat[max(count - columns, 0) : count])
    for ax in lowest:
        ax.tick_params(labelbottom=True)
    return list(grid.flat[:count]), list(grid[:, 0]), lowest


def panel_rows(count: int, width: str) -> int:
    """Number of rows of ``panels``."""
    return -(-count // _columns(count, width))


def _columns(count: int, width: str) -> int:
    return min(count, 2 if width == "single" else 4)


def legend_below(figure: Figure, entries: Mapping[str, Artist], note: str = "") -> None:
    """Add a legend below all panels, in as many columns as fit, with a note above it. The figure grows by its height.

    entries: drawn example of each text.
    """
    width = figure.get_figwidth()
    handles = list(entries.values())
    texts = [plain("\n".join(wrapped(text, width - _HANDLE, _SMALL))) for text in entries]
    note = plain("\n".join(wrapped(note, width - 2 * _EDGE, _SMALL)))
    height = figure.get_figheight()
    room = len(texts) + sum(text.count("\n") for text in [*texts, note])
    figure.set_figheight(height + 0.2 * (room + 2))  # room to measure the legend in
    for wanted in range(min(len(texts), 4), 0, -1):
        rows = math.ceil(len(texts) / wanted)
        columns = math.ceil(len(texts) / rows)
        legend = figure.legend(handles, texts, loc="outside lower center", ncols=columns, title=note or None)
        legend.get_title().set_multialignment("center")
        figure.draw_without_rendering()
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    figure.set_figheight(height + legend.get_window_extent().height / figure.dpi)


def error_axis(axes: Iterable[Axes], which: Literal["x", "y"], values: Iterable[float]) -> None:
    """Make the x or y axis of these panels logarithmic over the values, and linear near 0 if there are zeros."""
    numbers = np.array([value for value in values if math.isfinite(value)], dtype=np.float64)
    positive = numbers[numbers > 0]
    if not len(positive):
        return
    low, high = float(positive.min()), float(positive.max())
    stretch = max(_LEAST / (high / low), 1.0) ** 0.5
    margin = (high / low * stretch**2) ** _MARGIN
    low, high = low / stretch / margin, high * stretch * margin
    zeros = [0.0] if len(positive) < len(numbers) else []
    for ax in axes:
        scale, limits = (ax.set_xscale, ax.set_xlim) if which == "x" else (ax.set_yscale, ax.set_ylim)
        if zeros:
            scale("symlog", linthresh=low, linscale=max(0.1 * math.log10(high / low), 0.5))
        else:
            scale("log")
        limits(-0.7 * low if zeros else low, high)
        _log_ticks(ax, which, low, high, zeros, ["0"] * len(zeros))


def swept_axis(ax: Axes, at: Places) -> None:
    """Set up the x axis of a numeric key: ticks at its values if there is room, and ∞ set apart."""
    finite = sorted(place for value, place in at.of.items() if math.isfinite(value))
    every = sorted(at.of.values())
    ends = np.log(every) if at.log else np.array(every)
    pad = 0.04 * (ends[-1] - ends[0])
    low, high = ends[0] - pad, ends[-1] + pad
    if at.log:
        ax.set_xscale("log")
        low, high = math.exp(low), math.exp(high)
    ax.set_xlim(low, high)
    width = np.diff(ends).min() / (ends[-1] - ends[0])
    extra = [] if at.beyond is None else [at.beyond]
    if width > 0.075:  # there is room for a label at each value
        _ticks(ax.xaxis, [*finite, *extra], [*map(text_of, finite), *["∞"] * len(extra)])
    elif at.log:
        _log_ticks(ax, "x", finite[0] * 0.99, finite[-1] * 1.01, extra, ["∞"] * len(extra))
    else:
        integers = all(place == int(place) for place in finite)
        ticks = MaxNLocator(nbins=7, integer=integers, steps=[1, 2, 5, 10]).tick_values(finite[0], finite[-1])
        ticks = [tick for tick in ticks if finite[0] <= tick <= finite[-1]]
        _ticks(ax.xaxis, [*ticks, *extra], [*map(text_of, ticks), *["∞"] * len(extra)])


def _ticks(axis: Axis, ticks: Iterable[float], texts: Iterable[str], minor: Iterable[float] = ()) -> None:
    axis.set_major_locator(FixedLocator(list(ticks)))
    axis.set_major_formatter(FixedFormatter(list(texts)))
    axis.set_minor_locator(FixedLocator(list(minor)))
    axis.set_minor_formatter(NullFormatter())


def _log_ticks(
    ax: Axes, which: Literal["x", "y"], low: float, high: float, extra: Sequence[float], names: Sequence[str]
) -> None:
    """Set as many labels as fit, at decades if there are three, else at finer steps; and those at ``extra``."""
    figure = cast(Figure, ax.get_figure())
    rows, columns = ax.get_subplotspec().get_gridspec().get_geometry()  # type: ignore[union-attr]
    inches = 0.75 * figure.get_figwidth() / columns if which == "x" else 0.8 * figure.get_figheight() / rows
    most = max(int(inches * _PER_INCH[which]), 3)

    def fits(ticks: ndarray) -> bool:
        """Whether there is a gap between neighbouring labels at these ticks."""
        places = inches * np.log(ticks / low) / math.log(high / low)
        sizes = np.array([_CHARACTER * _length(tick) if which == "x" else _LINE for tick in ticks])
        return _width(ticks) <= most and bool((np.diff(places) > (sizes[1:] + sizes[:-1]) / 2 + _GAP).all())

    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    decades = 10.0 ** np.arange(first, last + 1)
    steps = [decades[start::step] for step in range(1, len(decades)) for start in range(step)]
    finer = [np.outer(decades, factors).ravel() for factors in ((1, 1.5, 2, 3, 4, 5, 6, 8), (1, 2, 5), (1, 3))]
    round_ones = MaxNLocator(nbins=most).tick_values(low, high)
    choices = steps + finer if len(_within(decades, low, high)) > 2 else [*finer, decades, round_ones]
    found = [ticks for choice in choices if len(ticks := _within(choice, low, high)) > 1] or [np.array([low, high])]
    ends = [ticks[[0, -1]] for ticks in found]
    ticks = next(filter(fits, [*found, *ends]), max(ends, key=lambda pair: pair[1] / pair[0]))
    minor = np.outer(decades, np.arange(1, 10)).ravel() if len(decades) <= 8 else decades
    axis = ax.xaxis if which == "x" else ax.yaxis
    _ticks(axis, [*extra, *ticks], [*names, *map(_decimal, ticks)], _within(minor, low, high))


def _width(ticks: ndarray) -> float:
    """Number of labels; those with a factor before a power of ten count twice."""
    return sum(2 if r"\times" in _decimal(tick) else 1 for tick in ticks)


def _length(tick: float) -> int:
    """Length of a label as it is printed [characters], without the markup of a power of ten."""
    text = _decimal(tick)
    return len(text) if "$" not in text else 8 if r"\times" in text else 4


def _within(ticks: Any, low: float, high: float) -> ndarray:
    ticks = np.asarray(ticks)
    return ticks[(low <= ticks) & (ticks <= high)]


def _decimal(value: float) -> str:
    """The label of a value: a decimal such as 0.01 or 500, or a power of ten outside 0.001 to 10⁴."""
    if 1e-3 <= value < 1e4:
        return f"{float(f'{value:.3g}'):g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    mantissa = value / 10.0**exponent
    times = "" if abs(mantissa - 1) < 1e-6 else rf"{mantissa:g}\times "
    return f"${times}10^{{{exponent}}}$"
