"""The command that tunes a solver's options: ``tune``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .common import INTERRUPTED, OK, Jobs, Plugins, app, output, parsed_option, warn


@app.command()
def tune(
    solver: Annotated[str, typer.Argument(metavar="SOLVER", help="Registered solver, e.g. de.")],
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Manifest of the study whose scenes are used.")],
    budget: Annotated[
        int | None, typer.Option(min=1, help="Evaluations per problem (default: the study's budget).")
    ] = None,
    trials: Annotated[int, typer.Option(min=1, help="Number of settings to try, besides the default.")] = 50,
    training: Annotated[int, typer.Option(min=1, help="Number of training scenes at each scenario point.")] = 10,
    held_out: Annotated[
        int, typer.Option(min=1, help="Number of held-out scenes, for the comparison, at each scenario point.")
    ] = 30,
    formulation: Annotated[
        str | None,
        typer.Option(metavar="LABEL", help="Formulation to tune for (default: the first that needs a solver)."),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option", metavar="NAME=VALUE", help="Option to fix instead of tuning it, e.g. F=0.5; can be repeated."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the tuner's sampler; the scenes use the study's seed.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the tuning (default: results/<study>-tune-<solver>).")
    ] = None,
    jobs: Jobs = None,
    plugin: Plugins = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Move an old folder aside and start over.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print the result but not the trials.")] = False,
) -> None:
    """Tune a solver's options on training scenes, or resume, and compare with the default on held-out scenes."""
    from nfbench.study import load_study
    from nfbench.tuning import Plan
    from nfbench.tuning import tune as tune_solver

    from .tuning_view import TuningView

    loaded = load_study(study, plugin or ())
    for warning in loaded.warnings:
        warn(warning)
    given = dict(parsed_option(text) for text in option or ())
    plan = Plan(solver, given, formulation, budget, trials, training, held_out, seed)
    folder = out or Path("results") / f"{loaded.name}-tune-{solver}"
    console = output()
    view = TuningView(console, quiet)
    try:
        found = tune_solver(loaded, plan, folder, os.cpu_count() or 1 if jobs is None else jobs, view.trial, fresh)
    except KeyboardInterrupt:  # before any new trial
        console.print("Interrupted before any new trial was finished. Run the same command to resume.")
        raise typer.Exit(INTERRUPTED) from None
    view.result(found, folder)
    raise typer.Exit(INTERRUPTED if found.interrupted else OK)
