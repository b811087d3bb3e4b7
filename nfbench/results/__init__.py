"""Stores the rows and traces of a study, and reads, merges, compares and exports them."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .cells import cell, csv_frame, from_cell
from .folder import locked, network_file_system, prepare, write_whole
from .results import Results
from .store import Store

if TYPE_CHECKING:
    from .choosing import choose, overviews
    from .comparison import Comparison, compare
    from .evidence import Evidence
    from .export_as_coco import export_coco
    from .export_as_csv import export_csv
    from .export_as_ioh import export_ioh
    from .export_as_parquet import export_parquet
    from .hits import Hits, Progress, find_hits, find_progress, find_progresses, targets_of
    from .merging import merge, missing_shards
    from .redrawing import Redrawing
    from .references import label_of

__all__ = [
    "Comparison",
    "Evidence",
    "Hits",
    "Progress",
    "Redrawing",
    "Results",
    "Store",
    "cell",
    "choose",
    "compare",
    "csv_frame",
    "export_coco",
    "export_csv",
    "export_ioh",
    "export_parquet",
    "find_hits",
    "find_progress",
    "find_progresses",
    "from_cell",
    "label_of",
    "locked",
    "merge",
    "missing_shards",
    "network_file_system",
    "overviews",
    "prepare",
    "targets_of",
    "write_whole",
]

_MODULES = {
    "choose": "choosing",
    "overviews": "choosing",
    "Comparison": "comparison",
    "compare": "comparison",
    "Evidence": "evidence",
    "Hits": "hits",
    "Progress": "hits",
    "find_hits": "hits",
    "find_progress": "hits",
    "find_progresses": "hits",
    "targets_of": "hits",
    "export_coco": "export_as_coco",
    "export_csv": "export_as_csv",
    "export_ioh": "export_as_ioh",
    "export_parquet": "export_as_parquet",
    "Redrawing": "redrawing",
    "label_of": "references",
    "merge": "merging",
    "missing_shards": "merging",
}


def __getattr__(name: str) -> Any:
    """Import what needs pandas on first use: pandas is slow to import, and ``nfbench status`` does not need it."""
    if name in _MODULES:
        return getattr(importlib.import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
