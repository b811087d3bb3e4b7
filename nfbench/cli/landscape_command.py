"""The command ``landscape``, which describes the objectives of a study."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .common import Jobs, app, explained, say, warn


@app.command()
def landscape(
    study: Annotated[
        Path, typer.Argument(metavar="DIR|STUDY.toml", help="Results folder, or manifest of a study, run or not.")
    ],
    starts: Annotated[int, typer.Option(min=2, help="Number of local searches on each problem.")] = 100,
    scenes: Annotated[
        int | None, typer.Option(min=1, help="Number of scenes at each swept point (default: all of the study).")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Table to write (default: landscape.csv in DIR, or here).")
    ] = None,
    jobs: Jobs = None,
) -> None:
    """Count the local minima of the objectives that a study minimizes, and measure their basins, scene by scene.

    The table has a row for the first problem of each formulation in each scene. It depends on nothing but the manifest
    and --starts.
    """
    from nfbench.execution import write_landscape

    manifest = study / "manifest.toml" if study.is_dir() else study
    path = out or (study / "landscape.csv" if study.is_dir() else Path("landscape.csv"))
    with explained(manifest.parent):
        say(write_landscape(manifest, path, starts, scenes, (os.cpu_count() or 1) if jobs is None else jobs, warn))
