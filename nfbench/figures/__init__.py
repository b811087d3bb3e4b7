"""Figures of a study: error against the swept values, run time against error, positions, convergence.

This package imports matplotlib, so it is itself imported only where figures are drawn.
"""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, final

from matplotlib.figure import Figure

from nfbench.core import NfbenchError
from nfbench.results import Results

from .convergence import convergence_figure
from .data import Wanted, drawn
from .error import error_figures
from .positions import few_enough, position_figures
from .runtime import runtime_figure
from .style import styled

__all__ = ["FORMATS", "Drawing", "figures", "styled", "write_figures"]

FORMATS: dict[str, dict[str, Any]] = {  # metadata; None drops what changes with the date or version
    "svg": {"Date": None, "Creator": "nfbench"},
    "pdf": {"CreationDate": None, "Creator": "nfbench"},
    "png": {"Software": None},
}


@final
@dataclass(frozen=True)
class Drawing:
    """How figures are drawn.

    width: "single" for the width of an IEEE column (3.5 in), "double" for that of a page (7.16 in).
    metric: the error measure to show; None: RMSE, median, and the outlier rate if there are outliers.
    title: whether to print the study's title above each figure.
    positions: whether to draw true and estimated positions; None: only if the study is small.
    traces: whether to draw convergence.
    manifest: manifest from which the scenario is read to draw positions; None: the copy in the study's folder.
    plugins: plugin files that the scenario needs; those that the manifest names are not imported.
    """

    width: Literal["single", "double"] = "single"
    metric: Wanted | None = None
    title: bool = True
    positions: bool | None = None
    traces: bool = False
    manifest: Path | None = None
    plugins: tuple[Path, ...] = ()


def figures(
    results: Results, how: Drawing | None = None, warn: Callable[[str], object] = lambda _: None
) -> Iterator[tuple[str, Figure]]:
    """Yield (file stem, figure) of every figure of a study. Draw and save the figures within ``styled``.

    results: the results to draw.
    how: how they are drawn; None: with the defaults.
    warn: function that receives a sentence about anything that the figures leave out.

    Raises StoreError if there is no study, and NfbenchError if no run has an estimate yet, or if requested positions
    or traces cannot be drawn.
    """
    seen: set[str] = set()
    for stem, figure in _figures(results, how or Drawing(), warn):
        name, number = stem, 2
        while name.lower() in seen:  # different values may give the same stem
            name, number = f"{stem}-{number}", number + 1
        seen.add(name.lower())
        yield name, figure


def _figures(results: Results, how: Drawing, warn: Callable[[str], object]) -> Iterator[tuple[str, Figure]]:
    study = drawn(results, how.title)
    left = results.counts.get("open", 0)
    if left:
        done = len(study.runs)
        warn(f"the study is unfinished; the figures show {done} of {left + done} runs")
    yield from error_figures(study, how.width, how.metric)
    yield "runtime", runtime_figure(study, how.width, how.metric)
    if how.traces:
        convergence = convergence_figure(study, results, how.width)
        if convergence is None:
            raise NfbenchError(f"{results.folder}: convergence cannot be drawn: no run has a trace")
        yield "convergence", convergence
    if how.positions or (how.positions is None and few_enough(study)):
        manifest = how.manifest or results.folder / "manifest.toml"
        try:
            placed = list(position_figures(study, results, how.width, manifest, how.plugins))
        except NfbenchError as error:
            if how.positions:
                raise
            warn(f"positions are not drawn: {error}")
            return
        if how.positions and not placed:
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
                drawing = io.BytesIO()
                figure.savefig(drawing, format=kind, metadata=FORMATS[kind])
                paths.append(out / f"{stem}.{kind}")
                _write(paths[-1], drawing.getvalue())
    return paths


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
