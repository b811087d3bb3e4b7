"""The commands that read results folders: ``report``, ``figure``, ``export``, ``compare`` and ``merge``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from .common import NOT_ALL_OK, OK, Folder, Plugins, app, output, say, warn
from .common import explained as _explained


class Width(StrEnum):
    """The widths of a figure."""

    SINGLE = "single"
    DOUBLE = "double"


class Metric(StrEnum):
    """The error measures that a figure can show."""

    RMSE = "rmse"
    MEDIAN = "median"
    AZIMUTH = "azimuth"
    ELEVATION = "elevation"
    RANGE = "range"


class CostAxis(StrEnum):
    """The units of cost in figures about targets."""

    EVALUATIONS = "evaluations"
    SECONDS = "seconds"
    EQUIVALENTS = "equivalents"


_AXES: dict[CostAxis, Literal["evaluations", "seconds", "evaluation_equivalents"]] = {
    CostAxis.EVALUATIONS: "evaluations",
    CostAxis.SECONDS: "seconds",
    CostAxis.EQUIVALENTS: "evaluation_equivalents",
}


class Target(StrEnum):
    """The formats that ``nfbench export`` can write."""

    IOH = "ioh"
    COCO = "coco"
    CSV = "csv"
    PARQUET = "parquet"


Only = Annotated[
    str | None,
    typer.Option(
        metavar="KIND[,KIND]",
        help="Only these figures: error, runtime, distribution, ert, ranks, tradeoff, attainment, convergence, "
        "positions, geometry, scene, landscape (default: those that suit the study).",
    ),
]
OneTarget = Annotated[
    str | None,
    typer.Option(help="Target of ert and distribution: its number, from 1, or label (default: the first, and all)."),
]
Cost = Annotated[CostAxis | None, typer.Option(help="Cost in figures about targets (default: evaluations).")]
Labels = Annotated[
    list[str] | None,
    typer.Option(metavar="LABEL", help="Method to show in colour besides the best ones; repeatable."),
]


@app.command()
def merge(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Results folders of one study, e.g. its shards.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the merged results: a new one, or one of the same study.")],
) -> None:
    """Merge results folders of one study, such as its shards, or rescue what can be read of a damaged folder.

    Contradicting results are refused. The exit code is 1 if something could not be read.
    """
    from nfbench.results import merge as merge_folders
    from nfbench.results import missing_shards

    unread: list[str] = []
    with _explained(*folders):
        results = merge_folders(folders, out, unread.append)
        for text in unread:
            warn(text)
        counts = results.counts
        total = sum(counts.values())
        number = f"{len(folders)} folder{'s' if len(folders) > 1 else ''}"
        say(f"{out}: {total - counts.get('open', 0)} of {total} runs done, merged from {number}")
        if counts.get("open") and not unread and (missing := missing_shards(results)):
            say(f"missing shards: {', '.join(missing[:10])}{' …' if len(missing) > 10 else ''}")
    raise typer.Exit(NOT_ALL_OK if unread else OK)


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="DIR", help="Results folder.")],
    second: Annotated[Path, typer.Argument(metavar="DIR", help="Another results folder of the same study.")],
) -> None:
    """Compare the runs of two results folders of one study.

    The exit code is 1 if the difference matters, or if that cannot be judged.
    """
    from nfbench.report import print_comparison
    from nfbench.results import compare as compare_folders

    with _explained(first, second):
        found = compare_folders(first, second)
        print_comparison(found, output())
    raise typer.Exit(NOT_ALL_OK if found.matters or found.undecided else OK)


@app.command()
def report(
    folder: Folder,
    html: Annotated[
        bool, typer.Option("--html", help="Write one HTML file with tables and interactive figures instead.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File for --html (default: report.html in DIR).")
    ] = None,
) -> None:
    """Print the tables and verdicts of a study, or write them as a page that opens offline in a browser.

    The exit code is 1 if a run contradicts a proven optimum.
    """
    from nfbench.report import print_report
    from nfbench.results import Results

    if out is not None and not html:
        raise typer.BadParameter("it needs --html", param_hint="--out")
    with _explained(folder):
        if html:
            from nfbench.report import write_html  # it imports matplotlib

            say(write_html(Results(folder), out))
        else:
            print_report(Results(folder), output())
        wrong = len(Results(folder).contradictions())
    raise typer.Exit(NOT_ALL_OK if wrong else OK)


@app.command()
def figure(
    folder: Folder,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures (default: DIR).")] = None,
    formats: Annotated[
        str, typer.Option("--format", help="svg, pdf, png, tex (LaTeX code), or several of them separated by commas.")
    ] = "svg,pdf",
    width: Annotated[
        Width, typer.Option(help="Width of the figures: an IEEE column (3.5 in) or page (7.16 in).")
    ] = Width.SINGLE,
    columns: Annotated[
        int | None, typer.Option(min=1, max=2, help="The same as --width: 1 column is single, 2 are double.")
    ] = None,
    metric: Annotated[
        Metric | None,
        typer.Option(
            help="Error measure to show, or a parameter with its RMSE, median and bound (default: RMSE and median, and "
            "the outlier rate if there are outliers)."
        ),
    ] = None,
    title: Annotated[bool, typer.Option(help="Print the study's title above each figure.")] = True,
    positions: Annotated[
        bool | None, typer.Option(help="Draw true and estimated positions (default: only if the study is small).")
    ] = None,
    traces: Annotated[bool, typer.Option("--traces", help="Also draw the gap against evaluations.")] = False,
    only: Only = None,
    target: OneTarget = None,
    axis: Cost = None,
    methods: Labels = None,
    manifest: Annotated[
        Path | None, typer.Option(help="Manifest with the scenario of the positions (default: DIR/manifest.toml).")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Draw a study's figures: errors, run times, runtime distributions, rankings, positions, landscapes and more."""
    from nfbench.figures import FORMATS, KINDS, Drawing, write_figures
    from nfbench.results import Results

    kinds = list(dict.fromkeys(kind.strip() for kind in formats.split(",")))
    unknown = [kind for kind in kinds if kind not in FORMATS]
    if unknown:
        raise typer.BadParameter(f"expected {', '.join(FORMATS)}, got {unknown[0]!r}", param_hint="--format")
    chosen = [kind.strip() for kind in only.split(",")] if only else []
    if unknown := [kind for kind in chosen if kind not in KINDS]:
        raise typer.BadParameter(f"expected some of {', '.join(KINDS)}, got {unknown[0]!r}", param_hint="--only")
    how = Drawing(
        width.value if columns is None else "single" if columns == 1 else "double",
        metric.value if metric else None,
        title,
        positions,
        traces,
        manifest,
        tuple(plugin or ()),
        tuple(kind for kind in KINDS if kind in chosen),
        target,
        None if axis is None else _AXES[axis],
        tuple(methods or ()),
    )
    with _explained(folder):
        for path in write_figures(Results(folder), out or folder, kinds, how, warn):
            say(path)


@app.command()
def export(
    folder: Folder,
    to: Annotated[
        Target, typer.Option(help="Format: IOHprofiler's or COCO's data format, a CSV table, or Parquet files.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Path to write (default: export-FORMAT/ in DIR, or DIR/traces.csv)."),
    ] = None,
) -> None:
    """Export the traces of a study's runs for other tools: how the objective, or its gap to the optimum, fell."""
    from nfbench.results import Results, export_coco, export_csv, export_ioh, export_parquet

    write = {
        Target.IOH: export_ioh,
        Target.COCO: export_coco,
        Target.CSV: export_csv,
        Target.PARQUET: export_parquet,
    }[to]
    with _explained(folder):
        say(write(Results(folder), out))
