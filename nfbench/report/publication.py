"""Tables of a study for papers and pages: LaTeX, Markdown or CSV, with headings, units and rounded numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, get_args

import pandas as pd

from nfbench.core import NfbenchError, nearest, printable
from nfbench.results import Results, csv_frame
from nfbench.study import read_labels

from .latex_table import latex_table
from .terminal import number_text

__all__ = ["TABLES", "TABLE_FORMATS", "TableFormat", "TableName", "publication_table"]

TableName: TypeAlias = Literal["summary", "ranking", "targets", "claims"]
TABLES: tuple[TableName, ...] = get_args(TableName)
TableFormat: TypeAlias = Literal["latex", "markdown", "csv"]
TABLE_FORMATS: tuple[TableFormat, ...] = get_args(TableFormat)

SHOWN: dict[TableName, tuple[str, ...]] = {  # columns of each table, as far as it has them; an interval is one column
    "summary": ("rmse_m", "median_m", "crb_m", "floor_m", "outlier_rate", "failed", "evaluations", "runtime_s"),
    "ranking": ("solved_share", "error_ratio", "mean_rank", "in_best_set"),
    "targets": ("target", "share", "ert"),
    "claims": ("text", "verdict", "estimate", "p_holm"),
}
INTERVALS = {"solved_share": "solved", "error_ratio": "ratio", "estimate": ""}  # stems of the columns of their ends
HEADINGS = {
    "method": "Method",
    "rmse_m": "RMSE [m]",
    "median_m": "Median [m]",
    "crb_m": "CRB [m]",
    "floor_m": "Floor [m]",
    "outlier_rate": "Outliers [%]",
    "failed": "Failed",
    "evaluations": "Evaluations",
    "runtime_s": "Run time [s]",
    "solved_share": "Solved [%]",
    "error_ratio": "Error ÷ first",
    "mean_rank": "Mean rank",
    "in_best_set": "Best set",
    "target": "Target",
    "share": "Reached [%]",
    "ert": "Evaluations per success",
    "text": "Claim",
    "verdict": "Verdict",
    "estimate": "Estimate",
    "p_holm": "p",
}
LABELLED = {"rmse_m": "rmse", "median_m": "median", "runtime_s": "runtime"}  # columns that [labels] can name
SHARES = ("outlier_rate", "solved_share", "share")
COUNTS = ("failed", "evaluations", "ert")


def publication_table(
    results: Results, which: TableName, to: TableFormat, columns: Sequence[str] = (), intervals: bool = True
) -> str:
    """Return a table of a study as text, ready to be included in a document.

    results: the study. which: the table. to: its format; a CSV table has all columns with all digits.
    columns: names of the columns to show after the swept values and the method; empty for a selection.
    intervals: whether values are followed by their 95 % intervals, where these are known.

    Raises NfbenchError if the study has no such table or column.
    """
    frame = _frame(results, which)
    if frame.empty:
        raise NfbenchError(f"{results.folder}: there are no {which} to show")
    wanted = [*columns] or [name for name in SHOWN[which] if name in frame and frame[name].notna().any()]
    if "rmse_m" not in frame and which == "summary" and not columns:
        wanted = [results.meta["error"], *wanted]
    for name in wanted:
        if name not in frame:
            near = nearest(name, [str(column) for column in frame.columns])
            raise NfbenchError(f"columns: {which} has no column {name!r}{f'; did you mean {near!r}?' if near else ''}")
    keys = [] if which == "claims" else [*_swept(frame), "method"]
    if to == "csv":
        chosen = frame[[*keys, *wanted]] if columns else frame
        return csv_frame(chosen).to_csv(index=False, lineterminator="\n")
    best = frame["in_best_set"] if "in_best_set" in frame else pd.Series(False, frame.index)
    rows = [
        [*(_text(row[key]) for key in keys), *(_cell(row, name, intervals) for name in wanted)]
        for row in frame.to_dict("records")
    ]
    labels = read_labels(results.folder / "manifest.toml")
    heads = [_heading(name, labels) for name in (*keys, *wanted)]
    left = len(keys) if which != "claims" else 2
    bold = [bool(value) if pd.notna(value) else False for value in best]
    if to == "markdown":
        return _markdown(heads, rows, left, bold)
    title = printable(results.meta["title"], 400) or which.capitalize()
    return latex_table(heads, rows, left, max(len(keys) - 1, 0), bold, title)


def _frame(results: Results, which: TableName) -> pd.DataFrame:
    if which == "summary":
        return results.summary()
    if which == "ranking":
        return results.ranking().frame
    return results.target_table() if which == "targets" else results.claims()


def _swept(frame: pd.DataFrame) -> list[str]:
    return [name for name in frame.columns if name.startswith(("scenario.", "budget."))]


def _heading(name: str, labels: Mapping[str, str]) -> str:
    key = LABELLED.get(name, name.removeprefix("scenario."))
    if key in labels:
        return printable(labels[key], 400)
    if name in HEADINGS:
        return HEADINGS[name]
    from nfbench.figures import name_of  # it imports matplotlib

    return name_of(key).replace(r"\$", "$")


def _text(value: Any) -> str:
    if isinstance(value, float):
        return "∞" if value == math.inf else f"{value:g}".replace("-", "−")
    return printable(str(value), 400)


def _cell(row: dict[Any, Any], name: str, intervals: bool) -> str:
    """A value as text, with the ends of its interval where the row has them."""
    value = row[name]
    if isinstance(value, str):
        return printable(value, 400)
    if name == "in_best_set":
        return "–" if pd.isna(value) else "yes" if bool(value) else "no"
    text = _number(value, name)
    stem = INTERVALS.get(name, name)
    low, high = (row.get(f"{stem}_{end}" if stem else end, math.nan) for end in ("low", "high"))
    if not intervals or pd.isna(low) or pd.isna(high):
        return text
    return f"{text} [{_number(low, name)}, {_number(high, name)}]"


def _number(value: Any, name: str) -> str:
    if value is None or pd.isna(value):
        return "–"
    number = float(value)
    if math.isinf(number):
        return "∞" if number > 0 else "−∞"
    if name in SHARES:
        return f"{100 * number:.0f}" if number in (0, 1) else f"{100 * number:.3g}"
    text = f"{number:,.0f}" if name in COUNTS else number_text(number)
    return text.replace("-", "−")


def _markdown(heads: list[str], rows: list[list[str]], left: int, bold: list[bool]) -> str:
    lines = ["| " + " | ".join(map(_escaped, heads)) + " |"]
    lines.append("|" + "|".join(["---"] * left + ["---:"] * (len(heads) - left)) + "|")
    for row, strong in zip(rows, bold, strict=True):
        cells = [_escaped(cell) for cell in row]
        if strong:
            cells[left - 1] = f"**{cells[left - 1]}**"
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def _escaped(text: str) -> str:
    """Text that Markdown prints literally, in a cell."""
    text = re.sub(r"([\\`*_|~$#])", r"\\\1", text)
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\n", " ")
