"""Writes the report of a study as one HTML file that opens offline."""

from __future__ import annotations

from .page import html_report, write_html

__all__ = ["html_report", "write_html"]
