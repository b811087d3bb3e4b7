"""Figures of a study: errors, run times, runtime distributions, rankings, convergence and positions.

This package imports matplotlib, so it is itself imported only where figures are drawn.
"""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from nfbench.core import NfbenchError
from nfbench.results import Results
from nfbench.study import read_labels

from .array import write_array_figure
from .attainment import attainment_figure
from .convergence import convergence_figure
from .data import Drawn, drawn
from .distribution import distribution_figure
from .drawing import KINDS, Drawing, Kind, NotDrawnError
from .error import error_figures
from .expected_cost import ert_figure
from .geometry import geometry_figures
from .labels import name_of, places, setting, text_of
from .landscape import landscape_figures
from .localization import localization_figure, write_localization_figure
from .positions import few_enough, position_figures
from .ranks import ranks_figure
from .runtime import runtime_figure
from .scene import scene_figures
from .style import styled
from .tex import tex_files
from .tradeoff import spread_of_costs, tradeoff_figure

__all__ = [
    "FORMATS",
    "KINDS",
    "Drawing",
    "Kind",
    "figures",
    "localization_figure",
    "name_of",
    "places",
    "setting",
    "styled",
    "text_of",
    "write_array_figure",
    "write_figures",
    "write_localization_figure",
]

FORMATS: dict[str, dict[str, Any]] = {  # metadata; None drops what changes with the date or version
    "svg": {"Date": None, "Creator": "nfbench"},
    "pdf": {"CreationDate": None, "Creator": "nfbench"},
    "png": {"Software": None},
    "tex": {},
}


_SINGLE: dict[Kind, Callable[[Drawn, Drawing], Figure]] = {
    "runtime": runtime_figure,
    "distribution": distribution_figure,
    "ert": ert_figure,
    "ranks": ranks_figure,
    "tradeoff": tradeoff_figure,
    "attainment": attainment_figure,
    "convergence": convergence_figure,
}


_OF_SCENES: dict[Kind, Callable[[Drawn, Results, Drawing], Iterator[tuple[str, Figure]]]] = {
    "geometry": geometry_figures,
    "scene": scene_figures,
    "landscape": landscape_figures,
}


def figures(
    results: Results, how: Drawing | None = None, warn: Callable[[str], object] = lambda _: None
) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) of every figure of a study. Draw and save the figures within ``styled``.

    results: the results to draw.
    how: how they are drawn; None: with the defaults.
    warn: function that receives a sentence about anything that the figures leave out.

    Without ``only``, these are the figures that have something to show for this study, except for attainment and
    convergence, which read all traces, and geometry, scene and landscape, which redraw scenes.

    Raises StoreError if there is no study, and NfbenchError if no run has an
    estimate yet, or if a requested figure cannot be drawn.
    """
    seen: set[str] = set()
    for stem, figure in _figures(results, how or Drawing(), warn):
        name, number = stem, 2
        while name.lower() in seen:  # different values may give the same stem
            name, number = f"{stem}-{number}", number + 1
        seen.add(name.lower())
        yield name, figure


def _figures(results: Results, how: Drawing, warn: Callable[[str], object]) -> Iterator[tuple[str, Figure]]:
    study = drawn(results, how.title, how.methods, read_labels(how.manifest or results.folder / "manifest.toml"))
    left = results.counts.get("open", 0)
    if left:
        done = len(study.runs)
        warn(f"the study is unfinished; the figures show {done} of {left + done} runs")
    for kind in _kinds(study, how):
        if kind == "error":
            yield from error_figures(study, how.width, how.metric)
        elif kind == "positions":
            yield from _positions(study, results, how, warn)
        elif kind in _OF_SCENES:
            try:
                yield from _OF_SCENES[kind](study, results, how)
            except NotDrawnError as reason:
                raise NfbenchError(f"{results.folder}: {kind} cannot be drawn: {reason}") from reason
        else:
            try:
                yield kind, _SINGLE[kind](study, how)
            except NotDrawnError as reason:
                if _requested(kind, how):
                    raise NfbenchError(f"{results.folder}: {kind} cannot be drawn: {reason}") from reason


def _requested(kind: Kind, how: Drawing) -> bool:
    return kind in how.only or (kind == "convergence" and how.traces) or (kind == "positions" and bool(how.positions))


def _kinds(study: Drawn, how: Drawing) -> list[Kind]:
    """The kinds to draw, in order: the requested ones, or those that suit the study."""
    suits = {
        "tradeoff": spread_of_costs(study),
        "attainment": False,
        "convergence": False,
        **dict.fromkeys(_OF_SCENES, False),
        "positions": how.positions is None and few_enough(study),
    }
    return [kind for kind in KINDS if _requested(kind, how) or (not how.only and suits.get(kind, True))]


def _positions(
    study: Drawn, results: Results, how: Drawing, warn: Callable[[str], object]
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of positions; where they were not requested, only warn if they cannot be drawn."""
    manifest, requested = how.manifest or results.folder / "manifest.toml", _requested("positions", how)
    try:
        placed = list(position_figures(study, results, how.width, manifest, how.plugins))
    except NfbenchError as error:
        if requested:
            raise
        warn(f"positions are not drawn: {error}")
        return
    if requested and not placed:
        raise NfbenchError(f"{results.folder}: positions cannot be drawn: the scenario's instances have none")
    yield from placed


def write_figures(
    results: Results,
    out: Path,
    formats: Iterable[str] = ("svg", "pdf"),
    how: Drawing | None = None,
    warn: Callable[[str], object] = lambda _: None,
) -> list[Path]:
    """Write every figure to a folder in each format, and return the paths. Equal results give equal bytes.

    results, how, warn: as in ``figures``.
    out: folder for the figures.
    formats: keys of FORMATS.

    Raises the errors of ``figures``, and NfbenchError if a file cannot be written.
    """
    paths = []
    with styled(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")  # a label in another script
        for stem, figure in figures(results, how, warn):
            for kind in formats:
                paths.append(out / f"{stem}.{kind}")
                for name, content in _drawing(figure, stem, kind).items():
                    _write(out / name, content)
    return paths


def _drawing(figure: Figure, stem: str, kind: str) -> dict[str, bytes]:
    """The files of a figure in one format, by name."""
    if kind == "tex":
        return tex_files(figure, stem)
    drawing = io.BytesIO()
    figure.savefig(drawing, format=kind, metadata=FORMATS[kind])
    return {f"{stem}.{kind}": drawing.getvalue()}


def _write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.write_bytes(content)
        draft.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise NfbenchError(f"{path}: {error.strerror or error}") from error
