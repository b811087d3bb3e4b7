"""Studies: reading a manifest, planning its runs, and describing each run as plain data."""

from __future__ import annotations

from .axis_labels import read_labels
from .claims import Claim, Compare, Names, claim_of
from .manifest import load_methods, load_scenarios, load_study, scene_numbers
from .plan import Study, scene_seed, seed_from
from .reading import MANIFEST_FOLDER
from .records import Method, PluginSpec, Point, RunRecord, RunSpec, swept_column
from .resolve import ErrorCollector, Resolved, Resolver

__all__ = [
    "MANIFEST_FOLDER",
    "Claim",
    "Compare",
    "ErrorCollector",
    "Method",
    "Names",
    "PluginSpec",
    "Point",
    "Resolved",
    "Resolver",
    "RunRecord",
    "RunSpec",
    "Study",
    "claim_of",
    "load_methods",
    "load_scenarios",
    "load_study",
    "read_labels",
    "scene_numbers",
    "scene_seed",
    "seed_from",
    "swept_column",
]
