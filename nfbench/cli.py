"""The command line: ``nfbench run STUDY.toml`` and its companions."""

from __future__ import annotations

import os
import sys
import tomllib
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from . import __version__
from .budget import Status
from .errors import NfbenchError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
check_app = typer.Typer(no_args_is_help=True, help="Run the conformance checks on a plugin.")
app.add_typer(check_app, name="check")
new_app = typer.Typer(no_args_is_help=True, help="Write a plugin file that works, to make your own of.")
app.add_typer(new_app, name="new")

OK, NOT_ALL_OK, USAGE, INTERRUPTED = 0, 1, 2, 130

Plugins = Annotated[list[Path] | None, typer.Option("--plugin", help="A plugin file; may be given more than once.")]
GivenOptions = Annotated[list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="An option of it.")]
Timeout = Annotated[float, typer.Option(min=0.1, help="What one check may take at most [s].")]
NewName = Annotated[str, typer.Argument(metavar="NAME", help="Its name in manifests, e.g. my-solver.")]
Out = Annotated[Path | None, typer.Option(metavar="FILE", help="Where to write it (default: its name with .py).")]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="A results folder, e.g. results/quickstart.")]


class Kind(StrEnum):
    """What ``nfbench list`` can list, in the plural as one says it."""

    SOLVERS = "solvers"
    FORMULATIONS = "formulations"
    SCENARIOS = "scenarios"


class YesNo(StrEnum):
    """The answer to a question about a solver."""

    YES = "yes"
    NO = "no"


class One(StrEnum):
    """What ``nfbench show`` can show."""

    SOLVER = "solver"
    FORMULATION = "formulation"
    SCENARIO = "scenario"


class Width(StrEnum):
    """What a figure fills."""

    SINGLE = "single"
    DOUBLE = "double"


class Metric(StrEnum):
    """Which error a figure shows."""

    RMSE = "rmse"
    MEDIAN = "median"


class Target(StrEnum):
    """What ``nfbench export`` can write."""

    IOH = "ioh"
    CSV = "csv"


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Which optimizer, on which formulation, localizes near-field sources best for what you can spend?"""
    if version:
        typer.echo(f"nfbench {__version__}")
        raise typer.Exit


def main() -> None:
    """The entry point: every error of ours is a message and an exit code, never a traceback."""
    try:
        app(standalone_mode=True)
    except NfbenchError as error:
        Console(stderr=True).print(f"nfbench: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(USAGE)
    except BrokenPipeError:
        sys.exit(OK)


def _console() -> Console:
    """Standard output: as wide as the terminal, or wide enough for our tables in a file or pipe."""
    console = Console(highlight=False)
    return console if console.is_terminal or "COLUMNS" in os.environ else Console(highlight=False, width=110)


def _warn(text: str) -> None:
    Console(stderr=True).print(f"nfbench: {text}", style="yellow", highlight=False, markup=False, soft_wrap=True)


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
    from .manifest import load_study
    from .progress import Lines, LiveView, Quiet
    from .report import print_report
    from .results import Results
    from .results import run as run_study

    part = _shard(shard)
    where = _where(cluster, scheduler, jobs)
    loaded = load_study(study, plugin or ())
    console = _console()
    for warning in loaded.warnings:
        _warn(warning)
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
        for status_, method, count, message in _failures(folder):
            typer.echo(f"nfbench: {status_} × {count}: {method}: {message}", err=True)
    else:
        print_report(results, console)
        names = ("runs.csv", "summary.csv", "environment.json", "runs.sqlite")
        console.print(f"\nWritten to {folder}/: {', '.join(names)}", soft_wrap=True)
    raise typer.Exit(OK if set(results.counts) <= {Status.OK} else NOT_ALL_OK)


def _failures(folder: Path) -> list[tuple[str, str, int, str]]:
    from .store import Store

    with Store(folder) as store:
        return store.failures()


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
    from .store import Store

    with Store(folder) as store:
        counts, rate = store.counts(), store.rate()
    total, left = sum(counts.values()), counts.get("open", 0)
    typer.echo(f"{total - left} of {total} runs done")
    if left and rate:
        typer.echo(f"{rate:.3g} runs/s lately; at that rate {left / rate:.0f} s left")
    for name in [*Status, "open"]:
        if name in counts:
            typer.echo(f"{name:>8} {counts[name]}")
    for status_, method, count, message in _failures(folder):
        typer.echo(f"{status_} × {count}: {method}: {message}")


@app.command()
def tune(
    solver: Annotated[str, typer.Argument(metavar="SOLVER", help="A registered solver, e.g. de.")],
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="The manifest whose scenes it is tuned for.")],
    budget: Annotated[int | None, typer.Option(min=1, help="Evaluations a problem (default: the study's).")] = None,
    trials: Annotated[int, typer.Option(min=1, help="Settings to try.")] = 50,
    training: Annotated[int, typer.Option(min=1, help="Scenes to tune on, at each point of the study.")] = 10,
    held_out: Annotated[int, typer.Option(min=1, help="Other scenes to compare on, at each point.")] = 30,
    formulation: Annotated[str | None, typer.Option(metavar="LABEL", help="Which one (default: the first).")] = None,
    option: GivenOptions = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the tuner; scenes have the study's.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Default: results/<study>-tune-<solver>.")] = None,
    jobs: Annotated[int | None, typer.Option(min=0, help="Worker processes (default: one a core; 0: none).")] = None,
    plugin: Plugins = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Move an old folder aside and start anew.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the result, no trials.")] = False,
) -> None:
    """Tune a solver's options on training scenes of a study, or go on with it, and compare on held-out ones."""
    from .manifest import load_study
    from .report import TuningView
    from .tuning import Plan
    from .tuning import tune as tune_solver

    loaded = load_study(study, plugin or ())
    for warning in loaded.warnings:
        _warn(warning)
    given = dict(_option(text) for text in option or ())
    plan = Plan(solver, given, formulation, budget, trials, training, held_out, seed)
    folder = out or Path("results") / f"{loaded.name}-tune-{solver}"
    console = _console()
    view = TuningView(console, quiet)
    try:
        found = tune_solver(loaded, plan, folder, os.cpu_count() or 1 if jobs is None else jobs, view.trial, fresh)
    except KeyboardInterrupt:  # before any new trial
        console.print("Interrupted with nothing new; the same command goes on from here.")
        raise typer.Exit(INTERRUPTED) from None
    view.result(found, folder)
    raise typer.Exit(INTERRUPTED if found.interrupted else OK)


@app.command()
def merge(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of one study, e.g. its shards.")],
    out: Annotated[Path, typer.Option(help="The folder to join them in.")],
) -> None:
    """Join the folders of one study, such as its shards, in one; refuses what contradicts."""
    from .merge import merge as merge_folders

    counts = merge_folders(folders, out).counts
    total = sum(counts.values())
    typer.echo(f"{out}: {total - counts.get('open', 0)} of {total} runs, from {len(folders)} folders")


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="DIR")], second: Annotated[Path, typer.Argument(metavar="DIR")]
) -> None:
    """Say which runs of two folders of one study differ, by how much, and whether it matters."""
    from .merge import compare as compare_folders
    from .report import print_comparison

    found = compare_folders(first, second)
    print_comparison(found, _console())
    raise typer.Exit(NOT_ALL_OK if found.matters else OK)


@app.command()
def report(folder: Folder) -> None:
    """Show again what a study found."""
    from .report import print_report
    from .results import Results

    print_report(Results(folder), _console())


@app.command()
def figure(
    folder: Folder,
    out: Annotated[Path | None, typer.Option(help="Where the figures go (default: DIR).")] = None,
    formats: Annotated[str, typer.Option("--format", help="svg, pdf, png, or several with commas.")] = "svg,pdf",
    width: Annotated[Width, typer.Option(help="Of an IEEE column (3.5 in) or page (7.16 in).")] = Width.SINGLE,
    metric: Annotated[Metric | None, typer.Option(help="Show one alone (default: both, and outliers).")] = None,
    title: Annotated[bool, typer.Option(help="The study's title above each figure.")] = True,
    positions: Annotated[
        bool | None, typer.Option(help="True and estimated positions (default: where the study is small).")
    ] = None,
    traces: Annotated[bool, typer.Option("--traces", help="Objective against evaluations.")] = False,
    manifest: Annotated[
        Path | None, typer.Option(help="Where positions' scenario is read (default: DIR/manifest.toml).")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Draw a study's figures: error over the sweep, run time against error, positions, convergence."""
    from .figures import FORMATS, Drawing, write_figures
    from .results import Results

    kinds = list(dict.fromkeys(kind.strip() for kind in formats.split(",")))
    unknown = [kind for kind in kinds if kind not in FORMATS]
    if unknown:
        raise typer.BadParameter(f"expected {', '.join(FORMATS)}, got {unknown[0]!r}", param_hint="--format")
    how = Drawing(
        width.value, metric.value if metric else None, title, positions, traces, manifest, tuple(plugin or ())
    )
    for path in write_figures(Results(folder), out or folder, kinds, how, _warn):
        typer.echo(path)


@app.command()
def export(
    folder: Folder,
    to: Annotated[Target, typer.Option(help="IOHprofiler's data format, or a table.")],
    out: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Where to (default: export-ioh/ or traces.csv in DIR).")
    ] = None,
) -> None:
    """Write the traces of a study's runs, objective against evaluations, for other tools."""
    from .export import export_csv, export_ioh
    from .results import Results

    write = {Target.IOH: export_ioh, Target.CSV: export_csv}[to]
    typer.echo(write(Results(folder), out))


@app.command("list")
def list_plugins(
    kind: Annotated[Kind | None, typer.Argument(metavar="[solvers|formulations|scenarios]")] = None,
    plugin: Plugins = None,
    group: Annotated[str | None, typer.Option(help="Only solvers of this group, e.g. global, derivative-free.")] = None,
    needs_gradient: Annotated[YesNo | None, typer.Option(help="Only solvers that need a gradient, or do not.")] = None,
    batched: Annotated[YesNo | None, typer.Option(help="Only solvers that evaluate in batches, or do not.")] = None,
    stochastic: Annotated[YesNo | None, typer.Option(help="Only solvers that are random, or are not.")] = None,
    every: Annotated[bool, typer.Option("--all/--installed", help="Also what needs an extra that is missing.")] = False,
) -> None:
    """List what is registered, and what failed to import."""
    from .catalogue import Filter, print_catalogue
    from .registry import Registry

    asked = {"needs_gradient": needs_gradient, "batched": batched, "stochastic": stochastic}
    filtered = group is not None or any(value is not None for value in asked.values())
    if filtered and kind not in (None, Kind.SOLVERS):
        raise typer.BadParameter(f"expected solvers, as only they are told apart so, got {kind}", param_hint="KIND")
    chosen = Filter(
        group=group,
        uninstalled=every,
        **{name: None if value is None else value is YesNo.YES for name, value in asked.items()},
    )
    kinds = [kind] if kind else [Kind.SOLVERS] if filtered else list(Kind)
    print_catalogue(Registry(plugin or ()), [k.removesuffix("s") for k in kinds], _console(), chosen)


@app.command()
def show(
    kind: Annotated[One, typer.Argument(metavar="KIND")],
    name: Annotated[str, typer.Argument(metavar="NAME")],
    plugin: Plugins = None,
) -> None:
    """Show one solver, formulation or scenario: what it is, and every option with its default."""
    from .catalogue import print_plugin
    from .registry import Registry

    print_plugin(Registry(plugin or ()), kind, name, _console())


@check_app.command("solver")
def check_solver(
    solver: Annotated[str, typer.Argument(metavar="NAME|FILE", help="A registered name, or a plugin file.")],
    plugin: Plugins = None,
    option: GivenOptions = None,
    timeout: Timeout = 120.0,
) -> None:
    """Check that a solver keeps its contract: bounds, budget, seeds, robustness, accuracy."""
    if solver.endswith(".toml"):
        raise typer.BadParameter(f"expected a solver's name or a plugin file, got {solver}", param_hint="NAME|FILE")
    _check("solver", solver, plugin, option, timeout)


@check_app.command("problem")
def check_problem(
    scenario: Annotated[
        str, typer.Argument(metavar="NAME|FILE", help="A registered scenario, a plugin file, or a manifest.")
    ],
    plugin: Plugins = None,
    option: GivenOptions = None,
    timeout: Timeout = 120.0,
) -> None:
    """Check that a scenario and the problems made of it keep their contracts: seeds, scores, boxes, gradients."""
    _check("scenario", scenario, plugin, option, timeout)


def _check(kind: str, name: str, plugin: list[Path] | None, given: list[str] | None, timeout: float) -> None:
    from .errors import OptionError
    from .testing.watch import jobs, watched_checks

    options = dict(_option(text) for text in given or ())
    try:
        wanted = list(jobs(kind, name, plugin or (), options))
    except OptionError as error:
        hint = "; give it by --option NAME=VALUE" if "is required" in str(error) else ""
        raise NfbenchError(f"{error}{hint}") from error
    passed = True
    for job in wanted:
        typer.echo(job.name)
        first: dict[str, str] = {}  # where a message was told
        for result in watched_checks(job, timeout):
            passed &= result.passed
            where = first.setdefault(result.message, result.name)
            told = result.message if where == result.name or result.passed else f"the same as in {where}"
            told = f"{': ' if told else ''}{told}"
            typer.echo(f"  {'ok  ' if result.passed else 'FAIL'} {result.name}{told}")
    raise typer.Exit(OK if passed else NOT_ALL_OK)


def _option(text: str) -> tuple[str, Any]:
    """``population=50``, the value as a manifest has it; what is no TOML is text."""
    name, sign, value = text.partition("=")
    if not sign or not name:
        raise typer.BadParameter(f"expected NAME=VALUE, e.g. population=50, got {text!r}", param_hint="--option")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value


@new_app.command("solver")
def new_solver(name: NewName, out: Out = None) -> None:
    """Write a small solver that works, with its test, to make your own of."""
    _new("solver", name, out)


@new_app.command("problem")
def new_problem(name: NewName, out: Out = None) -> None:
    """Write a small scenario that works, with its problem and its test, to make your own of."""
    _new("problem", name, out)


def _new(kind: str, name: str, out: Path | None) -> None:
    from .scaffold import write

    file, test = write(kind, name, out)
    typer.echo(f"Wrote {file} and {test}. Next:\n  nfbench check {kind} {file}\n  pytest {test}")
