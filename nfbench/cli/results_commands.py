"""The commands that read results folders: ``report``, ``figure``, ``export``, ``compare`` and ``merge``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .common import NOT_ALL_OK, OK, Folder, Plugins, app, output, warn


class Width(StrEnum):
    """The widths of a figure."""

    SINGLE = "single"
    DOUBLE = "double"


class Metric(StrEnum):
    """The error measures that a figure can show."""

    RMSE = "rmse"
    MEDIAN = "median"


class Target(StrEnum):
    """The formats that ``nfbench export`` can write."""

    IOH = "ioh"
    CSV = "csv"


@app.command()
def merge(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Results folders of one study, e.g. its shards.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the merged results: a new one, or one of the same study.")],
) -> None:
    """Merge results folders of one study, such as its shards. Contradicting results are refused."""
    from nfbench.results import merge as merge_folders

    counts = merge_folders(folders, out).counts
    total = sum(counts.values())
    typer.echo(f"{out}: {total - counts.get('open', 0)} of {total} runs done, merged from {len(folders)} folders")


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="DIR", help="Results folder.")],
    second: Annotated[Path, typer.Argument(metavar="DIR", help="Another results folder of the same study.")],
) -> None:
    """Compare the runs of two results folders of one study. The exit code is 1 if the difference matters."""
    from nfbench.report import print_comparison
    from nfbench.results import compare as compare_folders

    found = compare_folders(first, second)
    print_comparison(found, output())
    raise typer.Exit(NOT_ALL_OK if found.matters else OK)


@app.command()
def report(folder: Folder) -> None:
    """Print the tables and verdicts of a study."""
    from nfbench.report import print_report
    from nfbench.results import Results

    print_report(Results(folder), output())


@app.command()
def figure(
    folder: Folder,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures (default: DIR).")] = None,
    formats: Annotated[
        str, typer.Option("--format", help="svg, pdf, png, or several of them separated by commas.")
    ] = "svg,pdf",
    width: Annotated[
        Width, typer.Option(help="Width of the figures: an IEEE column (3.5 in) or page (7.16 in).")
    ] = Width.SINGLE,
    metric: Annotated[
        Metric | None,
        typer.Option(help="Error measure to show (default: both, and the outlier rate if there are outliers)."),
    ] = None,
    title: Annotated[bool, typer.Option(help="Print the study's title above each figure.")] = True,
    positions: Annotated[
        bool | None, typer.Option(help="Draw true and estimated positions (default: only if the study is small).")
    ] = None,
    traces: Annotated[bool, typer.Option("--traces", help="Also draw the objective against evaluations.")] = False,
    manifest: Annotated[
        Path | None, typer.Option(help="Manifest with the scenario of the positions (default: DIR/manifest.toml).")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Draw a study's figures: error against the swept values, run time against error, positions, convergence."""
    from nfbench.figures import FORMATS, Drawing, write_figures
    from nfbench.results import Results

    kinds = list(dict.fromkeys(kind.strip() for kind in formats.split(",")))
    unknown = [kind for kind in kinds if kind not in FORMATS]
    if unknown:
        raise typer.BadParameter(f"expected {', '.join(FORMATS)}, got {unknown[0]!r}", param_hint="--format")
    how = Drawing(
        width.value, metric.value if metric else None, title, positions, traces, manifest, tuple(plugin or ())
    )
    for path in write_figures(Results(folder), out or folder, kinds, how, warn):
        typer.echo(path)


@app.command()
def export(
    folder: Folder,
    to: Annotated[Target, typer.Option(help="Format: IOHprofiler's data format, or a CSV table.")],
    out: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Path to write (default: export-ioh/ or traces.csv in DIR).")
    ] = None,
) -> None:
    """Export the traces of a study's runs (objective against evaluations) for other tools."""
    from nfbench.results import Results, export_csv, export_ioh

    write = {Target.IOH: export_ioh, Target.CSV: export_csv}[to]
    typer.echo(write(Results(folder), out))
