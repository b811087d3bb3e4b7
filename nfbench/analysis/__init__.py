"""Every conclusion that is drawn from rows: summaries, intervals, comparisons, and the sentences made of them.

The functions take tables and arrays, never folders: whatever has rows can be analysed.
"""

from __future__ import annotations

from .statistics import (
    CONFIDENCE,
    MIN_RUNS,
    bootstrap,
    mean,
    mean_interval,
    median_interval,
    percentile_interval,
    rms,
    rms_interval,
)
from .summary import default_groups, summarize
from .verdicts import judge, verdict

__all__ = [
    "CONFIDENCE",
    "MIN_RUNS",
    "bootstrap",
    "default_groups",
    "judge",
    "mean",
    "mean_interval",
    "median_interval",
    "percentile_interval",
    "rms",
    "rms_interval",
    "summarize",
    "verdict",
]
