"""True and estimated positions of each source."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

from nfbench.core import NfbenchError, Scenario, Status, explain
from nfbench.results import Results
from nfbench.study import load_scenarios, scene_numbers

from .axes import headline, legend_below, new_figure
from .data import Drawn, key_of
from .drawing import NotDrawnError
from .error import named, slug
from .highlights import by_mean_rank
from .labels import plain
from .localization import ELEMENTS, ellipse
from .scene import hollow
from .scenes import picture_of, swept_key
from .style import GREY, WIDTHS

__all__ = ["few_enough", "position_figures"]

REPETITIONS = 10  # repetitions that are shown; more would hide each other
METHODS = 4  # whose estimates are shown
FEW = {"repetitions": 12, "points": 4, "methods": 6}  # largest study whose positions are drawn by default
COLUMNS = {"single": 3, "double": 6}
WIDEST = 2.2  # maximum width of a panel [in]
AXES = "xyz"
ORIGIN: dict[str, Any] = {"color": GREY, "marker": "+", "markersize": 5.0, "markeredgewidth": 0.8, "linestyle": ""}
TRUTH: dict[str, Any] = {"color": "black", "marker": "*", "markersize": 5.0, "markeredgewidth": 0.0, "linestyle": ""}


@final
@dataclass(frozen=True)
class _Places:
    """The positions at one scenario point [m].

    truth: true positions in the coordinates of the user, (R, K, 3).
    found: estimated positions by method, (R, K, 3); NaN where there is no estimate.
    origin: point from which ranges are measured, (3,).
    elements: positions of the elements of the array, (M, 3); none if they are not known.
    covariances: of an estimate at each true position [m²], (R, K, 3, 3); NaN where they are not known.
    """

    truth: Float[ndarray, "r k 3"]
    found: dict[str, Float[ndarray, "r k 3"]]
    origin: Float[ndarray, " 3"]
    elements: Float[ndarray, "m 3"]
    covariances: Float[ndarray, "r k 3 3"]


def few_enough(study: Drawn) -> bool:
    """Whether the study is small enough that its positions are drawn by default."""
    return (
        study.runs["repetition"].max() < FEW["repetitions"]
        and len(study.by(study.swept)) <= FEW["points"]
        and len(study.methods) <= FEW["methods"]
    )


def position_figures(
    study: Drawn, results: Results, width: str, manifest: Path, plugins: tuple[Path, ...]
) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) of each scenario point with its first ten repetitions.

    Yields nothing if the instances have no positions. Instances are redrawn from the manifest's scenario and the
    stored seeds. Of plugin files, only ``plugins`` are imported, whatever the manifest names. Raises NfbenchError if
    that is not possible, or gives instances other than those of the runs.
    """
    numbers = scene_numbers(manifest)
    scenarios = {swept_key(swept.items()): scenario for swept, scenario in load_scenarios(manifest, plugins)}
    estimates = dict(results.estimates())
    for part in study.by(study.swept):
        scenario = scenarios.get(swept_key((key_of(column), value) for column, value in part.where))
        if scenario is None:
            raise NfbenchError(
                f"{manifest}: expected the scenario of the runs, found none with {named(part) or 'no sweep'}"
            )
        try:
            places = _redrawn(part, scenario, numbers, estimates)
        except NfbenchError:
            raise
        except Exception as error:  # of the scenario, which may be a plugin's or meet estimates that are not its own
            raise NfbenchError(f"{manifest}: positions cannot be redrawn: {explain(error)}") from error
        if places is not None:
            stem = f"positions-{slug(part)}" if part.where else "positions"
            yield stem, _figure(part, places, width)


def _redrawn(part: Drawn, scenario: Scenario, numbers: dict[int, int], estimates: dict[str, Any]) -> _Places | None:
    """Redraw the instances of one point, and match the estimates to them; None if they have no positions."""
    runs = part.runs[part.runs["status"] == Status.OK]
    shown = sorted(runs["repetition"].unique())[:REPETITIONS]
    truths: list[ndarray] = []
    found: dict[str, list[ndarray]] = {name: [] for name in part.methods}
    covariances: list[ndarray] = []
    elements = np.empty((0, 3))
    for repetition in shown:
        same = runs[runs["repetition"] == repetition]
        seed = int(same["instance_seed"].iloc[0])
        instance = scenario.draw_scene(np.random.default_rng(seed), numbers.get(seed, 0))
        matched = {}
        for run in same.to_dict("records"):
            estimate = np.array(estimates[run["run_id"]], dtype=np.float64)
            error = instance.score(estimate)[part.error]
            if not math.isclose(error, run[part.error], rel_tol=1e-6, abs_tol=1e-12):
                raise NfbenchError(
                    f"positions cannot be redrawn: {part.error} of run {run['run_id']} is {run[part.error]:.6g}, but "
                    f"{error:.6g} on the instance redrawn from the manifest's scenario and the run's seed"
                )
            placed = instance.positions(estimate)
            if placed is None or not len(placed[0]):
                return None
            truth, matched[run["method"]] = placed[0][:, :3], placed[1][: len(placed[0]), :3]
        truths.append(truth)
        covariances.append(np.full((len(truth), 3, 3), math.nan))
        with contextlib.suppress(NotDrawnError):
            picture = picture_of(instance)
            elements = picture.elements
            if picture.covariances.shape == covariances[-1].shape:
                covariances[-1] = picture.covariances
        for name, places in found.items():
            places.append(matched.get(name, np.full_like(truth, math.nan)))
    if not shown:
        return None
    placed_by = {name: np.array(places) for name, places in found.items()}
    return _Places(np.array(truths), placed_by, instance.origin(), elements, np.array(covariances))


def _figure(part: Drawn, places: _Places, width: str) -> Figure:
    """One column of panels per source: x and y and, unless one coordinate is constant, x and z below them."""
    origin = np.broadcast_to(places.origin, (1, *places.truth.shape[1:]))
    array = np.repeat(places.elements[:, None], places.truth.shape[1], axis=1)
    everything = np.concatenate([places.truth, *places.found.values(), origin, array])
    low, high = np.nanmin(everything, axis=(0, 1)), np.nanmax(everything, axis=(0, 1))
    views = _views(high - low)
    margin = 0.06 * (high - low).max()
    low, high = low - margin, high + margin
    sources = places.truth.shape[1]
    columns = min(sources, COLUMNS[width])
    blocks = -(-sources // columns)
    across = min((WIDTHS[width] - 0.6) / columns, WIDEST)
    ratios = [(high[j] - low[j]) / (high[i] - low[i]) for i, j in views] * blocks
    figure = new_figure(WIDTHS[width], across * sum(ratios) + 0.3 * blocks + 0.35, part.title, compress=True)
    grid = figure.subplots(len(ratios), columns, squeeze=False, height_ratios=ratios)
    for number, axes in enumerate(grid):
        i, j = views[number % len(views)]
        for column, ax in enumerate(axes):
            k = number // len(views) * columns + column
            if k >= sources:
                ax.set_visible(False)
                continue
            _draw(ax, part, places, k, (i, j))
            ax.set(xlim=(low[i], high[i]), ylim=(low[j], high[j]), aspect="equal")
            last = number % len(views) == len(views) - 1
            ax.tick_params(labelbottom=last, labelleft=column == 0)
            if last:
                ax.set_xlabel(f"{AXES[i]} [m]")
            if column == 0:
                ax.set_ylabel(f"{AXES[j]} [m]")
            if number % len(views) == 0:
                ax.set_title(f"Source {k + 1}", loc="left")
    figure.align_ylabels()
    truth = {"True position": Line2D([], [], **TRUTH), "Array origin": Line2D([], [], **ORIGIN)}
    if len(places.elements):
        truth = {"True position": truth["True position"], "Element": Line2D([], [], **ELEMENTS)}
    if _visible(places, float((high - low).max())):
        truth["2 standard errors"] = Line2D([], [], color="0.25", linewidth=0.6)
    handles = {**truth, **{name: Line2D([], [], **hollow(part.styles[name])) for name in _shown(part)}}
    if part.where:
        headline(figure, named(part))
    shown, every = len(_shown(part)), len(part.methods)
    legend_below(figure, handles, f"The {shown} of {every} methods with the best mean ranks" if shown < every else "")
    return figure


def _shown(part: Drawn) -> list[str]:
    """The methods in colour, or the best few of them, because the estimates of more would hide each other."""
    if len(part.coloured) <= METHODS:
        return part.coloured
    return [name for name in by_mean_rank(part.evidence) if name in part.coloured][:METHODS]


def _views(extents: Float[ndarray, " 3"]) -> list[tuple[int, int]]:
    """The pairs of axes to draw: two views from different sides, or one if everything lies in its plane."""
    flat = [axis for axis in (2, 1, 0) if extents[axis] <= 1e-9 * extents.max()]
    if flat:
        i, j = (axis for axis in range(3) if axis != flat[0])
        return [(i, j)]
    return [(0, 1), (0, 2)]


def _draw(ax: Axes, part: Drawn, places: _Places, k: int, view: tuple[int, int]) -> None:
    """Draw one source in one view: stars, with a line from each star to every method's estimate."""
    i, j = view
    if len(places.elements):
        ax.plot(places.elements[:, i], places.elements[:, j], **{**ELEMENTS, "zorder": 1})
    else:
        ax.plot(places.origin[[i]], places.origin[[j]], **ORIGIN, zorder=1)
    for place, covariance in zip(places.truth[:, k], places.covariances[:, k], strict=True):
        own = covariance[np.ix_(view, view)]
        if np.isfinite(own).all():
            ax.add_patch(ellipse(place[[i, j]], own, 1, "0.25"))
    truth = places.truth[:, k]
    for name in _shown(part):
        style = part.styles[name]
        found = places.found[name][:, k]
        ax.plot([truth[:, i], found[:, i]], [truth[:, j], found[:, j]], color=style.colour, linewidth=0.6, zorder=2)
        ax.plot(found[:, i], found[:, j], **hollow(style), label=plain(name))
    ax.plot(truth[:, i], truth[:, j], **TRUTH, label="truth", zorder=2.5)


def _visible(places: _Places, extent: float) -> bool:
    """Whether an error ellipse can be seen at this scale."""
    variances = np.einsum("rkii->rki", places.covariances)
    return bool(np.nanmax(variances, initial=0.0) > (0.005 * extent) ** 2)
