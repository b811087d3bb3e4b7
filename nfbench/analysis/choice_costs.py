"""What each run of a study would have cost a user: evaluations and time until a target, at the user's own prices."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from numpy import ndarray

from nfbench.core import OptionError

from .targets import swept_columns

__all__ = ["Cell", "Points", "Request", "Setting", "cells_of", "combined", "settings_of", "within"]

Points: TypeAlias = "Sequence[tuple[dict[str, Any], dict[str, Cell]]]"

MOST_RESTARTS = 8  # runs of a scene among which restarts are chosen


@dataclass(frozen=True)
class Request:
    """What a user can spend, and how often the target must be reached.

    evaluations: most evaluations of a run; None for no limit. seconds: longest time of a run [s]; None for no limit.
    evaluation_cost_s: time of one evaluation of the user's objective [s], which replaces that of the study; None to
    keep it. reliability: share of scenes that must reach the target, between 0 and 1. parallel: evaluations that the
    user can make at the same time. confidence: with which all statements hold together. timed: whether cost means time
    even if nothing else of the request is about time.

    Raises OptionError, a ValueError, for impossible values.
    """

    evaluations: float | None = None
    seconds: float | None = None
    evaluation_cost_s: float | None = None
    reliability: float = 0.95
    parallel: int = 1
    confidence: float = 0.95
    timed: bool = False

    def __post_init__(self) -> None:
        for name in ("evaluations", "seconds", "evaluation_cost_s"):
            value = getattr(self, name)
            if value is not None and not (value >= 0 if name == "evaluation_cost_s" else value > 0):
                raise OptionError("choose", [(name, f"expected a number above 0, got {value}")])
            if value is not None and not math.isfinite(value):
                raise OptionError("choose", [(name, f"expected a finite number, got {value}")])
        for name in ("reliability", "confidence"):
            if not 0 < getattr(self, name) < 1:
                raise OptionError("choose", [(name, f"expected a number between 0 and 1, got {getattr(self, name)}")])
        if self.parallel < 1 or self.parallel != int(self.parallel):
            raise OptionError("choose", [("parallel", f"expected a whole number of at least 1, got {self.parallel}")])

    @property
    def in_seconds(self) -> bool:
        """Whether cost means time."""
        return self.timed or self.seconds is not None or self.evaluation_cost_s is not None or self.parallel > 1


@dataclass(frozen=True)
class Setting:
    """What is compared: a method, started this many times on each scene; the run with the best objective value counts.

    A method that is started once is read at any time: it need not have spent all of its budget.
    """

    method: str
    starts: int = 1

    @property
    def label(self) -> str:
        """The method, with the number of starts if there are several."""
        return self.method if self.starts == 1 else f"{self.method}, best of {self.starts} runs"


@dataclass(frozen=True)
class Cell:
    """The runs of a method at one swept point, for one target: arrays (n, r) of r runs on each of n scenes.

    scenes: numbers of the scenes, (n,). hit: whether the run reached the target. evaluations, overhead_s, paid: what it
    had spent then: evaluations, the solver's own time [s], and evaluations for which time passed one after the other,
    gradients included; ``inside_s`` is the time of these in the study. end_…: the same at the end of the run.
    objective: final value, ∞ for a failed run, NaN where values of different runs must not be compared.
    """

    scenes: ndarray
    hit: Bool[ndarray, "n r"]
    evaluations: Float[ndarray, "n r"]
    overhead_s: Float[ndarray, "n r"]
    inside_s: Float[ndarray, "n r"]
    paid: Float[ndarray, "n r"]
    end_evaluations: Float[ndarray, "n r"]
    end_overhead_s: Float[ndarray, "n r"]
    end_inside_s: Float[ndarray, "n r"]
    end_paid: Float[ndarray, "n r"]
    objective: Float[ndarray, "n r"]
    cap: float

    def seconds(self, cost_s: float | None, *, end: bool = False) -> Float[ndarray, "n r"]:
        """The time until the hit, or the end, if an evaluation takes ``cost_s``; None for the study's own cost."""
        overhead, inside, paid = (
            (self.end_overhead_s, self.end_inside_s, self.end_paid)
            if end
            else (self.overhead_s, self.inside_s, self.paid)
        )
        return overhead + (inside if cost_s is None else paid * cost_s)


def cells_of(rows: pd.DataFrame, parallel: int = 1) -> list[tuple[dict[str, Any], dict[str, Cell]]]:
    """Return (swept values, cells by method) of each swept point, from rows of one target.

    rows: one row per run as ``Hits.frame`` has them, with the further columns ``inside_share``, the share of the time
    spent inside the problem; ``per_evaluation``, what an evaluation costs with its gradients; ``batches`` and
    ``batched``, NaN where not known; ``all_evaluations``, those of the run; and ``objective``.

    Only scenes on which a method has all of its runs count.
    """
    rows = rows.assign(**_times(rows, parallel))
    swept = swept_columns(rows)
    points: dict[tuple[Any, ...], dict[str, Cell]] = {}
    for key, group in rows.groupby([*swept, "method"], sort=False, dropna=False):
        *values, method = key
        points.setdefault(tuple(values), {})[str(method)] = _cell(group)
    return [(dict(zip(swept, values, strict=True)), cells) for values, cells in points.items()]


def _times(rows: pd.DataFrame, parallel: int) -> dict[str, ndarray]:
    """Split the times into the solver's own and those of evaluations, of which a batch shares ``parallel`` workers."""
    column = {name: rows[name].to_numpy(dtype=np.float64) for name in ("evaluations", "seconds", "spent", "spent_s")}
    inside = np.clip(rows["inside_share"].to_numpy(dtype=np.float64), 0.0, 1.0)
    together = _together(rows, parallel)
    each = rows["per_evaluation"].to_numpy(dtype=np.float64) * together
    hit = rows["hit"].to_numpy(dtype=bool)
    found: dict[str, ndarray] = {}
    for prefix, evaluations, seconds in (("", "evaluations", "seconds"), ("end_", "spent", "spent_s")):
        known = hit if not prefix else np.ones(len(rows), dtype=bool)
        spent, time_s = (np.where(known, column[name], 0.0) for name in (evaluations, seconds))
        found |= {
            f"{prefix}evaluations": spent,
            f"{prefix}overhead_s": time_s * (1.0 - inside),
            f"{prefix}inside_s": time_s * inside * together,
            f"{prefix}paid": spent * each,
        }
    return found


def _together(rows: pd.DataFrame, parallel: int) -> ndarray:
    """The share of the time of all evaluations that passes if up to ``parallel`` points of a batch run at once.

    Batches of a run are taken to be equally large; points evaluated one by one gain nothing.
    """
    batches, batched, total = (
        rows[name].to_numpy(dtype=np.float64) for name in ("batches", "batched", "all_evaluations")
    )
    if parallel == 1:
        return np.ones(len(rows))
    with np.errstate(invalid="ignore", divide="ignore"):
        rounds = total - batched + batches * np.ceil(batched / batches / parallel)
        share = np.where(batches > 0, rounds / total, 1.0)
    return np.where(np.isfinite(share), share, 1.0)


def _cell(group: pd.DataFrame) -> Cell:
    scene, labels = pd.factorize(group["scene"], sort=True)
    runs = np.bincount(scene, minlength=len(labels))
    full = runs == runs.max()
    order = np.lexsort((group["run"].to_numpy(), scene))
    order = order[full[scene[order]]]
    shape = (int(full.sum()), int(runs.max()))
    names = [f"{end}{name}" for end in ("", "end_") for name in ("evaluations", "overhead_s", "inside_s", "paid")]
    table = {name: group[name].to_numpy(dtype=np.float64)[order].reshape(shape) for name in (*names, "objective")}
    hit = group["hit"].to_numpy(dtype=bool)[order].reshape(shape)
    return Cell(np.asarray(labels)[full], hit, **table, cap=float(group["cap"].max()))


def within(cell: Cell, starts: int, request: Request) -> tuple[Float[ndarray, "n c"], Float[ndarray, "n c"]]:
    """Return (hits, costs), (n, c), of c ways to start a method this many times on each of n scenes.

    hits: 1 where the target is reached within the limits of the request, else 0. costs: evaluations or seconds that
    this takes; ∞ without a hit.
    """
    if starts == 1:
        hit, evaluations = cell.hit, cell.evaluations
        seconds = cell.seconds(request.evaluation_cost_s)
    else:
        hit, evaluations, seconds = combined(cell, starts, request.evaluation_cost_s)
    inside = hit.copy()
    if request.evaluations is not None:
        inside &= evaluations <= request.evaluations
    if request.seconds is not None:
        inside &= seconds <= request.seconds
    return inside.astype(np.float64), np.where(inside, seconds if request.in_seconds else evaluations, np.inf)


def combined(cell: Cell, starts: int, cost_s: float | None) -> tuple[ndarray, ndarray, ndarray]:
    """Return (hit, evaluations, seconds), (n, c), of all c choices of whole runs of a scene without replacement.

    The run with the smallest objective value decides, the first of equal ones.
    """
    runs = cell.hit.shape[1]
    chosen = np.array(list(itertools.combinations(range(min(runs, MOST_RESTARTS)), starts)))  # (c, starts)
    values = np.where(np.isnan(cell.objective), np.inf, cell.objective)[:, chosen]  # (n, c, starts)
    best = values.argmin(axis=2)[..., None]
    hit = np.take_along_axis(cell.hit[:, chosen], best, axis=2)[..., 0]
    seconds = cell.seconds(cost_s, end=True)[:, chosen].sum(axis=2)
    return hit, cell.end_evaluations[:, chosen].sum(axis=2), seconds


def settings_of(points: Points) -> list[Setting]:
    """Return what is compared: every method with runs at all swept points, started once or, where possible, often."""
    first = points[0][1]
    methods = [method for method in first if all(method in cells for _, cells in points)]
    found = []
    for method in methods:
        cells = [each[method] for _, each in points]
        runs = min(min(cell.hit.shape[1] for cell in cells), MOST_RESTARTS)
        comparable = not any(np.isnan(cell.objective).any() for cell in cells)
        found += [Setting(method, starts) for starts in range(1, runs + 1 if comparable else 2)]
    return found
