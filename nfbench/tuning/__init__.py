"""Searches a solver's options on training scenes and judges the result on held-out ones."""

from __future__ import annotations

from .search_space import Domain, domains
from .tuning import Plan, Trial, Tuning, tune

__all__ = ["Domain", "Plan", "Trial", "Tuning", "domains", "tune"]
