"""The table of errors per parameter: median, root mean square, bias and bound of azimuth, elevation and range."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from nfbench.analysis import Parameter, default_groups, parameters
from nfbench.core import printable

__all__ = ["print_parameters"]

ROWS = 24  # with more, only the best methods are shown
DISPENSABLE = ("bias", "median", "bound")  # columns that are dropped first, in this order, on a narrow terminal

_Number = Callable[[float], str]
_Order = Mapping[str, Sequence[str]]


def print_parameters(
    summary: pd.DataFrame,
    ranking: pd.DataFrame,
    console: Console,
    number_text: _Number,
    order: _Order = MappingProxyType({}),
) -> None:
    """Print the errors of the single parameters, by swept point; nothing if the scenario has none.

    summary: the columns of ``summary.csv``.
    ranking: the columns of ``ranking.csv``; empty if methods are not ranked.
    number_text: prints a number.
    order: methods by the title of the swept point, in the order of the table of that point; others follow.
    """
    if not (known := parameters(summary.columns)):
        return
    rows = summary if len(summary) <= ROWS else _best(summary, ranking)
    heads = [
        "median",
        "RMSE",
        "bias",
        *(["bound"] if any(p.bound in summary and _has(summary[p.bound]) for p in known) else []),
    ]
    droppable = [head for head in DISPENSABLE if head in heads]
    table = _table(rows, known, heads, number_text, order)
    while droppable and console.measure(table, options=console.options.update(max_width=1000)).maximum > console.width:
        heads.remove(droppable.pop(0))
        table = _table(rows, known, heads, number_text, order)
    console.print()
    console.print(table)
    if len(rows) < len(summary):
        console.print("Only the best methods at each point; summary.csv has all.")


def _in_order(rows: pd.DataFrame, order: Sequence[str]) -> pd.DataFrame:
    """The rows, the methods in this order; others follow as they are."""
    place = {method: k for k, method in enumerate(order)}
    ranks = rows["method"].map(lambda method: place.get(method, len(place)))
    return rows.iloc[ranks.to_numpy().argsort(kind="stable")]


def _has(values: pd.Series) -> bool:
    return bool(values.notna().any())


def _best(summary: pd.DataFrame, ranking: pd.DataFrame) -> pd.DataFrame:
    """The rows of the methods in the best set of their swept point; all rows where there is none."""
    by = [*default_groups(summary)[:-3], "method"]
    if not {*by, "in_best_set"} <= set(ranking.columns):
        return summary
    best = ranking[[value is True or value == 1 for value in ranking["in_best_set"]]]
    chosen = set(best[by].itertuples(index=False, name=None))
    kept = summary[[row in chosen for row in summary[by].itertuples(index=False, name=None)]]
    return kept if len(kept) else summary


def _table(rows: pd.DataFrame, known: list[Parameter], heads: list[str], number_text: _Number, order: _Order) -> Table:
    table = Table(
        title="Errors per parameter",
        title_justify="left",
        title_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("\nmethod", overflow="fold")
    for parameter in known:
        for i, head in enumerate(heads):
            text = "" if i else printable(f"{parameter.name} [{parameter.symbol}]")
            table.add_column(Text(f"{text}\n{head}"), justify="right", no_wrap=True)
    for title, part in _by_point(rows):
        if title:
            table.add_row(Text(printable(title), "dim"))
        for row in _in_order(part, order.get(title, ())).to_dict("records"):
            numbers = (row.get(_column(parameter, head), float("nan")) for parameter in known for head in heads)
            table.add_row(Text(printable(row["method"])), *map(number_text, numbers))
    return table


def _column(parameter: Parameter, head: str) -> str:
    names = {"RMSE": parameter.error, "bias": parameter.bias, "bound": parameter.bound}
    return names.get(head, f"{parameter.error}_median")


def _by_point(summary: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield (title, rows) for each swept point."""
    swept: list[Any] = default_groups(summary)[:-3]
    if not swept:
        yield "", summary
        return
    for key, rows in summary.groupby(swept, sort=False, dropna=False):
        yield ", ".join(f"{n.removeprefix('scenario.')} = {v}" for n, v in zip(swept, key, strict=True)), rows
