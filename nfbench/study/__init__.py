"""Studies: reading a manifest, planning its runs, and describing each run as plain data."""

from __future__ import annotations

from .manifest import load_scenarios, load_study
from .plan import Study
from .records import Method, PluginSpec, Point, RunRecord, RunSpec
from .resolve import ErrorCollector, Resolved, Resolver

__all__ = [
    "ErrorCollector",
    "Method",
    "PluginSpec",
    "Point",
    "Resolved",
    "Resolver",
    "RunRecord",
    "RunSpec",
    "Study",
    "load_scenarios",
    "load_study",
]
