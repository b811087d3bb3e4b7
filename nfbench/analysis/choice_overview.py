"""Answers to the requests that most readers of a study have: each target, several limits, and each swept point."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from .choice import judge, place_text
from .choice_answer import STEPS, Choice, answer, recommended_row
from .choice_costs import Points, Request

__all__ = ["Overview", "overview"]

RUNGS = 7  # rows of a ladder
ROUND = (1, 2, 5)  # times powers of ten, the limits


@dataclass(frozen=True, eq=False)
class Overview:
    """What a study recommends for one target. Each row of the tables answers a request of its own.

    choice: the answer without a limit. ladder: what would be recommended within round limits, up to the one that gives
    the same as no limit: ``limit`` in the unit of the choice, and ``setting``, ``verdict``, ``share`` and ``budget`` as
    in ``Choice.steps``. A limit that gives the answer of the one before, or within which no scene is solved, has no
    row. Limits of evaluations are for methods that make any. solvers: the same in evaluations among the methods that
    make any, if the unit of the choice is "s" because others make none. places: what would be recommended at each swept
    point alone: ``place`` instead of ``limit``; empty if there is one point.
    """

    choice: Choice
    ladder: pd.DataFrame
    solvers: pd.DataFrame
    places: pd.DataFrame


def overview(points: Mapping[str, Points], target: str, request: Request, notes: Sequence[str] = ()) -> Overview:
    """Return what a study recommends for a target. The arguments are those of ``answer``."""
    choice = answer(points, target, request, notes)
    own = points[target]
    solving, timed = _with_evaluations(own), choice.request.in_seconds
    places = [(place_text(swept), *recommended_row(judge([(swept, cells)], choice.request))) for swept, cells in own]
    return Overview(
        choice,
        _ladder(own if timed else solving, choice.request),
        _ladder(solving if timed and not request.in_seconds else [], request),
        pd.DataFrame(places if len(own) > 1 else [], columns=["place", *STEPS[1:]]),
    )


def _with_evaluations(points: Points) -> Points:
    """The methods that make evaluations."""
    return [
        (swept, {method: cell for method, cell in cells.items() if cell.end_evaluations.any()})
        for swept, cells in points
    ]


def _ladder(points: Points, request: Request) -> pd.DataFrame:
    rows: list[tuple[Any, ...]] = []
    limits = _limits(points, request)
    last = recommended_row(judge(points, request)) if limits else ()
    for limit in limits:
        row = recommended_row(judge(points, _limited(request, limit)))
        if row[2] > 0 and (not rows or row[:3] != rows[-1][1:4]):
            rows.append((limit, *row))
        if row[:3] == last[:3]:
            break
    return pd.DataFrame(rows[-RUNGS:], columns=["limit", *STEPS[1:]])


def _limited(request: Request, limit: float) -> Request:
    return replace(request, seconds=limit) if request.in_seconds else replace(request, evaluations=limit)


def _limits(points: Points, request: Request) -> list[float]:
    """Round limits, from the smallest median cost of the hits of a method to the largest cost of a run."""
    low, high = math.inf, 0.0
    for ends, hits in _costs(points, request):
        low, high = min(low, hits), max(high, ends)
    if not 0 < low <= high:
        return []
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    rungs = [float(f"{factor}e{k}") for k in exponents for factor in ROUND]
    return [*(rung for rung in rungs if low <= rung < high), high]


def _costs(points: Points, request: Request) -> Iterator[tuple[float, float]]:
    """The largest cost of a run of each method at each point, and the median cost of its hits."""
    for _, cells in points:
        for cell in cells.values():
            if request.in_seconds:
                cost_s = request.evaluation_cost_s
                ends, hits = cell.seconds(cost_s, end=True), cell.seconds(cost_s)[cell.hit]
            else:
                ends, hits = cell.end_evaluations, cell.evaluations[cell.hit]
            if hits.size and (hits > 0).all():
                yield float(ends.max()), float(np.median(hits))
