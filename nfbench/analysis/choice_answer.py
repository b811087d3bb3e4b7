"""The answer to a request: the recommended method, its alternatives, and what another request would give."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from .choice import EVERYWHERE, LIKELY, MEETS, MISSES, Verdict, judge, price_changes
from .choice_costs import Points, Request
from .sentences import names, time_text

__all__ = ["STEPS", "Choice", "answer", "recommended_row"]

STEPS = ["change", "setting", "verdict", "share", "budget"]  # columns of Choice.steps


@dataclass(frozen=True, eq=False)
class Choice:
    """Which methods meet a request, and what another request would give.

    target: label of the target. request: the request. frame: one row per method and number of starts, as ``Verdict``
    describes it; budgets are in ``unit``, "evaluations" or "s". steps: what changes of the request would give, one row
    each: ``change``, ``setting``, ``verdict``, ``share`` and ``budget`` of what would be recommended then. prices:
    which setting needs the least time as a function of the time of one evaluation: ``from_us``, ``to_us``,
    ``setting`` and ``budget_s``; empty if times are not known. sentences: the answer in words. notes: what the reader
    must know about how the answer was found.
    """

    target: str
    request: Request
    unit: str
    frame: pd.DataFrame
    steps: pd.DataFrame
    prices: pd.DataFrame
    sentences: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def recommended(self) -> str | None:
        """The method to use, with its number of starts if there are several; None if no method meets the request."""
        return str(self.frame["setting"].iloc[0]) if self.met else None

    @property
    def met(self) -> bool:
        """Whether a method meets the request in this study."""
        return len(self.frame) > 0 and self.frame["verdict"].iloc[0] != MISSES

    @property
    def sure(self) -> bool:
        """Whether a method meets the request with the wanted confidence."""
        return len(self.frame) > 0 and self.frame["verdict"].iloc[0] == MEETS

    def to_dict(self) -> dict[str, Any]:
        """The choice as what JSON can hold; numbers that are not finite are None."""
        request = {
            name: getattr(self.request, name) for name in ("evaluations", "reliability", "parallel", "confidence")
        }
        request["time_ms"] = None if self.request.seconds is None else 1e3 * self.request.seconds
        cost_s = self.request.evaluation_cost_s
        request["evaluation_cost_us"] = None if cost_s is None else 1e6 * cost_s
        return {
            "target": self.target,
            "request": request,
            "recommended": self.recommended,
            "sure": self.sure,
            "unit": self.unit,
            "methods": _records(self.frame),
            "steps": _records(self.steps),
            "prices": _records(self.prices),
            "answer": list(self.sentences),
            "notes": list(self.notes),
        }


def _records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    def plain(value: Any) -> Any:
        value = value.item() if isinstance(value, np.generic) else value
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return [{str(name): plain(value) for name, value in row.items()} for row in frame.to_dict("records")]


def answer(points: Mapping[str, Points], target: str, request: Request, notes: Sequence[str] = ()) -> Choice:
    """Return the answer to a request.

    points: by label of a target, as ``cells_of`` returns them: ``target``, and others to compare with, from the first
    to the last in the order of the study.
    """
    notes = list(notes)
    own = points[target]
    if idle := _without_evaluations(own, judge(own, request)):
        who = f"{names(idle)}, which make{'s' * (len(idle) == 1)} no evaluations of a problem,"
        if not request.in_seconds:
            request = replace(request, timed=True)
            notes.append(f"Costs are compared in seconds because of {who.removesuffix(',')}.")
        elif request.evaluation_cost_s is not None:
            notes.append(f"The time of {who} does not depend on the cost of an evaluation.")
    verdict = judge(own, request)
    notes += _any_time(own, verdict, request)
    prices = price_changes(own, request)
    steps = pd.DataFrame(list(_steps(points, target, request, verdict)), columns=STEPS)
    unit = "s" if request.in_seconds else "evaluations"
    words = tuple(_words(verdict, target, unit))
    return Choice(target, request, unit, verdict.frame, steps, prices, words, tuple(notes))


def _without_evaluations(points: Points, verdict: Verdict) -> list[str]:
    """The methods that reach the wanted share without any evaluation."""
    good = verdict.frame.loc[verdict.frame["verdict"] != MISSES, "method"]
    return [m for m in dict.fromkeys(good) if not any(cells[m].end_evaluations.any() for _, cells in points)]


def _any_time(points: Points, verdict: Verdict, request: Request) -> Iterator[str]:
    """Say what was read off the traces of longer runs, and what goes beyond the study."""
    caps = [cell.cap for _, cells in points for cell in cells.values()]
    largest = max(caps, default=0.0)
    limit, row = request.evaluations, verdict.first
    if limit is None or not largest:
        return
    if limit > largest:
        yield f"No method of this study makes more than {largest:,.0f} evaluations; what more would give is not known."
    if row is not None and row["starts"] == 1:
        cap = max(cells[row["method"]].cap for _, cells in points)
        if cap > limit:
            yield (
                f"Read off the traces of runs with up to {cap:,.0f} evaluations. A solver that plans its search for "
                f"its budget may do otherwise with {limit:,.0f}: check with a study that has this budget."
            )


def _steps(points: Mapping[str, Points], target: str, request: Request, verdict: Verdict) -> Iterator[tuple[Any, ...]]:
    """The recommendation for half and twice the limits, and for the other targets."""
    limits = {"evaluations": request.evaluations, "seconds": request.seconds}
    given = [name for name, value in limits.items() if value is not None]
    what = " and ".join("time" if name == "seconds" else name for name in given)
    if given:
        for factor, word in ((0.5, "half the"), (2.0, "twice the")):
            more, longer = (None if value is None else factor * value for value in limits.values())
            changed = replace(request, evaluations=more, seconds=longer)
            yield (f"{word} {what}", *recommended_row(judge(points[target], changed)))
    for label, other in points.items():
        if label != target and other:
            yield (f"target {label}", *recommended_row(judge(other, request)))


def recommended_row(verdict: Verdict) -> tuple[Any, ...]:
    """Return setting, verdict, share and budget of the first row."""
    if verdict.frame.empty:
        return "", MISSES, math.nan, math.nan
    row = verdict.frame.iloc[0]
    return row["setting"], row["verdict"], row["share"], row["budget"]


def _words(verdict: Verdict, target: str, unit: str) -> Iterator[str]:
    """The answer in sentences."""
    request, frame = verdict.request, verdict.frame
    wanted = f"{target} in at least {100 * request.reliability:.4g} % of scenes{_limits(request)}"
    if frame.empty:
        yield "No method of this study has runs for this target at all swept points, so nothing can be recommended."
        return
    first = frame.iloc[0]
    share = f"{100 * first['share']:.4g} %"
    interval = (
        f"{100 * request.confidence:.4g} % interval {100 * first['share_low']:.0f} – {100 * first['share_high']:.0f} %"
    )
    at = f" at {first['worst']}" if first["worst"] else ""
    at += ", the worst swept point" if at and first["worst"] != EVERYWHERE else ""
    if first["verdict"] == MISSES:
        yield f"Nothing in this study reaches {wanted}. The closest is {first['setting']}: {share}{at} ({interval})."
        equal = [row["setting"] for row in frame.to_dict("records")[1:] if row["share"] == first["share"]]
        if equal:
            tied = ", ".join(equal[:3]) + (f" and {len(equal) - 3} more" if len(equal) > 3 else "")
            yield f"The same share is reached by {tied}."
        return
    sure, likely = (int((frame["verdict"] == kind).sum()) for kind in (MEETS, LIKELY))
    if first["verdict"] == MEETS:
        yield f"Use {first['setting']}. It reaches {wanted}: {share} of {verdict.scenes} scenes{at} ({interval})."
    else:
        yield (
            f"Try {first['setting']}. In this study it reaches {wanted}: {share} of {verdict.scenes} scenes{at} "
            f"({interval}). {_too_few(first['more_scenes'], verdict.tested)}."
        )
    yield _budget(first, request, unit)
    rest = frame.loc[frame["cheapest"], "setting"].tolist()[1:]
    if not verdict.ranked:
        yield "There are too few scenes to say which of the methods that meet the request is the cheapest."
    elif rest:
        yield f"Not distinguishable from it in cost: {names(rest)}."
    elif sure + likely > 1 and first["verdict"] == MEETS and sure > 1:
        yield "It is significantly cheaper than every other method that meets the request."
    if first["verdict"] == MEETS and likely:
        more = "1 more method meets it" if likely == 1 else f"{likely} more methods meet it"
        yield f"{more} in this study, but these are too few scenes to be sure."
    elif first["verdict"] == LIKELY and likely > 1:
        yield f"{likely - 1} other{'s' * (likely > 2)} also meet{'s' * (likely == 2)} it in this study."


def _limits(request: Request) -> str:
    limits = []
    if request.evaluations is not None:
        limits.append(f"{request.evaluations:,.6g} evaluations")
    if request.seconds is not None:
        limits.append(time_text(request.seconds))
    text = f" within {' and '.join(limits)}" if limits else ""
    if request.evaluation_cost_s is not None:
        text += f" at {time_text(request.evaluation_cost_s)} per evaluation"
    return text + (f", {request.parallel} of them at once" if request.parallel > 1 else "")


def _too_few(scenes: float, tested: int) -> str:
    """Why it is not sure, and how many more scenes would make it so."""
    reason = "That is too few scenes to be sure"
    if tested > 1:
        reason = f"As {tested} methods are tested at once, that is too few scenes to be sure"
    if math.isnan(scenes):
        return f"{reason}; its share is too close to the wanted one for any number of scenes to make it sure soon"
    return f"{reason}: about {scenes:,.0f} more would be needed if the share stays the same"


def _budget(row: Any, request: Request, unit: str) -> str:
    def amount(value: float) -> str:
        return time_text(value) if unit == "s" else f"{value:,.6g} evaluations"

    share = f"{100 * request.reliability:.4g} %"
    budget = time_text(row["budget"], up=True) if unit == "s" else amount(row["budget"])
    text = f"{share} of the scenes reach the target within {budget}"
    low, high = row["budget_low"], row["budget_high"]
    if math.isnan(low):
        return f"{text}."
    end = amount(high) if math.isfinite(high) else "more than this study can bound"
    start = f"{low:,.6g}" if unit != "s" and math.isfinite(high) else amount(low)
    return f"{text} ({100 * request.confidence:.4g} % interval {start} – {end})."
