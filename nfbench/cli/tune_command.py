"""The command that tunes a solver's options: ``tune``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .common import INTERRUPTED, OK, GivenOptions, Plugins, app, output, parsed_option, warn


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
        console.print("Interrupted with nothing new; the same command goes on from here.")
        raise typer.Exit(INTERRUPTED) from None
    view.result(found, folder)
    raise typer.Exit(INTERRUPTED if found.interrupted else OK)
