"""The commands that run a study and show its progress: ``run`` and ``status``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nfbench.core import Status
from nfbench.results import Results

from .common import INTERRUPTED, NOT_ALL_OK, OK, Folder, Jobs, Plugins, app, output, warn

Cluster = Annotated[
    str | None, typer.Option(metavar="local:N", help="Run on a new dask cluster of N workers on this machine.")
]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run on this dask scheduler, e.g. tcp://host:8786.")
]
Shard = Annotated[
    str | None, typer.Option(metavar="K/N", help="Run only the K-th of N parts; join the parts with `nfbench merge`.")
]


@app.command()
def run(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Manifest of the study.")],
    out: Annotated[Path | None, typer.Option(help="Results folder (default: results/<name>).")] = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    scheduler: Scheduler = None,
    plugin: Plugins = None,
    shard: Shard = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Move an old results folder aside and start over.")] = False,
    retry: Annotated[
        list[Status] | None,
        typer.Option(help="Repeat the runs with this status, e.g. failed; can be given several times."),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print only errors and failures: no progress, no tables.")
    ] = False,
) -> None:
    """Run a study, or resume it, and print its results."""
    from nfbench.execution import run as run_study
    from nfbench.report import print_report
    from nfbench.study import load_study

    from .progress import Lines, LiveView, Quiet

    part = _shard(shard)
    address = _cluster_address(cluster, scheduler, jobs)
    loaded = load_study(study, plugin or ())
    console = output()
    for warning in loaded.warnings:
        warn(warning)
    folder = out or Path("results") / loaded.name
    progress = Quiet() if quiet else (LiveView if console.is_terminal else Lines)(console, loaded.error)
    try:
        with progress:
            results = run_study(
                loaded,
                out=folder,
                jobs=jobs,
                cluster=address,
                shard=part,
                fresh=fresh,
                retry=retry or (),
                listener=progress,
            )
    except KeyboardInterrupt:
        counts = Results(folder).counts
        total = sum(counts.values())
        done = f"{total - counts.get('open', 0)} of {total} runs are done"
        console.print(f"Interrupted: {done}. Run the same command to resume.")
        raise typer.Exit(INTERRUPTED) from None
    if quiet:
        for status_, method, count, message in results.failures:
            typer.echo(f"nfbench: {status_} × {count}: {method}: {message}", err=True)
    else:
        print_report(results, console)
        names = ("runs.csv", "summary.csv", "environment.json", "runs.sqlite")
        console.print(f"\nWritten to {folder}/: {', '.join(names)}", soft_wrap=True)
    raise typer.Exit(OK if set(results.counts) <= {Status.OK} else NOT_ALL_OK)


def _cluster_address(cluster: str | None, scheduler: str | None, jobs: int | None) -> str | None:
    """The address of the cluster to run on; None to run on worker processes of this machine."""
    options = {"--cluster": cluster, "--scheduler": scheduler, "--jobs": jobs}
    given = [name for name, value in options.items() if value is not None]
    if len(given) > 1:
        raise typer.BadParameter("expected only one of these options", param_hint=" and ".join(given))
    if cluster is not None and not cluster.startswith("local:"):
        raise typer.BadParameter(f"expected local:N, e.g. local:4, got {cluster!r}", param_hint="--cluster")
    if scheduler is not None and "://" not in scheduler:
        raise typer.BadParameter(
            f"expected an address, e.g. tcp://host:8786, got {scheduler!r}", param_hint="--scheduler"
        )
    return cluster or scheduler


def _shard(text: str | None) -> tuple[int, int] | None:
    """Parse ``3/10`` as (3, 10)."""
    if text is None:
        return None
    parts = text.split("/")
    if len(parts) == 2 and all(part.isdecimal() for part in parts) and 1 <= int(parts[0]) <= int(parts[1]):
        return int(parts[0]), int(parts[1])
    raise typer.BadParameter(f"expected K/N with 1 <= K <= N, e.g. 3/10, got {text!r}", param_hint="--shard")


@app.command()
def status(folder: Folder) -> None:
    """Print the progress of a study, even while it runs: runs by status, rate, time left, and failures."""
    results = Results(folder)
    counts, rate = results.counts, results.rate
    total, left = sum(counts.values()), counts.get("open", 0)
    typer.echo(f"{total - left} of {total} runs done")
    if left and rate:
        typer.echo(f"recent rate: {rate:.3g} runs/s; estimated time left: {left / rate:.0f} s")
    for name in [*Status, "open"]:
        if name in counts:
            typer.echo(f"{name:>8} {counts[name]}")
    for status_, method, count, message in results.failures:
        typer.echo(f"{status_} × {count}: {method}: {message}")
