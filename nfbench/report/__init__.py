"""Reports a study's results to the user."""

from __future__ import annotations

from .choice import print_choice
from .localization import localization_csv, localization_json, print_localization
from .terminal import number_text, print_comparison, print_report, shown, summary_table

__all__ = [
    "localization_csv",
    "localization_json",
    "number_text",
    "print_choice",
    "print_comparison",
    "print_localization",
    "print_report",
    "shown",
    "summary_table",
]
