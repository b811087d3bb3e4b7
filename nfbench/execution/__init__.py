"""Runs the plan of a study: in this process, in worker processes, or on a cluster."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .compile_ahead import warm_up
    from .dry_check import dead_formulations, refuse_dead
    from .engine import RunAll, ordered_runner, run_specs
    from .landscape import first_problem, landscape_table, write_landscape
    from .localization import localize
    from .procedures import Procedure, procedure, recommended
    from .run_study import Listener, run

__all__ = [
    "Listener",
    "Procedure",
    "RunAll",
    "dead_formulations",
    "first_problem",
    "landscape_table",
    "localize",
    "ordered_runner",
    "procedure",
    "recommended",
    "refuse_dead",
    "run",
    "run_specs",
    "warm_up",
    "write_landscape",
]

_MODULES = {
    "Listener": "run_study",
    "Procedure": "procedures",
    "RunAll": "engine",
    "dead_formulations": "dry_check",
    "first_problem": "landscape",
    "landscape_table": "landscape",
    "localize": "localization",
    "ordered_runner": "engine",
    "procedure": "procedures",
    "recommended": "procedures",
    "refuse_dead": "dry_check",
    "run": "run_study",
    "run_specs": "engine",
    "warm_up": "compile_ahead",
    "write_landscape": "landscape",
}


def __getattr__(name: str) -> Any:
    """Import on first use: worker processes import this package but need neither the engine nor pandas."""
    if name in _MODULES:
        return getattr(importlib.import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
