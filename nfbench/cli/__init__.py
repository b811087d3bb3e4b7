"""The command line: ``nfbench run STUDY.toml`` and the other commands."""

from __future__ import annotations

from .entry import main

__all__ = ["main"]
