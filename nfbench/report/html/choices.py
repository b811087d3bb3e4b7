"""What the page recommends for what a reader can spend: the answers of ``nfbench choose`` to a few requests."""

from __future__ import annotations

import math
import shlex
from typing import Any

import pandas as pd

from nfbench.analysis import Overview, time_text
from nfbench.core import printable
from nfbench.results import overviews

from ..choice import WORDS, amount
from ..terminal import number_text
from .study import Study

__all__ = ["choices"]

RELIABILITY = 0.95
TARGETS = 4  # answers in a page
METHODS = 8  # rows of a table of methods


def choices(study: Study) -> list[dict[str, Any]]:
    """The answer for each target: its sentences, tables of texts, and the command that asks for more.

    Nothing is recommended for a gap unless the gaps of all methods compare.
    """
    found = overviews(study.evidence, RELIABILITY, study.setting)
    fit = [each for each in found if study.gaps_compare or not each.choice.target.startswith("gap")]
    fit = [each for each in fit if len(each.choice.frame)]
    return [_shown(study, each) for each in fit[:TARGETS]]


def _shown(study: Study, found: Overview) -> dict[str, Any]:
    choice = found.choice
    rows = choice.frame.head(METHODS).to_dict("records")
    name = printable(study.meta["name"])
    target = study.goal(choice.target)
    hits = set(study.evidence.hits.notes)
    return {
        "target": printable(target),
        "wanted": f"{100 * choice.request.reliability:.4g} %",
        "first": printable(choice.sentences[0]).replace(printable(choice.target), printable(target)),
        "more": [printable(text) for text in choice.sentences[1:]],
        "notes": [printable(note) for note in choice.notes if note not in hits],
        "unit": "time" if choice.unit == "s" else "evaluations",
        "swept": len(study.points) > 1,
        "methods": [_method(row, choice.unit) for row in rows],
        "left": len(choice.frame) - len(rows),
        "ladder": _ladder(found.ladder, choice.unit),
        "solvers": _ladder(found.solvers, "evaluations"),
        "places": [{"where": printable(row["place"]), **_step(row, choice.unit)} for row in _rows(found.places)],
        "prices": _prices(choice.prices),
        "command": printable(
            f"nfbench choose {shlex.quote('results/' + name)} --target {shlex.quote(printable(choice.target))}"
        ),
    }


def _ladder(frame: pd.DataFrame, unit: str) -> list[dict[str, str]]:
    return [{"where": amount(row["limit"], unit), **_step(row, unit)} for row in _rows(frame)]


def _rows(frame: pd.DataFrame) -> list[dict[Any, Any]]:
    return frame.to_dict("records")


def _method(row: dict[Any, Any], unit: str) -> dict[str, Any]:
    low, high = row["budget_low"], row["budget_high"]
    known = math.isfinite(low) and math.isfinite(row["budget"])
    ends = f"{amount(low, unit)} – {amount(high, unit) if math.isfinite(high) else '?'}" if known else ""
    return {
        "cheapest": bool(row["cheapest"]),
        "interval": f"{100 * row['share_low']:.0f} – {100 * row['share_high']:.0f} %",
        "worst": printable(row["worst"]),
        "ends": ends,
        **_step(row, unit),
    }


def _step(row: dict[Any, Any], unit: str) -> dict[str, str]:
    return {
        "method": printable(row["setting"]),
        "verdict": WORDS.get(row["verdict"], "no"),
        "share": "–" if math.isnan(row["share"]) else f"{100 * row['share']:.0f} %",
        "needed": amount(row["budget"], unit, up=True),
    }


def _prices(prices: pd.DataFrame) -> list[tuple[str, str]]:
    """From which time of an evaluation on a method needs the least time."""
    found = []
    for i, row in enumerate(_rows(prices)):
        low, high = (time_text(float(number_text(row[name]).replace(",", "")) / 1e6) for name in ("from_us", "to_us"))
        where = "any" if len(prices) == 1 else f"over {low}" if i == len(prices) - 1 else f"{low} – {high}"
        found.append((where if i or len(prices) == 1 else f"up to {high}", printable(row["setting"])))
    return found
