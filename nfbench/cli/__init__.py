"""The command line: ``nfbench run STUDY.toml`` and its companions."""

from __future__ import annotations

from .entry import main

__all__ = ["main"]
