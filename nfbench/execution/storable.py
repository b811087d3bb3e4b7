"""Makes what a plugin returned storable: plain real numbers and printable text, or a run that is invalid."""

from __future__ import annotations

import math
import numbers
import operator
from collections.abc import Mapping
from typing import Any

import numpy as np

from nfbench.core import Reference, printable

__all__ = [
    "PROVEN",
    "RESERVED",
    "Unstorable",
    "plain_columns",
    "plain_estimate",
    "plain_positions",
    "plain_reference",
    "plain_scores",
]

LARGEST = 100_000  # numbers in an estimate
MOST_SCORES = 10_000  # those of 1,000 sources in space are about 8,000
NAME_LENGTH = 64
RESERVED = frozenset(
    (
        *("run_id", "study", "scenario", "formulation", "solver", "repetition", "scene", "run"),
        *("status", "message", "objective"),
        *("evaluations", "runtime_s", "cpu_s", "instance_seed", "solver_seed", "method", "host", "worker", "finished"),
        *("target_reached", "optimum", "gradients", "error_in_bounds"),
        *("evaluation_s", "batches", "batched"),
    )
)  # columns that a score must not replace


PROVEN = ("gap", "certified", "step")  # what every proof says beside its value
_OF_REFERENCES = frozenset((*PROVEN, "reference_id", "value", "seconds", "best_found", "contradicted_by"))


class Unstorable(Exception):
    """What a plugin returned cannot be a row; the message names what was expected and what came."""


def plain_estimate(found: Any) -> np.ndarray:
    """The estimate as an array of real numbers. Raises Unstorable for anything else."""
    try:
        estimate = np.asarray(found)
    except Exception as error:  # a ragged list, or an object whose __array__ raises
        raise Unstorable(f"estimate: expected an array of real numbers, got {type(found).__name__}: {error}") from error
    if estimate.dtype.kind not in "fiub":
        raise Unstorable(f"estimate: expected an array of real numbers, got one of type {estimate.dtype}")
    if estimate.size > LARGEST:
        raise Unstorable(f"estimate: expected at most {LARGEST:,} numbers, got {estimate.size:,}")
    return estimate.astype(np.float64) if estimate.dtype.kind == "f" else estimate


def plain_positions(found: Any) -> tuple[list[list[float]], list[list[float]]] | None:
    """True and estimated positions as lists of points, None if there are none. Raises Unstorable for anything else."""
    if found is None:
        return None
    if not isinstance(found, tuple | list) or len(found) != 2:
        raise Unstorable(f"positions: expected two arrays or None, got {type(found).__name__}")
    truth, estimated = (plain_estimate(part).astype(np.float64) for part in found)
    if truth.ndim != 2 or estimated.ndim != 2 or truth.shape[1] not in (3, 6) or estimated.shape[1] != truth.shape[1]:
        text = f"got {truth.shape} and {estimated.shape}"
        raise Unstorable(f"positions: expected two arrays of points (x, 3), or (x, 6) with angles and range, {text}")
    if len(estimated) < len(truth):
        raise Unstorable(f"positions: expected at least {len(truth)} estimates, one per source, got {len(estimated)}")
    return truth.tolist(), estimated.tolist()


def plain_reference(found: Reference) -> tuple[float, dict[str, float], np.ndarray | None]:
    """The value of a proof, its other numbers by column name, and its point. Raises Unstorable if it is impossible."""
    value, gap, step = _number("value", found.value), _number("gap", found.gap), _number("step", found.step)
    if not math.isfinite(value):
        raise Unstorable(f"reference: expected a finite value, got {value}")
    if not gap >= 0.0 or (found.certified and math.isinf(gap)):
        raise Unstorable(f"reference: expected a gap >= 0, finite if it is certified, got {gap}")
    if not isinstance(found.certified, bool | np.bool_) or not step >= 0 or step != int(step):
        raise Unstorable(f"reference: expected certified true or false and a step >= 0, got {found!r:.200}")
    columns = plain_scores(found.columns)
    if taken := sorted(name for name in columns if name in _OF_REFERENCES or name.startswith("x_")):
        raise Unstorable(f"columns of the reference: {taken[0]!r} is the name of another column; use a name of its own")
    point = None if found.point is None else plain_estimate(found.point)
    if point is not None and (point.ndim != 1 or not np.isfinite(point).all()):
        raise Unstorable(f"reference: expected a finite point (n,), got the shape {point.shape}")
    return value, {"gap": gap, "certified": float(found.certified), "step": step, **columns}, point


def plain_scores(found: Any) -> dict[str, float]:
    """Scores as numbers by column name. Raises Unstorable for anything else."""
    if not isinstance(found, Mapping):
        raise Unstorable(f"score: expected a dict of numbers by column name, got {type(found).__name__}")
    if len(found) > MOST_SCORES:
        raise Unstorable(f"score: expected at most {MOST_SCORES:,} columns, got {len(found):,}")
    return {_name(name): _number(name, value) for name, value in found.items()}


def plain_columns(found: Any, scores: Mapping[str, float]) -> dict[str, float]:
    """The columns of a Solution as numbers by name. Raises Unstorable for anything else, and for a score's name."""
    columns = plain_scores(found)
    if taken := sorted(columns.keys() & scores.keys()):
        raise Unstorable(f"columns of the solution: {taken[0]!r} is the name of a score; use a name of its own")
    return columns


def _name(name: Any) -> str:
    if not isinstance(name, str) or not name or len(name) > NAME_LENGTH or printable(name) != name:
        raise Unstorable(f"score: expected column names of 1 to {NAME_LENGTH} printable characters, got {name!r:.200}")
    if name in RESERVED or name.startswith(("scenario.", "budget.")):
        raise Unstorable(f"score: {name!r} is the name of another column; use a name of its own")
    return str(name)


def _number(name: Any, value: Any) -> float:
    if isinstance(value, np.ndarray | np.generic) and np.ndim(value) == 0:
        value = value.item()
    if not isinstance(value, numbers.Real):
        raise Unstorable(f"score: expected a real number for {name!r}, got {type(value).__name__}")
    try:
        return float(value)
    except OverflowError:  # an integer or fraction beyond any float
        return math.inf if operator.gt(value, 0) else -math.inf
