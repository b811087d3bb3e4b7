"""Shows a tuning on the terminal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import final

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from nfbench.report import number_text, summary_table
from nfbench.tuning import Trial, Tuning

__all__ = ["TuningView"]


@final
class TuningView:
    """Shows a tuning: unless ``quiet`` each trial that is the best so far, and what came of it."""

    def __init__(self, console: Console, quiet: bool = False) -> None:
        self.console, self.quiet = console, quiet
        self.best = math.inf

    def trial(self, trial: Trial) -> None:
        """A trial has ended."""
        if trial.score < self.best and not self.quiet:
            self.best = trial.score
            options = ", ".join(f"{name} = {value}" for name, value in trial.options.items())
            text = f"trial {trial.number}: {number_text(10**trial.score)} with {options}"
            self.console.print(text, markup=False, soft_wrap=True)

    def result(self, found: Tuning, folder: Path) -> None:
        """The best setting beside the default, on training and on held-out scenes."""
        first, best, plan = found.trials[0], found.best, found.plan
        unit = " m" if found.error.endswith("_m") else ""
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        for head in ("option", "default", "tuned"):
            table.add_column(head, overflow="fold")
        for name, value in first.options.items():
            table.add_row(*(escape(str(cell)) for cell in (name, value, best.options[name])))
        self.console.print(table)
        failed = sum(math.isnan(trial.score) for trial in found.trials)
        self.console.print(
            f"On {plan.training * len(found.study.points)} training scenes, for {found.method.formulation.label}: "
            f"{number_text(10**best.score)}{unit}, with the default {number_text(10**first.score)}{unit} "
            f"(geometric mean of {found.error}; that of the best of {len(found.trials)} flatters it)."
            + (f" {failed} settings failed; trials.csv says why." if failed else ""),
            markup=False,
        )
        if found.held_out is not None:
            self.console.print(
                summary_table("held out", found.held_out, found.error, found.study.outlier_m, self.console)
            )
        self.console.print(found.verdict, markup=False)
        if found.interrupted:
            done = f"{len(found.trials)} of {plan.trials + 1} trials"
            self.console.print(f"Interrupted after {done}; the same command goes on from here.")
        self.console.print(f"\nWritten to {folder}/: tuned.toml, trials.csv, tuning.json", soft_wrap=True)
