"""Prints which methods meet a request: the answer, the methods, and what other requests would give."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from nfbench.analysis import LIKELY, MEETS, Choice, time_text
from nfbench.core import printable

from .terminal import number_text, shown

__all__ = ["WORDS", "amount", "print_choice"]

LABEL = 24  # characters of a label that are not wrapped
SHOWN = 10  # methods that are printed, besides the cheapest set
STYLES = {MEETS: "green", LIKELY: "yellow"}
WORDS = {MEETS: "yes", LIKELY: "likely"}  # "no" otherwise


def print_choice(choice: Choice, console: Console, methods: int = SHOWN) -> None:
    """Print the answer, the methods in the order of the recommendation, the steps, and the prices."""
    for sentence in choice.sentences:
        console.print(shown(sentence))
    for note in choice.notes:
        console.print(shown(f"Note: {note}", "dim"))
    if len(choice.frame):
        console.print()
        console.print(_methods(choice, methods, console.width))
        if len(choice.frame) > methods:
            console.print(shown(f"… and {len(choice.frame) - methods} more; --json has them all", "dim"))
    if len(choice.steps):
        console.print()
        console.print(_steps(choice))
    if len(choice.prices):
        console.print()
        _print_prices(choice.prices, console)


def _methods(choice: Choice, most: int, width: int) -> Table:
    """The table of methods, with as many columns as fit."""
    percent = f"{100 * choice.request.confidence:.4g} %"
    wanted = f"{100 * choice.request.reliability:.4g} %"
    places = [place for place in choice.frame["worst"] if "=" in place]
    keys = ", ".join(part.partition(" = ")[0] for part in places[0].split(", ")) if places else ""
    columns: dict[str, Callable[[Any], str | Text]] = {
        "meets it\n": _verdict,
        "share of\nscenes": lambda row: f"{row['share']:.0%}",
        f"{percent}\ninterval": lambda row: f"{100 * row['share_low']:.0f} – {100 * row['share_high']:.0f} %",
        f"worst at\n{printable(keys)}": lambda row: shown(_values(row["worst"])),
        f"needed for\n{wanted}": lambda row: amount(row["budget"], choice.unit, up=True),
        f"{percent}\nof it": lambda row: _ends(row, choice.unit),
    }
    if not places:
        del columns[f"worst at\n{printable(keys)}"]
    rows = choice.frame.head(most).to_dict("records")
    longest = max(len(row["setting"]) for row in rows) + 2
    while True:
        table = _table(f"{choice.target}, wanted in {wanted} of scenes")
        table.add_column("method\n", overflow="fold", min_width=min(longest, LABEL))
        for head in columns:
            table.add_column(head, justify="left" if head.startswith("meets") else "right", no_wrap=True)
        for row in rows:
            name = shown(f"{'●' if row['cheapest'] else ' '} {row['setting']}")
            table.add_row(name, *(cell(row) for cell in columns.values()))
        needed = Console(width=1000).measure(table).maximum - max(longest - LABEL, 0)
        droppable = [head for head in columns if head.endswith("of it") or head.startswith("worst at")]
        if needed <= width or not droppable:
            return table
        del columns[droppable[-1]]


def _verdict(row: dict[Any, Any]) -> Text:
    verdict = str(row["verdict"])
    return Text(WORDS.get(verdict, "no"), STYLES.get(verdict, ""))


def _values(place: str) -> str:
    """The swept values without their names, which are in the heading."""
    return ", ".join(part.partition(" = ")[2] for part in place.split(", ")) if "=" in place else "all alike"


def _ends(row: dict[Any, Any], unit: str) -> str:
    low, high = row["budget_low"], row["budget_high"]
    if not math.isfinite(low) or not math.isfinite(row["budget"]):
        return ""
    return f"{amount(low, unit)} – {amount(high, unit) if math.isfinite(high) else '?'}"


def amount(value: float, unit: str, *, up: bool = False) -> str:
    """A number of evaluations or a time in words. up: whether it is rounded up, as a limit that suffices."""
    if not math.isfinite(value):
        return "–"
    return time_text(value, up=up) if unit == "s" else f"{value:,.0f}"


def _steps(choice: Choice) -> Table:
    table = _table("With another request")
    for head in ("instead", "best method"):
        table.add_column(head, overflow="fold")
    table.add_column("meets it", no_wrap=True)
    for head in ("share", "needed"):
        table.add_column(head, justify="right", no_wrap=True)
    for row in choice.steps.to_dict("records"):
        table.add_row(
            shown(row["change"]),
            shown(row["setting"]),
            _verdict(row),
            "–" if math.isnan(row["share"]) else f"{row['share']:.0%}",
            amount(row["budget"], choice.unit, up=True),
        )
    return table


def _print_prices(prices: pd.DataFrame, console: Console) -> None:
    """Print which method needs the least time at which cost of an evaluation."""
    if len(prices) == 1:
        setting = prices["setting"].iloc[0]
        text = f"{setting} needs the least time whatever an evaluation costs, from 0.1 µs to 1 s."
        console.print(shown(text))
        return
    table = _table("Least time, by the time of one evaluation")
    table.add_column("one evaluation takes", no_wrap=True)
    table.add_column("method", overflow="fold")
    for position, row in enumerate(prices.to_dict("records")):
        low, high = (time_text(float(number_text(row[name]).replace(",", "")) / 1e6) for name in ("from_us", "to_us"))
        last = position == len(prices) - 1
        where = f"over {low}" if last else f"{low} – {high}" if position else f"up to {high}"
        table.add_row(where, shown(row["setting"]))
    console.print(table)


def _table(title: str) -> Table:
    return Table(title=shown(title), title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
