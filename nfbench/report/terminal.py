"""The terminal report: one table per scenario point, each with a sentence that states what the table supports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from nfbench.analysis import Block, Outcomes, Ranking, default_groups, sentences
from nfbench.core import Status, printable
from nfbench.results import Comparison, Results

from .parameters import print_parameters
from .proofs import print_proofs

__all__ = ["number_text", "print_comparison", "print_report", "shown", "summary_table"]

SHOWN = 20  # maximum number of differing runs that are printed
AT_END = "so the error is known at the end of a run only"
FEWEST = 6  # scenes with which a difference between two methods can be significant
DISPENSABLE = (  # columns that are dropped first, in this order, on a narrow terminal
    *("90 %", "runs", "off by", "95 % interval", "of scenes, 95 %", "ratio, 95 %", "evals", "failed"),
    *("time", "mean", "median"),
)
LABEL = 28  # characters of a method's label that are not wrapped
Columns: TypeAlias = dict[str, tuple[str, Callable[[Any], str | Text]]]  # by heading: (unit, cell of a row)


def print_report(results: Results, console: Console) -> None:
    """Print the table and verdict of each swept point and of all of them, the claims, the proofs, and the failures."""
    meta, evidence = results.meta, results.evidence()
    runs, summary = evidence.runs, results.summary()
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
    for note in evidence.hits.notes:
        if not note.endswith(AT_END):  # this only makes costs of hits larger
            console.print(shown(note, "dim"))
    ranking = evidence.ranking
    tables = list(_by_point(summary))
    order: dict[str, list[str]] = {}
    for block, ranks, verdict in _overall_first(ranking):
        console.print()
        if len(block.points) == 1:
            title, rows = tables.pop(0)
            order[title] = _ordered(ranks, block)["method"].tolist()
            table = summary_table(title, rows, meta["error"], float(meta["outlier_m"]), console, ranks, block)
        else:
            table = _overall_table(ranks, block, console)
        console.print(table)
        console.print(shown(verdict))
    if evidence.unranked:
        for title, rows in tables:
            console.print(summary_table(title, rows, meta["error"], float(meta["outlier_m"]), console))
        console.print(shown(evidence.unranked))
    _print_claims(evidence.claims(), console)
    print_parameters(summary, ranking.frame, console, number_text, order)
    print_proofs(evidence.references, results.reference_counts.get("open", 0), console)
    _print_failures(runs, console)


def _overall_first(ranking: Ranking) -> list[tuple[Block, pd.DataFrame, str]]:
    """Return each block with the rows of its ranking and its verdict; that of all swept points together comes first."""
    found, first = [], 0
    for block, verdict in zip(ranking.blocks, sentences(ranking), strict=True):
        found.append((block, ranking.frame.iloc[first : first + len(block.methods)], verdict))
        first += len(block.methods)
    return sorted(found, key=lambda each: len(each[0].points) == 1)


def _overall_table(ranks: pd.DataFrame, block: Block, console: Console) -> Table:
    """The table of all swept points together, with as many columns as fit the console."""
    columns: Columns = {
        "solved": (_target(block), lambda row: _percent(row["solved_share"])),
        "of scenes, 95 %": ("interval", _share_interval),
        "error": ("× first", lambda row: number_text(row["error_ratio"])),
        "ratio, 95 %": ("interval", lambda row: _interval(row["ratio_low"], row["ratio_high"])),
        "cost": ("evals/hit", lambda row: _cost(row["ert"])),
        "mean": ("rank", lambda row: number_text(row["mean_rank"])),
    }
    rows = _ordered(ranks.assign(ert=block.ert), block)
    return _fitting("All swept points together", rows, columns, console)


def _print_claims(claims: pd.DataFrame, console: Console) -> None:
    """Print each claim with its verdict and estimate."""
    if claims.empty:
        return
    console.print()
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title="Claims", title_justify="left", title_style="bold")
    for head in ("claim", "verdict"):
        table.add_column(head, overflow="fold")
    for head in ("estimate", "95 % interval", "p"):
        table.add_column(head, justify="right", no_wrap=True)
    styles = {"confirmed": "green", "contradicted": "red"}
    for row in claims.to_dict("records"):
        verdict = str(row["verdict"])
        numbers = number_text(row["estimate"]), _interval(row["low"], row["high"]), number_text(_p_value(row))
        table.add_row(shown(row["text"]), shown(verdict, styles.get(verdict, "")), *numbers)
    console.print(table)


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
        return "The difference matters: runs are missing, a status changed, or a method's error changed significantly."
    if found.undecided and not len(found.rows):
        return "No run is in both folders, so nothing can be judged."
    if found.undecided:
        methods = ", ".join(dict.fromkeys(found.methods.loc[found.methods["unknown"], "method"].map(str)))
        return (
            f"Whether the difference matters cannot be judged: at least {FEWEST} scenes with errors of at least 0 are "
            f"needed, and there are fewer for {methods}."
        )
    if len(found.rows) and (found.methods["ratio"] == 1).all():
        return "The difference does not matter: no method's error has changed."
    if len(found.rows):
        return "No difference in a method's error is significant."
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


def _p_value(row: dict[Any, Any]) -> float:
    """The p-value of the verdict: of the claim, or of its opposite if that is what the data show."""
    return float(row["p_against_holm"] if row["verdict"] == "contradicted" else row["p_holm"])


def _by_point(summary: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield (title, rows of the summary) for each swept point."""
    swept = default_groups(summary)[:-3]
    if not swept:
        yield "", summary
        return
    for key, rows in summary.groupby(swept, sort=False, dropna=False):
        parts = (f"{name.removeprefix('scenario.')} = {value}" for name, value in zip(swept, key, strict=True))
        yield ", ".join(parts), rows


def summary_table(
    where: str,
    rows: pd.DataFrame,
    error: str,
    outlier_m: float,
    console: Console,
    ranks: pd.DataFrame | None = None,
    block: Block | None = None,
) -> Table:
    """The table of one swept point, with as many columns as fit the console.

    ranks, block: the ranking of the same methods, whose best set comes first and is marked. Without it the rows are in
    the order of their root mean square error.
    """
    metres = error == "rmse_m"
    name, unit = ("RMSE", "m") if metres else (f"RMS {error}", "")
    median, q90 = ("median_m", "q90_m") if metres else (f"{error}_median", f"{error}_q90")
    columns: Columns = {
        "median": (unit, lambda row: number_text(row[median])),
        "95 % interval": (unit, lambda row: _interval(row[f"{median}_low"], row[f"{median}_high"])),
        "90 %": (unit, lambda row: number_text(row[q90])),
        name: (unit, lambda row: number_text(row[error])),
        "bound": ("m", lambda row: number_text(row["crb_m"])),
        "off by": (f"> {outlier_m:g} m", lambda row: _percent(row["outlier_rate"])),
        "evals": ("", lambda row: _count(row["evaluations"])),
        "time": ("s", lambda row: number_text(row["runtime_s"])),
        "runs": ("", lambda row: str(row["runs"])),
        "failed": ("", lambda row: Text(str(row["failed"]), "red" if row["failed"] else "")),
    }
    if not metres:
        del columns["off by"]
    if not metres or not np.isfinite(rows["crb_m"].to_numpy(dtype=np.float64)).any():
        del columns["bound"]
    if ranks is not None and block is not None:
        own = ["solved_share", "solved_low", "solved_high", "error_ratio", "ratio_low", "ratio_high", "in_best_set"]
        ranks = ranks.assign(ert=block.ert)
        rows = _ordered(ranks, block)[["method", "ert", *own]].merge(rows, on="method", sort=False)
        columns = {
            "solved": (_target(block), lambda row: _percent(row["solved_share"])),
            "of scenes, 95 %": ("interval", _share_interval),
            "error": ("× first", lambda row: number_text(row["error_ratio"])),
            "ratio, 95 %": ("interval", lambda row: _interval(row["ratio_low"], row["ratio_high"])),
            "cost": ("evals/hit", lambda row: _cost(row["ert"])),
            **columns,
        }
    else:
        rows = rows.sort_values(error, na_position="last")
    return _fitting(where, rows, columns, console)


def _fitting(where: str, rows: pd.DataFrame, columns: Columns, console: Console) -> Table:
    """The table with as many columns as fit the console."""
    columns, longest = dict(columns), max((len(_marked(row)) for row in rows.to_dict("records")), default=0)
    while True:
        table = _table(where, rows, columns)
        droppable = [head for head in DISPENSABLE if head in columns]
        wanted = console.measure(table, options=console.options.update(max_width=1000)).maximum
        wanted -= max(longest - LABEL, 0)
        if wanted <= console.width or not droppable:
            return table
        del columns[droppable[0]]


def _ordered(ranks: pd.DataFrame, block: Block) -> pd.DataFrame:
    """The rows of a block: its best set, the recommended method first, then the others by their mean rank."""
    first = [block.methods[i] for i in block.order]
    place = {method: position for position, method in enumerate(first)}
    pairs = zip(ranks["method"].tolist(), ranks["mean_rank"].tolist(), strict=True)
    keys = [(place.get(method, len(first)), rank) for method, rank in pairs]
    return ranks.iloc[sorted(range(len(ranks)), key=lambda i: keys[i])]


def _target(block: Block) -> str:
    """The target that counts as solved, without the word that is in the heading above it."""
    first = block.points[0]
    unit = " m" if first.target.startswith("error") and "bound" not in first.target and _in_metres(first) else ""
    return f"{first.target.removeprefix('error ')}{unit}" if first.target else "an estimate"


def _in_metres(outcomes: Outcomes) -> bool:
    return outcomes.error_name.endswith("_m")


def _marked(row: dict[Any, Any]) -> Text:
    """The method, with a dot if it is in the best set."""
    best = row.get("in_best_set")
    return shown(
        f"{'●' if best is True or best == 1 else ' '} {row['method']}" if "in_best_set" in row else row["method"]
    )


def _share_interval(row: dict[Any, Any]) -> str:
    low, high = row["solved_low"], row["solved_high"]
    return "" if math.isnan(low) else f"{100 * low:.0f} – {100 * high:.0f} %"


def _plain_table(where: str, width: int) -> Table:
    table = Table(
        title=shown(where) if where else None, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False
    )
    table.add_column("method\n", overflow="fold", min_width=width)
    return table


def _table(where: str, rows: pd.DataFrame, columns: Columns) -> Table:
    longest = max((len(_marked(row)) for row in rows.to_dict("records")), default=0)
    table = _plain_table(where, min(longest, LABEL))
    for head, (measure, _) in columns.items():
        table.add_column(Text(f"{printable(head)}\n{measure}"), justify="right", no_wrap=True)
    for row in rows.to_dict("records"):
        table.add_row(_marked(row), *(cell(row) for _, cell in columns.values()))
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
    if math.isnan(low):
        return ""
    first, last = number_text(low), number_text(high)
    return f"≈ {first}" if first == last and low != high else f"{first} – {last}"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{share:.0%}"


def _cost(ert: float) -> str:
    """Evaluations per hit; a dash where there was no hit, or no evaluation."""
    return f"{ert:,.0f}" if 0 < ert < math.inf else "–"


def _count(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:,.0f}"
