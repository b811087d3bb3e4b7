"""The log of a study: a file in its results folder that records events with their times."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path

__all__ = ["logging_to"]


@contextlib.contextmanager
def logging_to(path: Path) -> Iterator[logging.Logger]:
    """Yield a logger that appends to ``path`` and writes nowhere else."""
    logger = logging.getLogger(f"nfbench.study.{path}")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    handler = logging.FileHandler(path, encoding="utf-8", delay=True)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger.addHandler(handler)
    try:
        yield logger
    finally:
        logger.removeHandler(handler)
        handler.close()
