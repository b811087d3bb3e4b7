"""The command line: ``nfbench run STUDY.toml`` and its companions."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from .budget import Status
from .errors import NfbenchError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Which optimizer, on which formulation, localizes near-field sources best for what you can spend?",
)
check_app = typer.Typer(no_args_is_help=True, help="Run the conformance checks on a plugin.")
app.add_typer(check_app, name="check")

OK, NOT_ALL_OK, USAGE, INTERRUPTED = 0, 1, 2, 130

Plugins = Annotated[list[Path] | None, typer.Option("--plugin", help="A plugin file; may be given more than once.")]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="A results folder, e.g. results/quickstart.")]


class Kind(StrEnum):
    """What ``nfbench list`` can list, in the plural as one says it."""

    SOLVERS = "solvers"
    FORMULATIONS = "formulations"
    SCENARIOS = "scenarios"


class One(StrEnum):
    """What ``nfbench show`` can show."""

    SOLVER = "solver"
    FORMULATION = "formulation"
    SCENARIO = "scenario"


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


@app.command()
def run(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="The manifest of the study.")],
    out: Annotated[Path | None, typer.Option(help="The results folder (default: results/<name>).")] = None,
    jobs: Annotated[int | None, typer.Option(min=0, help="Worker processes (default: one a core; 0: none).")] = None,
    plugin: Plugins = None,
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

    loaded = load_study(study, plugin or ())
    console = _console()
    for warning in loaded.warnings:
        Console(stderr=True).print(f"nfbench: {warning}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    folder = out or Path("results") / loaded.name
    progress = Quiet() if quiet else (LiveView if console.is_terminal else Lines)(console, loaded.error)
    try:
        with progress:
            results = run_study(loaded, out=folder, jobs=jobs, fresh=fresh, retry=retry or (), listener=progress)
    except KeyboardInterrupt:
        counts = Results(folder).counts
        left = counts.get("open", 0)
        console.print(f"Interrupted with {left} runs to do; the same command goes on from here.")
        raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        print_report(results, console)
        names = ("runs.csv", "summary.csv", "environment.json", "runs.sqlite")
        console.print(f"\nWritten to {folder}/: {', '.join(names)}", soft_wrap=True)
    raise typer.Exit(OK if set(results.counts) <= {Status.OK} else NOT_ALL_OK)


@app.command()
def status(folder: Folder) -> None:
    """How far a study is: runs by status."""
    from .results import Results

    counts = Results(folder).counts
    total = sum(counts.values())
    typer.echo(f"{total - counts.get('open', 0)} of {total} runs done")
    for name in [*Status, "open"]:
        if name in counts:
            typer.echo(f"{name:>8} {counts[name]}")


@app.command()
def report(folder: Folder) -> None:
    """Show again what a study found."""
    from .report import print_report
    from .results import Results

    print_report(Results(folder), _console())


@app.command("list")
def list_plugins(
    kind: Annotated[Kind | None, typer.Argument(metavar="[solvers|formulations|scenarios]")] = None,
    plugin: Plugins = None,
) -> None:
    """List what is registered, and what failed to import."""
    from .catalogue import print_catalogue
    from .registry import Registry

    kinds = [kind] if kind else list(Kind)
    print_catalogue(Registry(plugin or ()), [k.removesuffix("s") for k in kinds], _console())


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
) -> None:
    """Check that a solver keeps its contract: bounds, budget, seeds, robustness, accuracy."""
    from .catalogue import solvers_named
    from .testing import solver_checks

    passed = True
    for name, made in solvers_named(solver, plugin or ()):
        typer.echo(f"{name}")
        for result in solver_checks(made):
            passed &= result.passed
            typer.echo(
                f"  {'ok  ' if result.passed else 'FAIL'} {result.name}{': ' if result.message else ''}{result.message}"
            )
    raise typer.Exit(OK if passed else NOT_ALL_OK)
