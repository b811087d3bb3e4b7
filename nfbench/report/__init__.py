"""Reports a study's results to the user."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .choice import print_choice
from .localization import localization_csv, localization_json, print_localization
from .publication import TABLE_FORMATS, TABLES, TableFormat, TableName, publication_table
from .terminal import number_text, print_comparison, print_report, shown, summary_table

if TYPE_CHECKING:
    from .html import html_report, write_html

__all__ = [
    "TABLES",
    "TABLE_FORMATS",
    "TableFormat",
    "TableName",
    "html_report",
    "localization_csv",
    "localization_json",
    "number_text",
    "print_choice",
    "print_comparison",
    "print_localization",
    "print_report",
    "publication_table",
    "shown",
    "summary_table",
    "write_html",
]


def __getattr__(name: str) -> Any:
    """Import what needs matplotlib and Jinja2 on first use: the terminal's report needs neither."""
    if name in ("html_report", "write_html"):
        from . import html

        return getattr(html, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
