"""Prints the progress and the result of a tuning."""

from __future__ import annotations

import math
from pathlib import Path
from typing import final

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from nfbench.report import number_text, shown, summary_table
from nfbench.tuning import Trial, Tuning

__all__ = ["TuningView"]


@final
class TuningView:
    """Prints a tuning: each trial that is the best so far, unless ``quiet``, and the result."""

    def __init__(self, console: Console, quiet: bool = False) -> None:
        self.console, self.quiet = console, quiet
        self.best = math.inf

    def trial(self, trial: Trial) -> None:
        """Print a trial if it is the best so far."""
        if trial.score < self.best and not self.quiet:
            self.best = trial.score
            options = ", ".join(f"{name} = {value}" for name, value in trial.options.items())
            text = f"trial {trial.number}: {number_text(10**trial.score)} with {options}"
            self.console.print(shown(text), soft_wrap=True)

    def result(self, found: Tuning, folder: Path) -> None:
        """Print the best setting next to the default, with their errors on training and held-out scenes."""
        first, best, plan = found.trials[0], found.best, found.plan
        unit = " m" if found.error.endswith("_m") else ""
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        for head in ("option", "default", "tuned"):
            table.add_column(head, overflow="fold")
        for name, value in first.options.items():
            table.add_row(*(shown(cell) for cell in (name, value, best.options[name])))
        self.console.print(table)
        failed = sum(math.isnan(trial.score) for trial in found.trials)
        scenes, failures = plan.training * len(found.study.points), ""
        if failed:
            failures = f" Failed trials: {failed}; see trials.csv for the reasons."
        text = (
            f"Geometric mean of {found.error} on {scenes} training scenes, {found.method.formulation.label}: "
            f"{number_text(10**best.score)}{unit} with the best setting, {number_text(10**first.score)}{unit} with the "
            f"default. The former is optimistic, because it is the best of {len(found.trials)} trials.{failures}"
        )
        self.console.print(shown(text))
        if found.held_out is not None:
            self.console.print(
                summary_table("Held-out scenes", found.held_out, found.error, found.study.outlier_m, self.console)
            )
        self.console.print(shown(found.verdict))
        if found.interrupted:
            done = f"{len(found.trials)} of {plan.trials + 1} trials"
            self.console.print(f"Interrupted after {done}. Run the same command to resume.")
        self.console.print()
        self.console.print(shown(f"Written to {folder}/: tuned.toml, trials.csv, tuning.json"), soft_wrap=True)
