"""The terminal report: one table per scenario point, each with a sentence that states what the table supports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from nfbench.analysis import MIN_RUNS, default_groups, verdict
from nfbench.core import Status, printable
from nfbench.results import Comparison, Results

__all__ = ["number_text", "print_comparison", "print_report", "shown", "summary_table"]

SHOWN = 20  # maximum number of differing runs that are printed
DISPENSABLE = ("90 %", "runs", "off by", "95 % interval", "evals")  # dropped first, in this order, on a narrow terminal


def print_report(results: Results, console: Console) -> None:
    """Print the summary and verdict of each scenario point, and every kind of failure with an example."""
    meta, runs, summary = results.meta, results.runs, results.summary()
    if runs.empty:
        console.print("No run has finished yet.")
        return
    if meta["title"]:
        console.print()
        console.print(shown(meta["title"], "bold"))
    if meta["expect"]:
        console.print(shown(f"Expected: {meta['expect']}", "dim"))
    left = results.counts.get("open", 0)
    if left:
        console.print(f"[yellow]Unfinished study: {len(runs)} of {left + len(runs)} runs are done.[/yellow]")
    for title, rows, point_runs in _by_point(summary, runs):
        console.print()
        console.print(summary_table(title, rows, meta["error"], float(meta["outlier_m"]), console))
        console.print(shown(verdict(point_runs, meta["error"])))
    _print_failures(runs, console)


def print_comparison(found: Comparison, console: Console) -> None:
    """Print how two folders differ, the runs that differ most, and the effect on the methods' errors."""
    for note in found.notes:
        console.print(shown(note, "yellow"))
    console.print(
        f"Runs in both folders: {found.equal} identical, {found.rounding} equal within rounding (1e-9), "
        f"{len(found.rows)} different. Runs only in the first folder: {found.only_first}; "
        f"only in the second: {found.only_second}."
    )
    if len(found.rows):
        console.print(_frame(found.rows.sort_values("change", ascending=False).head(SHOWN)))
        if len(found.rows) > SHOWN:
            console.print(f"… and {len(found.rows) - SHOWN} more runs")
        console.print(_frame(found.methods.drop(columns="unknown")))
    console.print(shown(_conclusion(found)))


def _conclusion(found: Comparison) -> str:
    """Whether the difference matters, as far as the intervals tell."""
    if found.matters:
        return "The difference matters: runs are missing, a status changed, or an error left its 95\u00a0% interval."
    if found.undecided and not len(found.rows):
        return "No run is in both folders, so nothing can be judged."
    if found.undecided:
        methods = ", ".join(dict.fromkeys(found.methods.loc[found.methods["unknown"], "method"].map(str)))
        return (
            f"Whether the difference matters cannot be judged: there is no 95\u00a0% interval, which needs at least "
            f"{MIN_RUNS} successful runs, for {methods}."
        )
    if len(found.rows):
        return "The difference does not matter: every error stays within its 95\u00a0% interval."
    return "The folders agree."


def shown(text: object, style: str = "") -> Text:
    """Text from a plugin or a file as it is printed: without control characters, and not read as rich's markup."""
    return Text(printable(text), style)


def _frame(frame: pd.DataFrame) -> Table:
    """A table of a frame that shows ``<name>_first`` and ``<name>_second`` in one column as ``first → second``."""
    names = list(dict.fromkeys(name.removesuffix("_first").removesuffix("_second") for name in frame.columns))
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for name in names:
        table.add_column(shown(name.removeprefix("scenario.")), overflow="fold")
    for row in frame.to_dict("records"):
        table.add_row(*(shown(_before_after(row, name)) for name in names))
    return table


def _before_after(row: dict[Any, Any], name: str) -> str:
    sides = [row[key] for key in (name, f"{name}_first", f"{name}_second") if key in row]
    texts = [number_text(side) if isinstance(side, float) else str(side) for side in sides]
    return " → ".join(dict.fromkeys(texts))


def _by_point(summary: pd.DataFrame, runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame]]:
    """Yield (title, rows of the summary, runs) for each scenario point."""
    swept = default_groups(runs)[:-3]
    if not swept:
        yield "", summary, runs
        return
    for key, rows in summary.groupby(swept, sort=False):
        mask = np.logical_and.reduce([runs[name] == value for name, value in zip(swept, key, strict=True)])
        title = ", ".join(f"{name.removeprefix('scenario.')} = {value}" for name, value in zip(swept, key, strict=True))
        yield title, rows, runs[mask]


def summary_table(where: str, rows: pd.DataFrame, error: str, outlier_m: float, console: Console) -> Table:
    """The table of one scenario point, best method first, with as many columns as fit the console."""
    metres = error == "rmse_m"
    name, unit = ("RMSE", "m") if metres else (f"RMS {error}", "")
    median, q90 = ("median_m", "q90_m") if metres else (f"{error}_median", f"{error}_q90")
    columns: dict[str, tuple[str, Callable[[Any], str | Text]]] = {  # heading: (unit, cell of a row)
        name: (unit, lambda row: number_text(row[error])),
        "95 % interval": (unit, lambda row: _interval(row[f"{error}_low"], row[f"{error}_high"])),
        "median": (unit, lambda row: number_text(row[median])),
        "90 %": (unit, lambda row: number_text(row[q90])),
        "off by": (f"> {outlier_m:g} m", lambda row: _percent(row["outlier_rate"])),
        "evals": ("", lambda row: _count(row["evaluations"])),
        "time": ("s", lambda row: number_text(row["runtime_s"])),
        "runs": ("", lambda row: str(row["runs"])),
        "failed": ("", lambda row: Text(str(row["failed"]), "red" if row["failed"] else "")),
    }
    if not metres:
        del columns["off by"]
    while True:
        table = _table(where, rows.sort_values(error, na_position="last"), columns)
        droppable = [head for head in DISPENSABLE if head in columns]
        wanted = console.measure(table, options=console.options.update(max_width=1000)).maximum
        if wanted <= console.width or not droppable:
            return table
        del columns[droppable[0]]


def _table(where: str, rows: pd.DataFrame, columns: dict[str, tuple[str, Callable[[Any], str | Text]]]) -> Table:
    table = Table(
        title=shown(where) if where else None, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False
    )
    table.add_column("method\n", overflow="fold")
    for head, (measure, _) in columns.items():
        table.add_column(Text(f"{printable(head)}\n{measure}"), justify="right", no_wrap=True)
    for row in rows.to_dict("records"):
        table.add_row(shown(row["method"]), *(cell(row) for _, cell in columns.values()))
    return table


def _print_failures(runs: pd.DataFrame, console: Console) -> None:
    """Print each status other than ok with its number of runs, its method and one message."""
    bad = runs[runs["status"] != Status.OK]
    for (status, method), group in bad.groupby(["status", "method"], sort=False):
        console.print(shown(status, "red") + shown(f" × {len(group)}: {method}: {group['message'].iloc[0]}"))


def number_text(value: float) -> str:
    """Three significant digits, with an exponent only for very small and very large numbers."""
    if math.isnan(value):
        return "–"
    return f"{value:.3g}" if value == 0 or not 1e-4 <= abs(value) < 1e4 else f"{float(f'{value:.3g}'):.6g}"


def _interval(low: float, high: float) -> str:
    return "" if math.isnan(low) else f"{number_text(low)} – {number_text(high)}"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{share:.0%}"


def _count(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:,.0f}"
