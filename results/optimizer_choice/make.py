"""Runs the study and writes its tables: ``python results/optimizer_choice/make.py``; resumes where it was left."""

from __future__ import annotations

import itertools
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

import nfbench
from nfbench.problems.geometry import cartesian
from nfbench.registry import Registry

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "paper"))
import make as paper  # noqa: E402
from ledger import OUTLIER, RESAMPLES, ratio, rms  # noqa: E402

STUDY = HERE.parents[1] / "studies" / "optimizer_choice.toml"
BEGIN, END = "<!-- table: written by make.py -->", "<!-- end of table -->"
PAPER = {"neef": "neef + de, paper @{}", "nemo": "nemo + de(population=50){}"}  # the paper's DE
SHOWN = 12  # solvers of a table in README.md; all.md has every one


@dataclass(frozen=True)
class Part:
    """The methods of one formulation and budget, and among them the paper's DE."""

    formulation: str
    budget: int
    names: tuple[str, ...]
    base: str

    @property
    def title(self) -> str:
        each = " for each source" if self.formulation == "nemo" else ""
        return f"{self.formulation.upper()}, {self.budget:,} evaluations{each}"


def parts() -> list[Part]:
    """What the study compares, from its manifest."""
    methods = nfbench.load_study(STUDY).methods
    found = []
    for kind, budget in (("neef", 60000), ("neef", 12000), ("nemo", 15000), ("nemo", 3000)):
        names = tuple(
            method.label
            for method in methods
            if method.formulation.kind == kind
            and method.budget
            and budget / 4 <= method.budget["evaluations"] <= budget
        )
        base = PAPER[kind].format(budget if kind == "neef" else "" if budget == 15000 else f" @{budget}")
        found.append(Part(kind, budget, names, base))
    return found


# --- evaluations to the bound --------------------------------------------------------------------------------------


def write_reached(folder: Path) -> None:
    """``reached.csv``: for each run of NEEF at its full budget, when it came near the bound for good.

    Near is an error of at most OUTLIER times the scene's bound. evaluations, seconds: to get there, or all that the run
    made where it did not.
    """
    part = parts()[0]
    results = nfbench.Results(folder)
    runs = results.runs.set_index("run_id")
    runs = runs[runs.method.isin(part.names) & (runs.status == "ok")]
    truth = _truth(runs)
    rows = []
    for run_id, trace in results.traces.groupby("run_id", sort=False):
        if run_id not in runs.index:
            continue
        run = runs.loc[run_id]
        theta = truth[run.instance_seed]
        x = trace[[f"x_{j}" for j in range(theta.size)]].to_numpy()
        far = errors(x.reshape(-1, *theta.shape), theta) > OUTLIER * run.crb_m
        near = not far[-1]
        first = len(far) - int(far[::-1].argmax()) if near and far.any() else 0 if near else len(far) - 1
        row = trace.iloc[first]
        rows.append((run.method, run.repetition, near, int(row.evaluations), row.seconds))
    table = pd.DataFrame(rows, columns=["method", "repetition", "near", "evaluations", "seconds"])
    table.sort_values(["method", "repetition"]).to_csv(folder / "reached.csv", index=False, float_format="%.3g")


def _truth(runs: pd.DataFrame) -> dict[int, np.ndarray]:
    """The true sources (K, d) of each scene, by its seed."""
    choice = nfbench.load_study(STUDY).points[0].scenario
    scenario = Registry().make("scenario", choice.kind, choice.options)
    return {seed: scenario.draw(np.random.default_rng(seed)).theta for seed in runs.instance_seed.unique()}


def errors(estimates: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Root mean square errors [m] of estimates (p, K, d) after the best assignment to the sources (K, d)."""
    true, found = cartesian(theta), cartesian(estimates)
    squares = ((found[:, None] - true[None, :, None]) ** 2).sum(axis=-1)  # (p, true, found)
    K = len(theta)
    sums = [squares[:, range(K), list(order)].mean(axis=1) for order in itertools.permutations(range(K))]
    return np.sqrt(np.min(sums, axis=0))


def expected(cost: np.ndarray, near: np.ndarray) -> np.ndarray:
    """What coming near the bound costs, run after run until one does: all costs over the successes; inf: never."""
    with np.errstate(divide="ignore"):
        return cost.sum(axis=0) / near.sum(axis=0)


def interval(cost: np.ndarray, near: np.ndarray) -> tuple[float, float, float]:
    """``expected`` and its 95 % interval over scenes."""
    index = np.random.default_rng(0).integers(len(cost), size=(len(cost), RESAMPLES))
    low, high = np.quantile(expected(cost[index], near[index]), [0.025, 0.975], method="nearest")
    return float(expected(cost, near)), float(low), float(high)


def share(hits: int, n: int) -> str:
    """hits of n with the 95 % interval of Wilson (1927)."""
    z, p = 1.96, hits / n
    middle, half = p + z * z / 2 / n, z * np.sqrt(p * (1 - p) / n + z * z / 4 / n / n)
    low, high = (middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)
    return f"{p:.0%} ({100 * max(low, 0):.0f} – {100 * min(high, 1):.0f})"


# --- tables --------------------------------------------------------------------------------------------------------


def tables(folder: Path, shown: int | None) -> str:
    """For each formulation and budget the solvers, those near the bound in most scenes first."""
    E = pd.read_csv(folder / "errors.csv")
    summary = pd.read_csv(folder / "summary.csv").set_index("method")
    reached = pd.read_csv(folder / "reached.csv")
    lines: list[str] = []
    for part in parts():
        lines += ["", f"### {part.title}", "", *_table(part, E, summary, reached, shown)]
    return "\n".join(lines)


def _table(part: Part, E: pd.DataFrame, summary: pd.DataFrame, reached: pd.DataFrame, shown: int | None) -> list[str]:
    bound, theirs = E["crb_m"].to_numpy(), E[part.base].to_numpy()
    full = part.names[0] in set(reached.method)
    heads = ["solver", f"within {OUTLIER:g} bounds"]
    heads += ["evaluations to get there"] if full else []
    heads += ["RMSE ÷ bound", "RMSE ÷ that of the paper's DE", "evaluations", "seconds ÷ DE's"]
    rows = []
    for name in [*part.names, *(["grid-refine"] if part.formulation == "neef" else [])]:
        error = E[name].to_numpy()
        ok = np.isfinite(error)
        near = error[ok] <= OUTLIER * bound[ok]
        value = float(rms(error[ok]) / rms(bound[ok]))
        against, low, high = ratio(error, theirs, rms)
        told = " **better**" if high < 0.99 else " worse" if low > 1.01 else ""
        failed = f", {summary.failed[name]} failed" if summary.failed[name] else ""
        cells = [f"{_solver(name)}{failed}", share(int(near.sum()), int(ok.sum()))]
        if full:
            cells.append(_cost(reached[reached.method == name]))
        cells += [
            f"{value:.3g}",
            "the paper's" if name == part.base else f"{against:.2g} ({low:.2g} – {high:.2g}){told}",
            f"{summary.evaluations[name]:,.0f}" if summary.evaluations[name] else "–",
            f"{summary.runtime_s[name] / summary.runtime_s[part.base]:.2g}",
        ]
        rows.append((-near.mean(), value, name, "| " + " | ".join(cells) + " |"))
    rows.sort()
    always = (part.base, "grid-refine")
    kept = [row for place, row in enumerate(rows) if shown is None or place < shown or row[2] in always]
    more = [f"\n{len(rows) - len(kept)} more in [all.md](all.md)."] if len(kept) < len(rows) else []
    return ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|", *(row[3] for row in kept), *more]


def _cost(runs: pd.DataFrame) -> str:
    """Expected evaluations to come near the bound; nothing for a method that makes none."""
    if runs.empty:
        return "–"
    cost, low, high = interval(runs.evaluations.to_numpy(float), runs.near.to_numpy())
    return "never" if np.isinf(cost) else f"{cost:,.0f} ({low:,.0f} – {high:,.0f})".replace("inf", "∞")


def _solver(name: str) -> str:
    """A method's name in a table of its formulation and budget."""
    formulation, _, solver = re.sub(r" @\d+$", "", name).partition(" + ")
    return f"{solver}, refined" if "refined" in formulation else solver or formulation


def main() -> None:
    paper.nfbench_command("run", STUDY, "--out", HERE, "--jobs", "2")
    write(HERE)


def write(folder: Path) -> None:
    """Everything that is made from the runs."""
    paper.write_errors(folder)
    write_reached(folder)
    page = HERE / "README.md"
    text = page.read_text(encoding="utf-8")
    block = f"{BEGIN}\n{tables(folder, SHOWN)}\n\n{END}"
    page.write_text(re.sub(f"{BEGIN}.*{END}", lambda _: block, text, flags=re.DOTALL), encoding="utf-8")
    head = "# Every solver\n\nWritten by make.py; see [README.md](README.md).\n"
    (HERE / "all.md").write_text(f"{head}{tables(folder, None)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
