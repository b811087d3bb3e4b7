"""Keeps what was computed from all traces of a folder in a file, so that it is computed once.

The file is never needed: one that is damaged, of other runs or cannot be written is ignored.
"""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy import ndarray

from .folder import write_whole

__all__ = ["FILE", "Found", "read", "write"]

FILE = "hits.npz"
_LARGEST = 2**30  # bytes
_KINDS = {"kept": "b", "hit": "b", "evaluations": "f", "seconds": "f", "spent": "f", "gap": "f", "best": "f"}


@dataclass
class Found:
    """What the traces of a folder say about each run and target, in the order of the runs; arrays (runs, targets).

    kept: whether there is a row for this run and target.
    hit: whether the run reached the target.
    evaluations: evaluations to the hit; inf without one.
    seconds: seconds to the hit; inf without one.
    spent: evaluations at the end of the run on the problems that the target is about.
    gap: gap of the run's first problem at its end, (runs,); NaN where there is none.
    best: best value of the run's first problem, (runs,), also of runs that are not ok; NaN where there is none.
    notes: sentences about what could not be computed along the traces.
    reasons: what was not available, as in ``Redrawing.reasons``.
    """

    kept: ndarray
    hit: ndarray
    evaluations: ndarray
    seconds: ndarray
    spent: ndarray
    gap: ndarray
    best: ndarray
    notes: list[str] = field(default_factory=list)
    reasons: dict[str, str] = field(default_factory=dict)

    @classmethod
    def empty(cls, runs: int, targets: int) -> Found:
        """No hit of any run."""
        shape = (runs, targets)
        kept, hit = np.ones(shape, dtype=bool), np.zeros(shape, dtype=bool)
        never, nothing = np.full(shape, np.inf), np.full(runs, np.nan)
        return cls(kept, hit, never, never.copy(), np.zeros(shape), nothing, nothing.copy())


def read(folder: Path, key: str, shape: tuple[int, int]) -> Found | None:
    """What the file in the folder holds for this key and (runs, targets); None if there is no such file."""
    path = folder / FILE
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            return None
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            head = json.loads(arrays["head"].tobytes())
            if head["key"] != key:
                return None
            found = {name: arrays[name] for name in _KINDS}
        shapes = {name: shape[:1] if name in ("gap", "best") else shape for name in _KINDS}
        if any(found[name].shape != shapes[name] or found[name].dtype.kind != _KINDS[name] for name in _KINDS):
            return None
        notes, reasons = head["notes"], head["reasons"]
        texts = [*notes, *reasons, *reasons.values()]
        return Found(**found, notes=notes, reasons=reasons) if all(isinstance(text, str) for text in texts) else None
    except Exception:  # any damage
        return None


def write(folder: Path, key: str, found: Found) -> None:
    """Write the file, if the folder can be written."""
    head = json.dumps({"key": key, "notes": found.notes, "reasons": found.reasons}).encode()

    def save(draft: Path) -> None:
        with draft.open("wb") as file:
            arrays = {name: getattr(found, name) for name in _KINDS}
            np.savez_compressed(file, head=np.frombuffer(head, dtype=np.uint8), **arrays)

    if os.access(folder, os.W_OK):
        with contextlib.suppress(Exception):
            write_whole(folder / FILE, save)
