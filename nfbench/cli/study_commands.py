"""The commands that run a study and say how far it is: ``run`` and ``status``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nfbench.core import Status
from nfbench.results import Results

from .common import INTERRUPTED, NOT_ALL_OK, OK, Folder, Plugins, app, output, warn


@app.command()
def run(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="The manifest of the study.")],
    out: Annotated[Path | None, typer.Option(help="The results folder (default: results/<name>).")] = None,
    jobs: Annotated[int | None, typer.Option(min=0, help="Worker processes (default: one a core; 0: none).")] = None,
    cluster: Annotated[str | None, typer.Option(metavar="local:N", help="Start a cluster of N here.")] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="A dask scheduler to run on.")] = None,
    plugin: Plugins = None,
    shard: Annotated[str | None, typer.Option(metavar="K/N", help="Make only the K-th of N parts, for merge.")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Move an old results folder aside and start anew.")] = False,
    retry: Annotated[list[Status] | None, typer.Option(help="Make the runs of this status again.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table, only errors.")] = False,
) -> None:
    """Run a study, or go on with it where it was left, and show what it found."""
    from nfbench.execution import run as run_study
    from nfbench.report import print_report
    from nfbench.study import load_study

    from .progress import Lines, LiveView, Quiet

    part = _shard(shard)
    where = _where(cluster, scheduler, jobs)
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
                cluster=where,
                shard=part,
                fresh=fresh,
                retry=retry or (),
                listener=progress,
            )
    except KeyboardInterrupt:
        counts = Results(folder).counts
        left = counts.get("open", 0)
        console.print(f"Interrupted with {left} runs to do; the same command goes on from here.")
        raise typer.Exit(INTERRUPTED) from None
    if quiet:
        for status_, method, count, message in results.failures:
            typer.echo(f"nfbench: {status_} × {count}: {method}: {message}", err=True)
    else:
        print_report(results, console)
        names = ("runs.csv", "summary.csv", "environment.json", "runs.sqlite")
        console.print(f"\nWritten to {folder}/: {', '.join(names)}", soft_wrap=True)
    raise typer.Exit(OK if set(results.counts) <= {Status.OK} else NOT_ALL_OK)


def _where(cluster: str | None, scheduler: str | None, jobs: int | None) -> str | None:
    """The address of the cluster to run on; None for this machine's own workers."""
    options = {"--cluster": cluster, "--scheduler": scheduler, "--jobs": jobs}
    given = [name for name, value in options.items() if value is not None]
    if len(given) > 1:
        raise typer.BadParameter("say where to run by one of them", param_hint=" and ".join(given))
    if cluster is not None and not cluster.startswith("local:"):
        raise typer.BadParameter(f"expected local:N, e.g. local:4, got {cluster!r}", param_hint="--cluster")
    if scheduler is not None and "://" not in scheduler:
        raise typer.BadParameter(f"expected e.g. tcp://host:8786, got {scheduler!r}", param_hint="--scheduler")
    return cluster or scheduler


def _shard(text: str | None) -> tuple[int, int] | None:
    """``3/10`` as (3, 10)."""
    if text is None:
        return None
    parts = text.split("/")
    if len(parts) == 2 and all(part.isdecimal() for part in parts) and 1 <= int(parts[0]) <= int(parts[1]):
        return int(parts[0]), int(parts[1])
    raise typer.BadParameter(f"expected K/N with 1 <= K <= N, e.g. 3/10, got {text!r}", param_hint="--shard")


@app.command()
def status(folder: Folder) -> None:
    """How far a study is, also while it runs: runs by status, rate, time left, and what is not ok."""
    results = Results(folder)
    counts, rate = results.counts, results.rate
    total, left = sum(counts.values()), counts.get("open", 0)
    typer.echo(f"{total - left} of {total} runs done")
    if left and rate:
        typer.echo(f"{rate:.3g} runs/s lately; at that rate {left / rate:.0f} s left")
    for name in [*Status, "open"]:
        if name in counts:
            typer.echo(f"{name:>8} {counts[name]}")
    for status_, method, count, message in results.failures:
        typer.echo(f"{status_} × {count}: {method}: {message}")
