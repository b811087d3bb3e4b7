"""What a study found, for people to read."""

from __future__ import annotations

from .terminal import number_text, print_comparison, print_report, summary_table

__all__ = ["number_text", "print_comparison", "print_report", "summary_table"]
