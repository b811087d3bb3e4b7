"""Figures of a study: error against what was swept, run time against error, positions, convergence.

Everything here brings in matplotlib, so it is imported only where figures are drawn.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ..errors import NfbenchError
from ..results import Results
from .data import Wanted, drawn
from .error import error_figures
from .runtime import runtime_figure
from .style import WIDTHS, styled

__all__ = ["FORMATS", "WIDTHS", "figures", "write_figures"]

FORMATS: dict[str, dict[str, Any]] = {  # metadata that would differ from one day or version to the next, left out
    "svg": {"Date": None, "Creator": "nfbench"},
    "pdf": {"CreationDate": None, "Creator": "nfbench", "Producer": None},
    "png": {"Software": None},
}


def figures(
    results: Results, *, width: str = "single", metric: Wanted | None = None, title: bool = True
) -> Iterator[tuple[str, Figure]]:
    """(file stem, figure) of every figure that this study has.

    width: "single" or "double", of an IEEE column or page. metric: the error to show (default: RMSE and median).
    title: whether the study's title stands above. Raises StoreError without a study, NfbenchError where no run has an
    estimate yet. Save them within ``styled``, or by ``write_figures``.
    """
    study = drawn(results, title)
    yield from error_figures(study, width, metric)
    yield "runtime", runtime_figure(study, width, metric)


def write_figures(results: Results, out: Path, formats: Iterable[str] = ("svg", "pdf"), **options: Any) -> list[Path]:
    """Write every figure to ``out`` in these formats; the same results give the same bytes. Returns the paths.

    options: of ``figures``. Raises NfbenchError where a file cannot be written.
    """
    paths = []
    with styled():
        for stem, figure in figures(results, **options):
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
