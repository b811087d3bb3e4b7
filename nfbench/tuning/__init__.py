"""Searches a solver's options on training scenes and evaluates the result on held-out scenes."""

from __future__ import annotations

from .search_space import Domain, domains
from .tuning import Plan, Trial, Tuning, tune

__all__ = ["Domain", "Plan", "Trial", "Tuning", "domains", "tune"]
