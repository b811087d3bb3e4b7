"""The statistics of nfbench: summaries, intervals and comparisons of runs, and the sentences that state them.

The functions take tables and arrays, not folders, so they can analyse rows from any source.
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
