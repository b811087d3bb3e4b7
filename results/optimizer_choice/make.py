"""Runs the study and writes its table: ``python results/optimizer_choice/make.py``; resumes where it was left."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "paper"))
import make as paper  # noqa: E402
from ledger import OUTLIER, ratio, rms  # noqa: E402

STUDY = HERE.parents[1] / "studies" / "optimizer_choice.toml"
BEGIN, END = "<!-- table: written by make.py -->", "<!-- end of table -->"
PAPER = {"neef": "neef + de, paper", "nemo": "nemo + de(population=50)"}


def table() -> str:
    """For each formulation and budget, every solver: how far from the bound it ends, and against the paper's DE."""
    errors, summary = pd.read_csv(HERE / "errors.csv"), pd.read_csv(HERE / "summary.csv").set_index("method")
    bound = errors["crb_m"].to_numpy()
    lines = []
    for formulation, budget in (("neef", 60000), ("neef", 12000), ("nemo", 15000), ("nemo", 3000)):
        names = [name for name in summary.index if _budget(name, summary) == budget and name.startswith(formulation)]
        base = next(name for name in names if name.startswith(PAPER[formulation]))
        each = "" if formulation == "neef" else " for each source"
        lines += [
            "",
            f"### {formulation.upper()}, {budget:,} evaluations{each}",
            "",
            f"| solver | RMSE ÷ bound | off by > {OUTLIER:g} bounds | RMSE ÷ that of the paper's DE "
            "| evaluations | seconds ÷ DE's |",
            "|---|---|---|---|---|---|",
        ]
        rows = []
        for name in names:
            E, theirs = errors[name].to_numpy(), errors[base].to_numpy()
            both = np.isfinite(E)
            value = float(rms(E[both]) / rms(bound[both]))
            far = float(np.mean(E[both] > OUTLIER * bound[both]))
            against, low, high = ratio(E, theirs, rms)
            told = " **better**" if high < 0.99 else " worse" if low > 1.01 else ""
            shown = f"{against:.2g} ({low:.2g} – {high:.2g}){told}" if name != base else "the paper's"
            seconds = summary.runtime_s[name] / summary.runtime_s[base]
            solver = re.sub(r" @\d+", "", name.partition(" + ")[2])
            failed = f", {summary.failed[name]} failed" if summary.failed[name] else ""
            rows.append(
                (
                    far,
                    value,
                    f"| {solver}{failed} | {value:.3g} | {far:.0%} | {shown} "
                    f"| {summary.evaluations[name]:,.0f} | {seconds:.2g} |",
                )
            )
        lines += [row for _, _, row in sorted(rows)]
    return "\n".join(lines)


def _budget(name: str, summary: pd.DataFrame) -> int:
    """The budget of a method, from its label or, the first of its name, from what it spent at most."""
    if marked := re.search(r"@(\d+)", name):
        return int(marked[1])
    return {"neef": 60000, "nemo": 15000}.get(name.split(" ")[0], 0)


def main() -> None:
    paper.nfbench_command("run", STUDY, "--out", HERE, "--jobs", "2")
    paper.write_errors(HERE)
    page = HERE / "README.md"
    text = page.read_text(encoding="utf-8")
    page.write_text(re.sub(f"{BEGIN}.*{END}", f"{BEGIN}\n{table()}\n\n{END}", text, flags=re.DOTALL), encoding="utf-8")


if __name__ == "__main__":
    main()
