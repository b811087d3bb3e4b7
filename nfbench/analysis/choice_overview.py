"""Answers to the requests that most readers of a study have: each target, several limits, and each swept point."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from .choice import judge, place_text
from .choice_answer import STEPS, Choice, answer, recommended_row
from .choice_costs import Points, Request

__all__ = ["Overview", "overview"]

RUNGS = 7  # limits of a ladder
ROUND = (1.0, 2.0, 5.0)  # times powers of ten, the limits


@dataclass(frozen=True, eq=False)
class Overview:
    """What a study recommends for one target.

    choice: the answer without a limit. ladder: what would be recommended within each of some limits, which are round
    numbers up to the largest budget: ``limit`` in the unit of the choice, and ``setting``, ``verdict``, ``share`` and
    ``budget`` as in ``Choice.steps``. A limit that gives the answer of the one before has no row. places: the same at
    each swept point alone: ``place`` instead of ``limit``; empty if there is one point. Each row of both is a request
    of its own.
    """

    choice: Choice
    ladder: pd.DataFrame
    places: pd.DataFrame


def overview(points: Mapping[str, Points], target: str, request: Request, notes: Sequence[str] = ()) -> Overview:
    """Return what a study recommends for a target. The arguments are those of ``answer``."""
    choice = answer(points, target, request, notes)
    own = points[target]
    rungs = [(limit, *recommended_row(judge(own, _limited(choice, limit)))) for limit in _limits(own, choice)]
    rungs = [row for i, row in enumerate(rungs) if not i or row[1:4] != rungs[i - 1][1:4]]
    places = [(place_text(swept), *recommended_row(judge([(swept, cells)], choice.request))) for swept, cells in own]
    return Overview(
        choice,
        pd.DataFrame(rungs, columns=["limit", *STEPS[1:]]),
        pd.DataFrame(places if len(own) > 1 else [], columns=["place", *STEPS[1:]]),
    )


def _limited(choice: Choice, limit: float) -> Request:
    given = choice.request
    evaluations, seconds = (given.evaluations, limit) if choice.unit == "s" else (limit, given.seconds)
    return Request(
        evaluations,
        seconds,
        given.evaluation_cost_s,
        given.reliability,
        given.parallel,
        given.confidence,
        given.timed,
    )


def _limits(points: Points, choice: Choice) -> list[float]:
    """Round limits from that of the cheapest first hits to the largest cost of a run, at most ``RUNGS`` of them."""
    low, high = math.inf, 0.0
    for ends, hits in _costs(points, choice):
        low, high = min(low, hits), max(high, ends)
    if not 0 < low <= high:
        return []
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    rungs = [float(f"{factor * 10.0**k:.12g}") for k in exponents for factor in ROUND]
    rungs = [rung for rung in rungs if low <= rung < high]
    top = float(high) if choice.unit == "evaluations" else next(
        float(f"{factor * 10.0**k:.12g}") for k in exponents for factor in (*ROUND, 10.0) if factor * 10.0**k >= high
    )
    return [*rungs[len(rungs) - RUNGS + 1 if len(rungs) >= RUNGS else 0 :], top]


def _costs(points: Points, choice: Choice) -> Iterator[tuple[float, float]]:
    """The largest cost of a run of each method at each point, and the smallest median cost of its hits."""
    for _, cells in points:
        for cell in cells.values():
            if choice.unit == "s":
                cost_s = choice.request.evaluation_cost_s
                ends, hits = cell.seconds(cost_s, end=True), cell.seconds(cost_s)[cell.hit]
            else:
                ends, hits = cell.end_evaluations, cell.evaluations[cell.hit]
            hits = hits[hits > 0]
            if hits.size:
                yield float(ends.max()), float(np.median(hits))
