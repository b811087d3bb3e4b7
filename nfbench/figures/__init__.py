"""Figures of a study: error against what was swept, run time against error, positions, convergence.

Everything here brings in matplotlib, so it is imported only where figures are drawn.
"""

from __future__ import annotations

import contextlib
import io
import os
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

FORMATS: dict[str, dict[str, Any]] = {  # metadata that would differ from one day or version to the next, left out
    "svg": {"Date": None, "Creator": "nfbench"},
    "pdf": {"CreationDate": None, "Creator": "nfbench"},
    "png": {"Software": None},
}


@final
@dataclass(frozen=True)
class Drawing:
    """How figures are drawn.

    width: "single" or "double", of an IEEE column or page. metric: the error to show (default: RMSE and median).
    title: whether the study's title stands above. positions: whether true and estimated positions are drawn (default:
    if the study is small). traces: whether convergence is. manifest: where the scenario is read from to draw
    positions (default: the copy in the study's folder). plugins: files it needs.
    """

    width: Literal["single", "double"] = "single"
    metric: Wanted | None = None
    title: bool = True
    positions: bool | None = None
    traces: bool = False
    manifest: Path | None = None
    plugins: tuple[Path, ...] = ()


def figures(
    results: Results, how: Drawing | None = None, tell: Callable[[str], object] = lambda _: None
) -> Iterator[tuple[str, Figure]]:
    """(file stem, figure) of every figure of a study. ``tell`` hears in a sentence what they leave out.

    Raises StoreError without a study, NfbenchError where no run has an estimate yet, or where positions were asked
    for and cannot be drawn. Draw and save within ``styled``.
    """
    how = how or Drawing()
    study = drawn(results, how.title)
    left = results.counts.get("open", 0)
    if left:
        tell(f"unfinished: {left} of {left + len(study.runs)} runs are still to do; the figures show the others")
    yield from error_figures(study, how.width, how.metric)
    yield "runtime", runtime_figure(study, how.width, how.metric)
    if how.traces:
        convergence = convergence_figure(study, results, how.width)
        if convergence is None:
            raise NfbenchError(f"{results.folder}: no convergence to draw: no run has a trace")
        yield "convergence", convergence
    if how.positions or (how.positions is None and few_enough(study)):
        manifest = how.manifest or results.folder / "manifest.toml"
        try:
            placed = list(position_figures(study, results, how.width, manifest, how.plugins))
        except NfbenchError as error:
            if how.positions:
                raise
            tell(f"positions are not drawn: {error}")
            return
        if how.positions and not placed:
            raise NfbenchError(f"{results.folder}: no positions to draw: the scenario's instances have none")
        yield from placed


def write_figures(
    results: Results,
    out: Path,
    formats: Iterable[str] = ("svg", "pdf"),
    how: Drawing | None = None,
    tell: Callable[[str], object] = lambda _: None,
) -> list[Path]:
    """Write every figure to ``out`` in each of these formats and return the paths; equal results give equal bytes.

    Raises what ``figures`` does, and NfbenchError where a file cannot be written.
    """
    paths = []
    with styled():
        for stem, figure in figures(results, how, tell):
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
