"""The commands that run a study and show its progress: ``run`` and ``status``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from nfbench.core import Status, StoreError
from nfbench.results import Results
from nfbench.study import Study

from .common import INTERRUPTED, NOT_ALL_OK, OK, USAGE, Folder, Jobs, Plugins, app, output, say, warn

CONFIRM = 1_000_000  # runs from which ``--yes`` is required
BARE_BYTES, TRACED_BYTES, ROWS_PER_S = 278, 6 * 1024, 4000  # of a row, as measured: see the README

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
    keep_skipped: Annotated[
        bool,
        typer.Option("--keep-skipped", help="Run a study although a formulation of it cannot solve any of its scenes."),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Start a study of more than 1,000,000 runs.")] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print only errors and failures: no progress, no tables.")
    ] = False,
) -> None:
    """Run a study, or resume it, and print its results."""
    from nfbench.study import load_study

    part = _shard(shard)
    address = _cluster_address(cluster, scheduler, jobs)
    loaded = load_study(study, plugin or ())
    _announce(loaded, part, yes)

    from nfbench.execution import refuse_dead
    from nfbench.execution import run as run_study  # only now, as a message about the manifest must not wait for them

    from .forecast import Forecast
    from .progress import Lines, LiveView, Quiet

    console = output()
    console, folder = output(), out or Path("results") / loaded.name
    if not keep_skipped and (fresh or not (folder / "runs.sqlite").exists()):  # a folder that exists is resumed
        refuse_dead(loaded)
    what = "runs and proofs" if loaded.proven else "runs"
    forecast = None if shard or quiet else Forecast(loaded, _workers(address, jobs))
    progress = Quiet() if quiet else (LiveView if console.is_terminal else Lines)(console, loaded.error, what, forecast)
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
        console.print(f"Interrupted: {_progress(folder)}. Run the same command to resume.", markup=False)
        raise typer.Exit(INTERRUPTED) from None
    _show(results, console, quiet)
    raise typer.Exit(_outcome(results, quiet))


def _show(results: Results, console: Console, quiet: bool) -> None:
    """Print the report and what was written, or only the failures."""
    from nfbench.report import print_report, shown

    folder = results.folder
    if quiet:
        for status_, method, count, message in [*results.failures, *_failed_proofs(results)]:
            say(f"nfbench: {status_} × {count}: {method}: {message}", error=True)
    else:
        print_report(results, console)
        console.print()
        console.print(shown(f"Written to {folder}/: {', '.join(_written(folder))}"), soft_wrap=True)


def _workers(address: str | None, jobs: int | None) -> str:
    """Where a study runs, as the end of a clause; empty on a cluster whose size is not known."""
    if address and not address.startswith("local:"):
        return ""
    count = int(address.removeprefix("local:")) if address else os.cpu_count() or 1 if jobs is None else max(jobs, 1)
    return f" on {count} worker{'s' * (count != 1)}"


def _written(folder: Path) -> list[str]:
    """The names of the files that a study has written."""
    tables = ("runs", "summary", "targets", "ranking", "claims", "references", "positions")
    found = [path.name for name in tables if (path := folder / f"{name}.csv").is_file()]
    return [*found, "environment.json", "runs.sqlite"]


def _outcome(results: Results, quiet: bool) -> int:
    """The exit code of a study that is finished; a wrong certificate is also printed if nothing else is."""
    wrong = results.contradictions()
    if quiet and len(wrong):
        where = results.folder / "references.csv"
        say(f"nfbench: wrong certificate × {len(wrong)}: see the column contradicted_by in {where}", error=True)
    all_ok = set(results.counts) <= {Status.OK} and set(results.reference_counts) <= {Status.OK, Status.SKIPPED}
    return OK if all_ok and not len(wrong) else NOT_ALL_OK


def _announce(study: Study, shard: tuple[int, int] | None, yes: bool) -> None:
    """Print the warnings. Stop before a very large study unless it is confirmed."""
    for warning in study.warnings:
        warn(warning)
    if len(study) > CONFIRM and not yes:
        say(f"nfbench: {study.name}: {_cost(len(study), shard)}", error=True)
        raise typer.Exit(USAGE)


def _cost(runs: int, shard: tuple[int, int] | None) -> str:
    """Say how large a study is, what it takes on the disk and in time, and how to start it."""
    part = runs // shard[1] if shard else runs
    of = f", of which this shard has about {part:,}" if shard else ""
    disk = f"{_bytes(part * BARE_BYTES)} of disk for the bare rows, or {_bytes(part * TRACED_BYTES)} with traces"
    time = f"{_duration(part / ROWS_PER_S)} at {ROWS_PER_S:,} rows a second at best"
    hint = "Add --yes to start it, or reduce scenes, [sweep] or the number of methods."
    return f"the study has {runs:,} runs{of}. They take {disk}, and {time}. {hint}"


def _bytes(count: float) -> str:
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if count < 1024:
            return f"{count:.3g} {unit}"
        count /= 1024
    return f"{count:.3g} TiB"


def _duration(seconds: float) -> str:
    for unit, size in (("days", 86_400), ("hours", 3600), ("minutes", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} seconds"


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
    parts = text[:40].split("/")
    if len(parts) == 2 and all(part.isdecimal() for part in parts) and 1 <= int(parts[0]) <= int(parts[1]):
        return int(parts[0]), int(parts[1])
    raise typer.BadParameter(f"expected K/N with 1 <= K <= N, e.g. 3/10, got {text!r}", param_hint="--shard")


def _progress(folder: Path) -> str:
    try:
        counts = Results(folder).counts
    except StoreError:  # interrupted before there was a plan
        return "no run is done"
    total = sum(counts.values())
    return f"{total - counts.get('open', 0)} of {total} runs are done"


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
    if proofs := results.reference_counts:
        say(f"{sum(proofs.values()) - proofs.get('open', 0)} of {sum(proofs.values())} optima examined by proofs")
    for status_, method, count, message in [*results.failures, *_failed_proofs(results)]:
        say(f"{status_} × {count}: {method}: {message}")


def _failed_proofs(results: Results) -> list[tuple[str, str, int, str]]:
    """The proofs of optima that are not ok, as ``failures`` lists runs."""
    return [(name, f"optimum of {label}", count, text) for name, label, count, text in results.reference_failures]
