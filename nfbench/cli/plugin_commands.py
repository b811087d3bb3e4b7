"""The commands about plugins: ``list``, ``show``, ``check`` and ``new``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from nfbench.core import NfbenchError

from .common import NOT_ALL_OK, OK, GivenOptions, Plugins, app, output, parsed_option

check_app = typer.Typer(no_args_is_help=True, help="Run the conformance checks on a plugin.")
app.add_typer(check_app, name="check")
new_app = typer.Typer(no_args_is_help=True, help="Write a plugin file that works, as a starting point for your own.")
app.add_typer(new_app, name="new")

Timeout = Annotated[float, typer.Option(min=0.1, help="What one check may take at most [s].")]
NewName = Annotated[str, typer.Argument(metavar="NAME", help="Its name in manifests, e.g. my-solver.")]
Out = Annotated[Path | None, typer.Option(metavar="FILE", help="Where to write it (default: its name with .py).")]


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
    from nfbench.plugins import Registry

    from .catalogue import Filter, print_catalogue

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
    print_catalogue(Registry(plugin or ()), [k.removesuffix("s") for k in kinds], output(), chosen)


@app.command()
def show(
    kind: Annotated[One, typer.Argument(metavar="KIND")],
    name: Annotated[str, typer.Argument(metavar="NAME")],
    plugin: Plugins = None,
) -> None:
    """Show one solver, formulation or scenario: what it is, and every option with its default."""
    from nfbench.plugins import Registry

    from .catalogue import print_plugin

    print_plugin(Registry(plugin or ()), kind, name, output())


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
    from nfbench.core import OptionError
    from nfbench.testing import check_jobs, watched_checks

    options = dict(parsed_option(text) for text in given or ())
    try:
        wanted = list(check_jobs(kind, name, plugin or (), options))
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


@new_app.command("solver")
def new_solver(name: NewName, out: Out = None) -> None:
    """Write a small solver that works, with its test, to make your own of."""
    _new("solver", name, out)


@new_app.command("problem")
def new_problem(name: NewName, out: Out = None) -> None:
    """Write a small scenario that works, with its problem and its test, to make your own of."""
    _new("problem", name, out)


def _new(kind: str, name: str, out: Path | None) -> None:
    from nfbench.plugins import write_template

    file, test = write_template(kind, name, out)
    typer.echo(f"Wrote {file} and {test}. Next:\n  nfbench check {kind} {file}\n  pytest {test}")
