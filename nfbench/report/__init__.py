"""Reports a study's results to the user."""

from __future__ import annotations

from .terminal import number_text, print_comparison, print_report, shown, summary_table

__all__ = ["number_text", "print_comparison", "print_report", "shown", "summary_table"]
