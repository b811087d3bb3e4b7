"""Swept values and free text as cells of a table, such that every reader gives back what is in the store.

A cell that starts with ``"``, ``[`` or ``{`` is JSON: a text, a list or a table. Every other cell is itself. A text
that starts with one of these three is therefore written as JSON, in every table. In CSV files, so is every text that
pandas or a spreadsheet would take for something else: one that does not start with a letter, a digit or ``_``
(formulas), numbers and dates, ``NA``, ``null``, ``True``, ``inf``, and text with line breaks or other control
characters.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["cell", "csv_frame", "csv_text", "from_cell"]

_JSON = ('"', "[", "{")
_WORDS = {  # that readers take for a missing value, a truth value or a number
    *("na", "nan", "nat", "null", "none", "n/a", "true", "false", "inf", "infinity", "1.#ind", "1.#qnan"),
}
_MONTH = "(jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)[a-z]*"
_NUMBER_OR_DATE = re.compile(rf"\d[\d\W_]*(e|am|pm|a|p|{_MONTH})?[\d\W_]*|{_MONTH}[\W_]*\d[\d\W_]*", re.IGNORECASE)


def cell(value: Any) -> Any:
    """A swept value as one cell: numbers and text unchanged, lists, tables and ambiguous text as JSON."""
    if isinstance(value, list | dict) or (isinstance(value, str) and value.startswith(_JSON)):
        return json.dumps(value)
    return value


def from_cell(found: Any) -> Any:
    """The swept value, or the text, that a cell stands for."""
    return json.loads(found) if isinstance(found, str) and found.startswith(_JSON) else found


def csv_text(text: str, is_cell: bool = False) -> str:
    """A text as it is written to a CSV file; ``is_cell`` if it has passed ``cell``. Empty text stays empty."""
    if (is_cell and text.startswith(_JSON)) or _is_safe(text) or (not text and not is_cell):
        return text
    return json.dumps(text, ensure_ascii=not text.isprintable())


def csv_frame(frame: pd.DataFrame) -> pd.DataFrame:
    """A copy of a frame of runs or of their summary, with its text as it is written to a CSV file."""
    changed = {}
    for name in frame.columns:
        if name != "run_id" and frame[name].dtype.kind not in "biuf":
            is_cell, known = name.startswith(("scenario.", "budget.")), dict[Any, Any]()
            for value in frame[name].unique():  # texts repeat
                known[value] = csv_text(value, is_cell) if isinstance(value, str) else value
            changed[name] = [known.get(value, value) for value in frame[name]]
    return frame.assign(**changed)


def _is_safe(text: str) -> bool:
    return (
        (text[:1].isalnum() or text.startswith("_"))
        and text.isprintable()
        and text == text.strip()
        and text.casefold() not in _WORDS
        and not _NUMBER_OR_DATE.fullmatch(text)
    )
