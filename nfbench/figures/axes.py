"""Axes and legends that stay legible: ticks with labels whatever the span, and a legend below the panels."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullFormatter
from numpy import ndarray

from .labels import Places, plain, text_of

__all__ = ["error_axis", "legend_below", "new_figure", "swept_axis"]

_MOST = 6  # labelled decades on one axis
_LEAST = 1.6  # an axis spans at least this ratio, so that noise does not look like a difference
_MARGIN = 0.05


def new_figure(width: float, height: float, title: str) -> Figure:
    """An empty figure of that size [in], its title wrapped to the width."""
    lines = textwrap.wrap(title, width=max(int(width * 17), 20))
    figure = Figure(figsize=(width, height + 0.14 * len(lines)), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03)  # type: ignore[union-attr]
    if lines:
        figure.suptitle(plain("\n".join(lines)))
    return figure


def legend_below(figure: Figure, handles: Sequence[Artist], names: Sequence[str]) -> None:
    """One legend for all panels, below them, in as many columns as fit; the figure grows by its height."""
    texts = list(map(plain, names))
    for columns in range(min(len(texts), 4), 0, -1):
        legend = figure.legend(handles, texts, loc="outside lower center", ncols=columns)
        figure.draw_without_rendering()
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    figure.set_figheight(figure.get_figheight() + legend.get_window_extent().height / figure.dpi)


def error_axis(axes: Iterable[Axes], which: str, values: Iterable[float]) -> None:
    """Make ``which`` ("x" or "y") of these axes logarithmic over the values; with zeros among them, linear near 0."""
    numbers = np.array([value for value in values if math.isfinite(value)], dtype=np.float64)
    positive = numbers[numbers > 0]
    if not len(positive):
        return
    low, high = float(positive.min()), float(positive.max())
    stretch = max(_LEAST / (high / low), 1.0) ** 0.5
    margin = (high / low * stretch**2) ** _MARGIN
    low, high = low / stretch / margin, high * stretch * margin
    zeros = len(positive) < len(numbers)
    for ax in axes:
        if zeros:
            getattr(ax, f"set_{which}scale")("symlog", linthresh=low, linscale=0.5)
        else:
            getattr(ax, f"set_{which}scale")("log")
        getattr(ax, f"set_{which}lim")((-0.2 * low if zeros else low), high)
        _log_ticks(getattr(ax, f"{which}axis"), low, high, [0.0] if zeros else [])


def swept_axis(ax: Axes, at: Places) -> None:
    """The x axis of a numeric key: its values as ticks where there is room, and ∞ apart."""
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
    if width > 0.075:  # room for a label each
        _ticks(ax.xaxis, [*finite, *extra], [*map(text_of, finite), *["∞"] * len(extra)])
    elif at.log:
        _log_ticks(ax.xaxis, finite[0] * 0.99, finite[-1] * 1.01, extra, ["∞"] * len(extra))
    else:
        integers = all(place == int(place) for place in finite)
        ticks = MaxNLocator(nbins=7, integer=integers, steps=[1, 2, 5, 10]).tick_values(finite[0], finite[-1])
        ticks = [tick for tick in ticks if finite[0] <= tick <= finite[-1]]
        _ticks(ax.xaxis, [*ticks, *extra], [*map(text_of, ticks), *["∞"] * len(extra)])


def _ticks(axis: Axis, ticks: Sequence[float], texts: Sequence[str], minor: Sequence[float] = ()) -> None:
    axis.set_major_locator(FixedLocator(list(ticks)))
    axis.set_major_formatter(FixedFormatter(list(texts)))
    axis.set_minor_locator(FixedLocator(list(minor)))
    axis.set_minor_formatter(NullFormatter())


def _log_ticks(axis: Axis, low: float, high: float, extra: list[float], names: Sequence[str] = ("0",)) -> None:
    """Decades where there are three or more, else 1, 2 and 5 times them, else whatever is round."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    step = max(math.ceil((last - first) / _MOST), 1)
    decades = 10.0 ** np.arange(first, last + 1)
    minor = np.outer(decades, np.arange(2, 10)).ravel() if step == 1 else decades
    ticks = _within(decades[::step], low, high)
    if len(ticks) < 3:
        steps = [1, 2, 5] if high / low > 3 else [1, 1.5, 2, 3, 4, 5, 6, 8]
        ticks = _within(np.outer(decades, steps).ravel(), low, high)
    if len(ticks) < 2:
        ticks = _within(MaxNLocator(nbins=4).tick_values(low, high), low, high)
    _ticks(axis, [*extra, *ticks], [*names[: len(extra)], *map(_decimal, ticks)], _within(minor, low, high))


def _within(ticks: Any, low: float, high: float) -> ndarray:
    ticks = np.asarray(ticks)
    return ticks[(low <= ticks) & (ticks <= high)]


def _decimal(value: float) -> str:
    """0.01 and 500 as they are, beyond that powers of ten."""
    if 1e-3 <= value < 1e4:
        return f"{value:g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    mantissa = value / 10.0**exponent
    times = "" if abs(mantissa - 1) < 1e-6 else rf"{mantissa:g}\times "
    return f"${times}10^{{{exponent}}}$"
