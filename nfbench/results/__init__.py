"""Stores the rows and traces of a study, and reads, merges, compares and exports them."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .cells import cell, from_cell
from .folder import locked, network_file_system, prepare, write_whole
from .results import Results
from .store import Store

if TYPE_CHECKING:
    from .comparison import Comparison, compare
    from .export import export_csv, export_ioh
    from .merging import merge, missing_shards

__all__ = [
    "Comparison",
    "Results",
    "Store",
    "cell",
    "compare",
    "export_csv",
    "export_ioh",
    "from_cell",
    "locked",
    "merge",
    "missing_shards",
    "network_file_system",
    "prepare",
    "write_whole",
]

_MODULES = {
    "Comparison": "comparison",
    "compare": "comparison",
    "export_csv": "export",
    "export_ioh": "export",
    "merge": "merging",
    "missing_shards": "merging",
}


def __getattr__(name: str) -> Any:
    """Import what needs pandas on first use: pandas is slow to import, and ``nfbench status`` does not need it."""
    if name in _MODULES:
        return getattr(importlib.import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
