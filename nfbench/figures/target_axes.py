"""The hits and the axis of cost that figures about the way to a target share."""

from __future__ import annotations

from typing import Any

import pandas as pd

from nfbench.analysis import Axis, Target
from nfbench.core import NfbenchError

from .data import Drawn
from .drawing import Drawing, NotDrawnError

__all__ = ["AXIS_LABELS", "axis_of", "gap_note", "hits_on", "reached", "target_of"]

AXIS_LABELS: dict[Axis, str] = {
    "evaluations": "Evaluations",
    "evaluation_equivalents": "Evaluation equivalents",
    "seconds": "Run time [s]",
}


def axis_of(study: Drawn, how: Drawing) -> Axis:
    """The axis that was asked for, else evaluations. Raises NotDrawnError if no method makes evaluations."""
    axis = how.axis or "evaluations"
    if axis != "seconds" and not (study.runs["evaluations"] > 0).any():
        raise NotDrawnError(f"no method makes evaluations, so there are no {axis.replace('_', ' ')}; use seconds")
    return axis


def target_of(study: Drawn, wanted: int | str | None) -> Target | None:
    """The target of that label or number from 1; None if none is wanted. Raises NfbenchError if there is none."""
    targets = study.evidence.targets
    if wanted is None:
        return None
    text = str(wanted).strip()
    for number, target in enumerate(targets, start=1):
        if text in (str(number), target.label, target.label.replace("≤", "<=")):
            return target
    known = ", ".join(f"{number} ({target.label})" for number, target in enumerate(targets, start=1))
    raise NfbenchError(f"target: expected one of {known}, got {text!r}")


def gap_note(study: Drawn, hits: pd.DataFrame) -> str:
    """What gaps are measured from, for the end of a sentence about the targets; empty if none of them is a gap."""
    labels = [target.label for target in study.evidence.targets if target.kind == "gap"]
    gaps = hits[hits["target"].isin(labels)]
    return f"gap to the {study.evidence.origin_of_gaps(gaps['run_id'])}" if len(gaps) else ""


def hits_on(study: Drawn, axis: Axis, target: Target | None) -> pd.DataFrame:
    """The hits of the methods that have a cost on this axis, of one target or of all.

    Every row has the cap and the longest run of its swept point, so that curves of some methods end where those of
    all methods do. Raises NotDrawnError if nothing is left.
    """
    hits: pd.DataFrame = study.evidence.hits.frame
    if target is not None:
        hits = hits[hits["target"] == target.label]
    if axis != "seconds":
        making = hits.groupby("method")["spent"].max()
        hits = hits[hits["method"].isin(making.index[making > 0])]
    if hits.empty:
        raise NotDrawnError("no target applies to a run")
    points: Any = [hits[name] for name in study.swept] or [pd.Series(0, hits.index)]
    caps = hits["cap"].where(hits["cap"] > 0).groupby(points, dropna=False).transform("min")
    longest = hits["spent_s"].groupby(points, dropna=False).transform("max")
    return hits.assign(common_cap=caps.fillna(0.0), common_s=longest)


def reached(study: Drawn, hits: pd.DataFrame) -> tuple[list[Drawn], str]:
    """The swept points at which some run reaches a target, and a sentence about the others, if there are any.

    Raises NotDrawnError if there is none.
    """
    parts = study.by(study.swept)
    found = [part for part in parts if part.at(hits)["hit"].any()]
    if not found:
        raise NotDrawnError("no run reaches a target")
    without = len(parts) - len(found)
    return found, f"reached by no run at {without} of {len(parts)} swept points" if without else ""
