"""The commands for plugins: ``list``, ``show``, ``check`` and ``new``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from nfbench.core import NfbenchError

from .common import NOT_ALL_OK, OK, GivenOptions, Plugins, app, output, parsed_option, say

check_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Run the conformance checks on a plugin.")
app.add_typer(check_app, name="check")
new_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Write a working plugin file as a starting point for your own."
)
app.add_typer(new_app, name="new")

Timeout = Annotated[float, typer.Option(min=0.1, help="Time limit for each check, in seconds.")]
NewName = Annotated[str, typer.Argument(metavar="NAME", help="Name of the plugin in manifests, e.g. my-solver.")]
Out = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Python file to write (default: named after the plugin, in this folder)."),
]


class Kind(StrEnum):
    """The kinds of plugins that ``nfbench list`` accepts."""

    SOLVERS = "solvers"
    FORMULATIONS = "formulations"
    SCENARIOS = "scenarios"


class YesNo(StrEnum):
    """The values of a filter on solvers."""

    YES = "yes"
    NO = "no"


class One(StrEnum):
    """What ``nfbench show`` accepts: the kinds of plugins, and arrays."""

    SOLVER = "solver"
    FORMULATION = "formulation"
    SCENARIO = "scenario"
    ARRAY = "array"


@app.command("list")
def list_plugins(
    kind: Annotated[
        Kind | None, typer.Argument(metavar="[solvers|formulations|scenarios]", help="What to list (default: all).")
    ] = None,
    plugin: Plugins = None,
    group: Annotated[
        str | None, typer.Option(help="List only solvers of this group, e.g. global or derivative-free.")
    ] = None,
    needs_gradient: Annotated[
        YesNo | None, typer.Option(help="List only solvers that need a gradient (yes) or need none (no).")
    ] = None,
    batched: Annotated[
        YesNo | None, typer.Option(help="List only solvers that evaluate points in batches (yes) or one by one (no).")
    ] = None,
    stochastic: Annotated[
        YesNo | None, typer.Option(help="List only stochastic (yes) or deterministic (no) solvers.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all/--installed", help="Also list plugins whose optional dependency is not installed.")
    ] = False,
) -> None:
    """List the registered solvers, formulations and scenarios, and plugins that failed to import."""
    from nfbench.plugins import Registry

    from .catalogue import Filter, print_catalogue

    criteria = {"needs_gradient": needs_gradient, "batched": batched, "stochastic": stochastic}
    filtered = group is not None or any(value is not None for value in criteria.values())
    if filtered and kind not in (None, Kind.SOLVERS):
        raise typer.BadParameter(
            f"expected solvers, because these filters apply only to solvers, got {kind}", param_hint="KIND"
        )
    chosen = Filter(
        group=group,
        uninstalled=every,
        **{name: None if value is None else value is YesNo.YES for name, value in criteria.items()},
    )
    kinds = [kind] if kind else [Kind.SOLVERS] if filtered else list(Kind)
    print_catalogue(Registry(plugin or ()), [k.removesuffix("s") for k in kinds], output(), chosen)


@app.command()
def show(
    kind: Annotated[One, typer.Argument(metavar="KIND", help="solver, formulation, scenario or array.")],
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="A registered name, e.g. de. Of an array: a file with positions, a kind, or a manifest.",
        ),
    ],
    plugin: Plugins = None,
    frequency_hz: Annotated[float | None, typer.Option(help="Array: frequency of the waves [Hz].")] = None,
    speed: Annotated[float | None, typer.Option(help="Array: speed of the waves [m/s], e.g. 299792458 or 343.")] = None,
    wavelength_m: Annotated[float | None, typer.Option(help="Array: wavelength [m], in place of a frequency.")] = None,
    unit: Annotated[str | None, typer.Option(help="Array: unit of the positions in a file, e.g. mm.")] = None,
    variable: Annotated[str | None, typer.Option(help="Array: name of the positions in a .mat or .npz file.")] = None,
    broadside: Annotated[str | None, typer.Option(help="Array: direction in front, e.g. +z or [0,1,1].")] = None,
    up: Annotated[str | None, typer.Option(help="Array: direction upwards, e.g. +y.")] = None,
    option: GivenOptions = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Array: .svg, .png or .pdf file to draw.")] = None,
) -> None:
    """Show one solver, formulation or scenario with all its options, or describe and draw an array."""
    from .array_command import ArrayOptions, show_array

    given = ArrayOptions(frequency_hz, speed, wavelength_m, unit, variable, broadside, up, option, out)
    if kind is One.ARRAY:
        show_array(name, given, plugin or ())
        return
    if not given.is_empty:
        raise typer.BadParameter(f"these options describe an array, but got KIND {kind}", param_hint="KIND")
    from nfbench.plugins import Registry

    from .catalogue import print_plugin

    print_plugin(Registry(plugin or ()), kind, name, output())


@check_app.command("solver")
def check_solver(
    solver: Annotated[str, typer.Argument(metavar="NAME|FILE", help="A registered name or a plugin file.")],
    plugin: Plugins = None,
    option: GivenOptions = None,
    timeout: Timeout = 120.0,
) -> None:
    """Check that a solver meets its contract: bounds, budget, seeds, robustness, accuracy."""
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
    """Check that a scenario and its problems meet their contracts: seeds, scores, bounds, gradients."""
    _check("scenario", scenario, plugin, option, timeout)


def _check(kind: str, name: str, plugin: list[Path] | None, given: list[str] | None, timeout: float) -> None:
    from nfbench.core import OptionError
    from nfbench.testing import check_jobs, watched_checks

    options = dict(parsed_option(text) for text in given or ())
    try:
        jobs = list(check_jobs(kind, name, plugin or (), options))
    except OptionError as error:
        hint = "; set it with --option NAME=VALUE" if "is required" in str(error) else ""
        raise NfbenchError("\n".join(error.lines()) + hint) from error
    passed = True
    for job in jobs:
        say(job.name)
        first: dict[str, str] = {}  # the first check with each message
        for result in watched_checks(job, timeout):
            passed &= result.passed
            where = first.setdefault(result.message, result.name)
            text = result.message if where == result.name or result.passed else f"the same as in {where}"
            text = f"{': ' if text else ''}{text}"
            say(f"  {'ok  ' if result.passed else 'FAIL'} {result.name}{text}")
    raise typer.Exit(OK if passed else NOT_ALL_OK)


@new_app.command("solver")
def new_solver(name: NewName, out: Out = None) -> None:
    """Write a small working solver and its test, as a starting point for your own."""
    _new("solver", name, out)


@new_app.command("problem")
def new_problem(name: NewName, out: Out = None) -> None:
    """Write a small working scenario, its problem and its test, as a starting point for your own."""
    _new("problem", name, out)


def _new(kind: str, name: str, out: Path | None) -> None:
    from nfbench.plugins import write_template

    file, test = write_template(kind, name, out)
    typer.echo(f"Wrote {file} and {test}. Next:\n  nfbench check {kind} {file}\n  pytest {test}")
