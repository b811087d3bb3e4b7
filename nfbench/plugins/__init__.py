"""Plugins: finding them, grouping solvers, nesting solvers in each other, and writing new plugins from templates."""

from __future__ import annotations

from .containment import Containment, moved_up
from .description import description
from .groups import GROUPS, members
from .nested import (
    NestedFormulation,
    NestedSolver,
    combined_info,
    formulation_of,
    nested_formulation,
    nested_solver,
    run_part,
    solver_of,
    versions,
)
from .registry import CONTRACTS, Plugin, Registry
from .rehearsal import rehearse
from .templates import write_template

__all__ = [
    "CONTRACTS",
    "GROUPS",
    "Containment",
    "NestedFormulation",
    "NestedSolver",
    "Plugin",
    "Registry",
    "combined_info",
    "description",
    "formulation_of",
    "members",
    "moved_up",
    "nested_formulation",
    "nested_solver",
    "rehearse",
    "run_part",
    "solver_of",
    "versions",
    "write_template",
]
