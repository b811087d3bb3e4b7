"""Runs the study and writes its tables: ``python results/optimizer_choice/make.py``; finished runs are not repeated."""

from __future__ import annotations

import functools
import itertools
import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import binomtest

import nfbench
from nfbench.analysis import bootstrap, percentile_interval, rms
from nfbench.figures.style import GREY, WIDTHS, styled
from nfbench.plugins import Registry
from nfbench.problems.near_field.geometry import cartesian

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "paper"))
import make as paper  # noqa: E402
from ledger import OUTLIER, RESAMPLES, ratio  # noqa: E402

STUDY = HERE.parents[1] / "studies" / "optimizer_choice.toml"
BEGIN, END = "<!-- table: written by make.py -->", "<!-- end of table -->"
PAPER = {"neef": "neef + de, paper @{}", "nemo": "nemo + de(population=50){}"}  # the paper's DE
GOALS = (f"until the error is below {OUTLIER:g} × the bound", "until the first source's minimum is reached")
SHOWN = 12  # number of solvers in each table of README.md; all.md lists every solver


@dataclass(frozen=True)
class Part:
    """The methods that share one formulation and budget; ``base`` is the paper's DE among them."""

    formulation: str
    budget: int
    names: tuple[str, ...]
    base: str

    @property
    def title(self) -> str:
        each = " for each source" if self.formulation == "nemo" else ""
        return f"{self.formulation.upper()}, {self.budget:,} evaluations{each}"


@functools.cache
def study() -> nfbench.Study:
    return nfbench.load_study(STUDY)


def parts() -> list[Part]:
    """The groups of methods that the study compares, read from its manifest."""
    methods = study().methods
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


# --- cost of reaching the goal ----------------------------------------------------------------------------------------


def write_reached(folder: Path) -> None:
    """``reached.csv``: for each run with the paper's budget, when it reached its goal for good.

    With NEEF: to an error of at most OUTLIER times the scene's bound. With NEMO, whose first problem is the same for
    every solver: to within one Cramér–Rao bound of the best point that any run has found for the first problem.
    evaluations, seconds: what the run had spent when it reached the goal, or in total if it never did.
    """
    results = nfbench.Results(folder)
    runs = results.runs[results.runs.status == "ok"].set_index("run_id")
    full = {name: part.formulation for part in parts() if part.budget in (60000, 15000) for name in part.names}
    formulation = runs.method.map(full)
    truth = _truth(runs)
    traces = results.traces
    traces = traces[(traces.problem == 0) & traces.run_id.isin(runs.index)]
    nemo = traces[traces.run_id.isin(runs.index[runs.method.str.startswith("nemo")])]
    first = nemo.assign(scene=nemo.run_id.map(runs.instance_seed)).sort_values("value").groupby("scene").first()
    rows = []
    for run_id, trace in traces[traces.run_id.map(formulation).notna()].groupby("run_id", sort=False):
        run, kind = runs.loc[run_id], formulation[run_id]
        theta = truth[run.instance_seed]
        goal = theta if kind == "neef" else first.loc[run.instance_seed, ["x_0", "x_1"]].to_numpy(float)[None]
        x = trace[[f"x_{j}" for j in range(goal.size)]].to_numpy()
        far = errors(x.reshape(-1, *goal.shape), goal) > (OUTLIER if kind == "neef" else 1) * run.crb_m
        there = not far[-1]
        row = trace.iloc[len(far) - int(far[::-1].argmax()) if there and far.any() else 0 if there else -1]
        rows.append((run.method, run.repetition, there, int(row.evaluations), row.seconds))
    table = pd.DataFrame(rows, columns=["method", "repetition", "there", "evaluations", "seconds"])
    table.sort_values(["method", "repetition"]).to_csv(folder / "reached.csv", index=False, float_format="%.3g")


def _truth(runs: pd.DataFrame) -> dict[int, np.ndarray]:
    """The true sources (K, d) of each scene, by its seed."""
    choice = study().points[0].scenario
    scenario = Registry().make("scenario", choice.kind, choice.options)
    return {seed: scenario.draw(np.random.default_rng(seed)).theta for seed in runs.instance_seed.unique()}


def errors(estimates: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Root mean square errors [m] of estimates (p, K, d) after the best assignment to the sources (K, d)."""
    true, found = cartesian(theta), cartesian(estimates)
    squares = ((found[:, None] - true[None, :, None]) ** 2).sum(axis=-1)  # (p, true, found)
    K = len(theta)
    sums = [squares[:, range(K), list(order)].mean(axis=1) for order in itertools.permutations(range(K))]
    return np.sqrt(np.min(sums, axis=0))


def expected(cost: np.ndarray, there: np.ndarray) -> np.ndarray:
    """The expected cost of restarting until one run succeeds: total cost divided by the number of successes, or inf."""
    with np.errstate(divide="ignore"):
        return cost.sum(axis=-1) / there.sum(axis=-1)


def interval(cost: np.ndarray, there: np.ndarray) -> tuple[float, float, float]:
    """``expected`` and its 95 % interval over scenes."""
    resampled = bootstrap(expected, cost, there, rng=np.random.default_rng(0), resamples=RESAMPLES)
    return float(expected(cost, there)), *percentile_interval(resampled, "nearest")


def cost_ratio(own: pd.DataFrame, theirs: pd.DataFrame, unit: str) -> tuple[float, float]:
    """The 95 % interval of the ratio of the expected evaluations or seconds of two methods, on their common scenes."""
    both = own.merge(theirs, on="repetition", suffixes=("", "_theirs"))
    samples = [both[name + whose].to_numpy(float) for whose in ("", "_theirs") for name in (unit, "there")]

    def quotient(cost: np.ndarray, there: np.ndarray, cost_theirs: np.ndarray, there_theirs: np.ndarray) -> np.ndarray:
        return expected(cost, there) / expected(cost_theirs, there_theirs)

    resampled = bootstrap(quotient, *samples, rng=np.random.default_rng(0), resamples=RESAMPLES)
    return percentile_interval(resampled, "nearest")


def share(hits: int, n: int) -> str:
    """The share of hits among n as a percentage, with its 95 % Wilson (1927) interval."""
    low, high = binomtest(hits, n).proportion_ci(method="wilson")
    return f"{hits / n:.0%} ({100 * low:.0f} – {100 * high:.0f})"


# --- tables --------------------------------------------------------------------------------------------------------


def tables(folder: Path, shown: int | None) -> str:
    """One table of solvers per formulation and budget, sorted by cost, then by how often they come near the bound."""
    E = pd.read_csv(folder / "errors.csv")
    summary = pd.read_csv(folder / "summary.csv").set_index("method")
    reached = pd.read_csv(folder / "reached.csv")
    lines: list[str] = []
    for part in parts():
        lines += ["", f"### {part.title}", "", *_table(part, E, summary, reached, shown)]
    return "\n".join(lines)


def _table(part: Part, E: pd.DataFrame, summary: pd.DataFrame, reached: pd.DataFrame, shown: int | None) -> list[str]:
    bound, theirs = E["crb_m"].to_numpy(), E[part.base].to_numpy()
    at_full = part.base in set(reached.method)
    heads = ["solver", f"error ≤ {OUTLIER:g} × bound", "RMSE ÷ bound", "RMSE ÷ RMSE of the paper's DE"]
    where = "to reach it" if part.formulation == "neef" else "to reach the first source's minimum"
    heads += [f"evaluations {where}", "seconds ÷ DE's"] if at_full else ["evaluations", "seconds ÷ DE's"]
    rows = []
    for name in [*part.names, *(["grid-refine"] if part.formulation == "neef" else [])]:
        error = E[name].to_numpy()
        ok = np.isfinite(error)
        near = error[ok] <= OUTLIER * bound[ok]
        value = float(rms(error[ok]) / rms(bound[ok]))
        factor, low, high = ratio(error, theirs, rms)
        verdict = " **better**" if high < 0.99 else " worse" if low > 1.01 else ""
        failed = f", {summary.failed[name]} failed" if summary.failed[name] else ""
        cells = [
            f"{_solver(name)}{failed}",
            share(int(near.sum()), int(ok.sum())),
            f"{value:.3g}",
            "the paper's" if name == part.base else f"{factor:.2g} ({low:.2g} – {high:.2g}){verdict}",
        ]
        cost = math.inf
        if at_full and name in set(reached.method):
            cost, *shown_cost = _cost(reached, name, part.base)
            cells += shown_cost
        else:
            base = _seconds(reached, part.base) if at_full else summary.runtime_s[part.base]
            cells.append(f"{summary.evaluations[name]:,.0f}" if summary.evaluations[name] else "–")
            cells.append(f"{summary.runtime_s[name] / base:.2g}")
        rows.append((cost, -near.mean(), value, name, "| " + " | ".join(cells) + " |"))
    rows.sort()
    always = (part.base, "grid-refine")
    kept = [row for place, row in enumerate(rows) if shown is None or place < shown or row[3] in always]
    more = [f"\n{len(rows) - len(kept)} more in [all.md](all.md)."] if len(kept) < len(rows) else []
    return ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|", *(row[-1] for row in kept), *more]


def _cost(reached: pd.DataFrame, name: str, base: str) -> tuple[float, str, str]:
    """The expected evaluations to reach the goal, as a number and as a table cell, and a cell with seconds ÷ DE's."""
    own, theirs = reached[reached.method == name], reached[reached.method == base]
    cost, low, high = interval(own.evaluations.to_numpy(float), own.there.to_numpy())
    if np.isinf(cost):
        return cost, "never", ""
    less, more = cost_ratio(own, theirs, "evaluations")
    verdict = " **fewer**" if more < 0.99 else " more" if less > 1.01 else ""
    shown = f"{cost:,.0f} ({low:,.0f} – {high:,.0f}){verdict}".replace("inf", "∞")
    seconds = f"{_seconds(reached, name) / _seconds(reached, base):.2g}"
    if name != base:
        less, more = cost_ratio(own, theirs, "seconds")
        seconds += f" ({less:.2g} – {more:.2g})".replace("inf", "∞")
    return cost, shown, seconds


def _seconds(reached: pd.DataFrame, name: str) -> float:
    """The expected seconds to reach the goal."""
    runs = reached[reached.method == name]
    return float(expected(runs.seconds.to_numpy(), runs.there.to_numpy()))


@functools.cache
def _solver(name: str) -> str:
    """The name of a method's solver in the tables; for a wrapped library, the library and its algorithm."""
    method = next((method for method in study().methods if method.label == name), None)
    if method is None or method.solver is None:
        return name
    if "algorithm" in method.solver.options:
        return f"{method.solver.kind} {method.solver.options['algorithm']}"
    name = re.sub(r" @\d+$", "", name).partition(" + ")[2]
    return f"{name}, refined" if "refined" in method.formulation.label else name


# --- figure --------------------------------------------------------------------------------------------------------


def draw(folder: Path) -> None:
    """``cost.svg``: the cost of reaching the goal, one line per solver, sorted by the cost with NEEF."""
    reached = pd.read_csv(folder / "reached.csv")
    panels = [(part, _costs(part, reached)) for part in parts() if part.base in set(reached.method)]
    order = sorted(panels[0][1], key=lambda solver: (*panels[0][1][solver][::2], panels[1][1].get(solver, (math.inf,))))
    with styled():
        figure, axes = plt.subplots(1, 2, figsize=(WIDTHS["double"], 0.6 + 0.155 * len(order)), sharey=True)
        for ax, (part, costs), goal in zip(axes, panels, GOALS, strict=True):
            for place, solver in enumerate(order):
                if solver in costs and math.isinf(costs[solver][0]):
                    ax.text(
                        0.98, place, "never", color=GREY, va="center", ha="right", transform=ax.get_yaxis_transform()
                    )
                elif solver in costs:
                    cost, low, high = costs[solver]
                    is_paper = solver == _solver(panels[0][0].base) or (solver == _solver(part.base))
                    colour = "#D55E00" if is_paper else "#0072B2"
                    ax.plot([low, min(high, 1e9)], [place, place], color=colour, linewidth=1)
                    ax.plot(cost, place, "o", color=colour, markersize=3)
            ax.set(xscale="log", xlabel=f"evaluations {goal}", title=part.formulation.upper())
            ax.set_xlim(right=min(ax.get_xlim()[1], 3e6))
        axes[0].set(yticks=range(len(order)), yticklabels=order, ylim=(len(order) - 0.3, -0.7))
        figure.tight_layout()
        figure.savefig(folder / "cost.svg", metadata={"Date": None})


def _costs(part: Part, reached: pd.DataFrame) -> dict[str, tuple[float, float, float]]:
    grouped = {name: runs for name, runs in reached.groupby("method") if name in part.names}
    return {
        _solver(name): interval(runs.evaluations.to_numpy(float), runs.there.to_numpy())
        for name, runs in grouped.items()
    }


def main() -> None:
    paper.nfbench_command("run", STUDY, "--out", HERE, "--jobs", "2")
    write(HERE)


def write(folder: Path) -> None:
    """Write every file that is made from the runs."""
    paper.write_errors(folder)
    write_reached(folder)
    page = HERE / "README.md"
    text = page.read_text(encoding="utf-8")
    block = f"{BEGIN}\n{tables(folder, SHOWN)}\n\n{END}"
    page.write_text(re.sub(f"{BEGIN}.*{END}", lambda _: block, text, flags=re.DOTALL), encoding="utf-8")
    draw(folder)
    head = "# Every solver\n\nWritten by make.py; see [README.md](README.md).\n"
    (HERE / "all.md").write_text(f"{head}{tables(folder, None)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
