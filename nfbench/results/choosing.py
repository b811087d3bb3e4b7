"""Which method to use for what a user can spend, from the rows and traces in a results folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.analysis import (
    Choice,
    Overview,
    Request,
    Target,
    answer,
    cells_of,
    overview,
    parse_targets,
    same_value,
    swept_columns,
)
from nfbench.core import OptionError, Status, suggest
from nfbench.study import swept_column

from .evidence import Evidence
from .hits import GRADIENT_COST, Hits, find_hits
from .results import Results

__all__ = ["choose", "overviews", "target_named"]

_KINDS = {"error": "error", "gap": "gap", "bounds": "error_in_bounds", "error_in_bounds": "error_in_bounds"}


def choose(
    results: Results | str | Path,
    *,
    target: str | Target | None = None,
    evaluations: float | None = None,
    time_ms: float | None = None,
    evaluation_cost_us: float | None = None,
    reliability: float = 0.95,
    parallel: int = 1,
    at: Mapping[str, Any] | None = None,
    confidence: float = 0.95,
) -> Choice:
    """Return which methods of a study meet a request, and the cheapest of them.

    results: results folder, or its path.
    target: what must be reached: the label of a target, a text such as "error=0.1", "bounds=3" or "gap=1e-4", or a
        Target; None for the first of the study.
    evaluations: most evaluations that may be spent; None for no limit.
    time_ms: longest time [ms]; None for no limit.
    evaluation_cost_us: time of one evaluation of the user's objective [µs], in place of that in the study; the solver's
        own time is kept. None for the study's own.
    reliability: share of scenes that must reach the target.
    parallel: number of evaluations that the user can make at the same time, for solvers that evaluate in batches.
    at: swept values at which the request must be met, e.g. ``{"snr_db": 10}``; None for every swept point.
    confidence: with which all statements hold together.

    Raises OptionError, a ValueError, for impossible values, an unknown target or an unknown swept value, and
    StoreError if the folder holds no results or they are damaged.
    """
    results = results if isinstance(results, Results) else Results(Path(results))
    request = Request(
        evaluations,
        None if time_ms is None else time_ms / 1e3,
        None if evaluation_cost_us is None else evaluation_cost_us / 1e6,
        reliability,
        parallel,
        confidence,
    )
    evidence = results.evidence()
    runs, hits = evidence.runs, evidence.hits
    wanted = target_named(target, evidence.targets)
    if wanted not in evidence.targets:
        extra = find_hits(results, [wanted], runs=runs, cached=False)
        frame = pd.concat([extra.frame, hits.frame], ignore_index=True)
        hits = Hits(frame, (*extra.notes, *hits.notes), hits.gaps, hits.bests)
    rows, notes = _rows(runs, hits, request)
    rows = _chosen(rows, at or {})
    labels = [wanted.label, *(each.label for each in evidence.targets if each != wanted)]
    points = {label: cells_of(rows[rows["target"] == label], parallel) for label in labels}
    return answer(points, wanted.label, request, [*notes, *_about_gaps(wanted, runs), *hits.notes])


def overviews(
    evidence: Evidence, reliability: float = 0.95, named: Callable[[str, Any], str] | None = None
) -> list[Overview]:
    """Return what a study recommends for each of its targets, in their order.

    evidence: the conclusions of the study. reliability: share of scenes that must reach the target.
    named: function that returns a swept value in words such as "SNR = 20 dB", from its key and value; None for those of
        the table.
    """
    request = Request(reliability=reliability)
    labels = [target.label for target in evidence.targets if (evidence.hits.frame["target"] == target.label).any()]
    rows, notes = _rows(evidence.runs, evidence.hits, request)
    rows = _chosen(rows, {})
    points = {label: cells_of(rows[rows["target"] == label]) for label in labels}
    if named is not None:
        points = {label: [(_renamed(swept, named), cells) for swept, cells in each] for label, each in points.items()}
    return [overview(points, label, request, [*notes, *evidence.hits.notes]) for label in labels]


def _renamed(swept: Mapping[str, Any], named: Callable[[str, Any], str]) -> dict[str, Any]:
    texts = (named(key, value).rpartition(" = ")[::2] for key, value in swept.items())
    return dict(texts)


def target_named(target: str | Target | None, known: Sequence[Target]) -> Target:
    """Return the target with a label or in a text such as "error=0.1"; None for the first of the known ones.

    Raises OptionError if there is none.
    """
    if isinstance(target, Target):
        return target
    if target is None:
        if not known:
            raise OptionError("choose", [("target", "the study has no targets; give one such as error=0.1")])
        return known[0]
    for each in known:
        if target.strip() == each.label:
            return each
    kind, sign, value = target.replace("≤", "=").replace("<", "").partition("=")
    kind, value = kind.strip(), value.strip()
    if kind == "error" and value.endswith(("bounds", "bound")):
        kind, value = "bounds", value.removesuffix("s").removesuffix("bound")
    if not sign or kind not in _KINDS:
        hint = suggest(target, [each.label for each in known])
        labels = ", ".join(repr(each.label) for each in known)
        expected = f"expected a target of the study ({labels}), or error=…, bounds=… or gap=… with a number"
        raise OptionError("choose", [("target", f"{expected}, got {target!r}{hint}")])
    try:
        return parse_targets({_KINDS[kind]: float(value)})[0]
    except ValueError as error:
        raise OptionError("choose", [("target", f"expected a number above 0 after {kind}=, got {value!r}")]) from error


def _chosen(rows: pd.DataFrame, at: Mapping[str, Any]) -> pd.DataFrame:
    """The rows at some swept values. A swept budget that is not chosen becomes part of the method."""
    swept = swept_columns(rows)
    for key, value in at.items():
        column = next((name for name in (key, swept_column(key), f"budget.{key}") if name in swept), None)
        if column is None:
            known = ", ".join(swept) or "there are none"
            raise OptionError("choose", [("at", f"expected a swept key ({known}), got {key!r}")])
        kept = [same_value(stored, value) for stored in rows[column]]
        if not any(kept):
            values = ", ".join(map(str, rows[column].unique()))
            raise OptionError("choose", [(f"at.{key}", f"expected one of its swept values ({values}), got {value!r}")])
        rows = rows[kept].drop(columns=column)
    for column in [name for name in swept_columns(rows) if name.startswith("budget.")]:
        named = rows["method"].astype(str) + f" ({column.removeprefix('budget.')} = " + rows[column].map(str) + ")"
        rows = rows.assign(method=named.where(rows["solver"] != "", rows["method"])).drop(columns=column)
        rows = rows.drop_duplicates(["run_id", "target", "method", *swept_columns(rows)])
    return rows


def _about_gaps(target: Target, runs: pd.DataFrame) -> list[str]:
    """A sentence if the target is a gap and there are several formulations, which have different objectives."""
    names = sorted(set(runs["formulation"].dropna()))
    if target.kind != "gap" or len(names) < 2:
        return []
    return [
        f"A gap is that of the first problem of a formulation. It does not compare {', '.join(names)} with each other, "
        "and a method may reach it without finding all sources."
    ]


def _rows(runs: pd.DataFrame, hits: Hits, request: Request) -> tuple[pd.DataFrame, list[str]]:
    """The hits with what is needed to price them, and notes about what had to be estimated."""
    index = pd.Series(np.arange(len(runs)), index=runs["run_id"])
    at = index.loc[hits.frame["run_id"]].to_numpy()
    evaluations = np.nan_to_num(runs["evaluations"].to_numpy(dtype=np.float64))
    gradients = np.nan_to_num(_column(runs, "gradients"))
    batches, batched = _column(runs, "batches"), _column(runs, "batched")
    share, notes = _inside_share(runs, evaluations)
    if request.parallel > 1 and np.isnan(batches[evaluations > 0]).any():
        notes.append(
            "These runs do not say which points were evaluated in batches, so evaluations at once save no time."
        )
    timed = request.seconds is not None or request.evaluation_cost_s is not None or request.parallel > 1
    each = 1.0 + GRADIENT_COST * gradients / np.maximum(evaluations, 1.0)
    if request.evaluation_cost_s is not None and gradients.any():
        notes.append(f"A gradient is taken to cost {GRADIENT_COST:g} evaluations more than its value.")
    columns = {
        "solver": runs["solver"].to_numpy(),
        "inside_share": share,
        "per_evaluation": each,
        "batches": batches,
        "batched": batched,
        "all_evaluations": evaluations,
        "objective": _objectives(runs, hits.bests),
    }
    return hits.frame.assign(**{name: column[at] for name, column in columns.items()}), notes if timed else []


def _column(runs: pd.DataFrame, name: str) -> ndarray:
    return runs[name].to_numpy(dtype=np.float64) if name in runs.columns else np.full(len(runs), math.nan)


def _inside_share(runs: pd.DataFrame, evaluations: ndarray) -> tuple[ndarray, list[str]]:
    """The share of each run's time inside its problems, estimated where it is not recorded."""
    runtime = runs["runtime_s"].to_numpy(dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = _column(runs, "evaluation_s") / runtime
        each = np.where(evaluations > 0, runtime / evaluations, np.nan)
    lacking = np.isnan(share) & (evaluations > 0)
    share = np.where(evaluations > 0, share, 0.0)
    if not lacking.any():
        return share, []
    kinds = [runs[name] for name in ["formulation", *swept_columns(runs)] if not name.startswith("budget.")]
    of_method = pd.Series(each, runs.index).groupby([*kinds, runs["method"]], dropna=False).transform("median")
    fastest = of_method.groupby(kinds, dropna=False).transform("min").to_numpy()
    with np.errstate(invalid="ignore", divide="ignore"):
        estimated = np.clip(fastest * evaluations / runtime, 0.0, 1.0)
    share = np.where(lacking, np.nan_to_num(estimated, nan=1.0), share)
    return share, [
        "The time of evaluations is not recorded for all runs of this study. There it is taken from the fastest method "
        "of the same formulation, so the solvers' own times are lower bounds."
    ]


def _objectives(runs: pd.DataFrame, bests: ndarray | None) -> ndarray:
    """The final objective value of each run, ∞ if it failed; NaN for methods whose runs cannot be compared by it.

    Those are runs that minimize several problems, or none.
    """
    objective = runs["objective"].to_numpy(dtype=np.float64)
    ok = (runs["status"] == Status.OK).to_numpy()
    first = np.full(len(runs), math.nan) if bests is None else bests
    several = ok & ~(np.isclose(first, objective, rtol=1e-9, atol=0.0) & (runs["solver"] != "").to_numpy())
    excluded = pd.Series(several, runs.index).groupby(runs["method"]).transform("any").to_numpy()
    return np.where(excluded, math.nan, np.where(ok, objective, math.inf))
