"""When each run reached each target, and how its gap or error fell, from the traces in a results folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.analysis import Target, default_targets, first_reached, reached_for_good, swept_columns
from nfbench.core import Status
from nfbench.plugins import Registry

from . import hit_cache
from .curves import Curve, Curves, scenes_of
from .reader import Reader
from .redrawing import Redrawing
from .references import canonical

__all__ = ["GRADIENT_COST", "Hits", "Progress", "find_hits", "find_progress", "find_progresses", "targets_of"]

VERSION = 3  # of what is computed here; a file of another version is recomputed
GRADIENT_COST = 1.3  # evaluations that a gradient adds; measured 0.9 to 1.8 on ESF and RLS (16 to 128 elements)
KILLED = (Status.TIMEOUT, Status.CRASHED)  # whose evaluations are not known


@dataclass(frozen=True)
class Hits:
    """Which targets each run reached, and when.

    frame: one row per run and target, with the columns below. notes: sentences about what is known only at the end of a
    run, and about scenes and targets that are left out. gaps: gap of each run's first problem at its end, in the order
    of the runs; NaN for runs that are not ok or minimize no problem. bests: best value of each run's first problem, in
    the same order, also of runs that are not ok; NaN where there is none.

    * ``run_id``, ``method``, ``scene``, ``run``, and the swept keys.
    * ``target``: label of the target; ``number``: its position in the list, from 0.
    * ``hit``: whether the run reached it. A run with another status than ok never does. A gap is reached at the first
      evaluation that brings it to the target. An error is reached from the time on at which it stays at the target
      until the end of the run, so that a hit is a final error at the target. Where the error along the run is not
      known, the time is the end of the run.
    * ``evaluations``, ``seconds``, ``evaluation_equivalents``: what the run had spent then; inf without a hit. The
      equivalents add the gradients, each at its cost in evaluations, in proportion to the evaluations.
    * ``spent``, ``spent_s``: evaluations and seconds of the run until its end; for a gap, evaluations of the first
      problem. A killed run, whose evaluations are not known, counts the most that it may have spent.
    * ``cap``: the most evaluations that a run of this method may spend there: its budget, else the most that any of its
      runs at this swept point has spent.
    """

    frame: pd.DataFrame
    notes: tuple[str, ...] = ()
    gaps: ndarray | None = None
    bests: ndarray | None = None


@dataclass(frozen=True)
class Progress:
    """How the gap or the error of each run fell.

    frame: one row per improvement: ``run_id``, ``method``, ``scene``, ``run``, the swept keys, ``evaluations``,
    ``seconds``, ``value`` (gap or error), ``spent`` and ``cap`` as in ``Hits``, and ``at_end``: whether the value
    before this row is not known, because only the final error is. A run that is not ok has one row at its end with the
    value inf. There is no gap for methods without a solver.
    notes: as in ``Hits``.
    """

    frame: pd.DataFrame
    notes: tuple[str, ...] = ()


def targets_of(results: Reader, runs: pd.DataFrame | None = None) -> tuple[Target, ...]:
    """Return the targets of a study: those of its manifest, else the default ones for its error measure and bounds.

    Raises StoreError if the folder holds no results, and ValueError if the targets in it are impossible.
    """
    meta = results.meta
    if listed := json.loads(meta.get("targets", "[]")):
        return tuple(Target(kind, value) for kind, value in listed)
    runs = results.runs if runs is None else runs
    bounds = "crb_m" in runs.columns and bool(np.isfinite(runs["crb_m"].to_numpy(dtype=np.float64)).any())
    return default_targets(meta["error"], has_bounds=bounds, outlier_m=float(meta["outlier_m"]))


def find_hits(
    results: Reader,
    targets: Sequence[Target] | None = None,
    *,
    runs: pd.DataFrame | None = None,
    gradient_cost: float = GRADIENT_COST,
    cached: bool = True,
) -> Hits:
    """Return which targets each finished run reached, and when.

    results: results folder.
    targets: targets in order; None for the default ones.
    runs: ``results.runs``, if it has been read already.
    gradient_cost: evaluations that a gradient costs in addition to the evaluation that it comes with.
    cached: whether to use the file ``hits.npz`` in the folder, and to write it. It is never needed.

    Gap targets are left out for methods without a solver, error targets if no run has an error, and targets in bounds
    at swept points and in scenes without a finite bound. Raises StoreError if the folder holds no results or they are
    damaged.
    """
    runs, meta = results.runs if runs is None else runs, results.meta
    targets = targets_of(results, runs) if targets is None else tuple(targets)
    error, runs = meta["error"], _with_budgets(runs, meta)
    redrawing = Redrawing(results.folder)
    key = _key(results, runs, targets, error)
    shape = (len(runs), len(targets))
    found = hit_cache.read(results.folder, key, shape) if cached else None
    if found is not None and found.reasons and found.reasons != redrawing.reasons:
        found = None  # a plugin has become available
    if found is None:
        found = _found(results, runs, targets, error, redrawing)
        if cached:
            hit_cache.write(results.folder, key, found)
    return Hits(_frame(runs, targets, found, gradient_cost), tuple(found.notes), found.gap, found.best)


def find_progress(
    results: Reader,
    measure: Literal["gap", "error"],
    *,
    runs: pd.DataFrame | None = None,
    methods: Sequence[str] | None = None,
) -> Progress:
    """Return how the gap or the error of each finished run fell.

    results: results folder. measure: "gap", of each run's first problem, or "error", the study's error measure. runs:
    ``results.runs``, if it has been read already. methods: labels of the methods to return; None for all.

    Raises ValueError if the measure is unknown, and StoreError if the folder holds no results or they are damaged.
    """
    return find_progresses(results, (measure,), runs=runs, methods=methods)[measure]


def find_progresses(
    results: Reader,
    measures: Sequence[Literal["gap", "error"]],
    *,
    runs: pd.DataFrame | None = None,
    methods: Sequence[str] | None = None,
) -> dict[str, Progress]:
    """Return the same as ``find_progress`` for several measures, for which the traces are read once."""
    for measure in measures:
        if measure not in ("gap", "error"):
            raise ValueError(f"measure: expected 'gap' or 'error', got {measure!r}")
    runs = _with_budgets(results.runs if runs is None else runs, results.meta)
    wanted = runs["method"].isin(runs["method"] if methods is None else list(methods)).to_numpy()
    curves = Curves(results, runs, results.meta["error"], Redrawing(results.folder), measures)
    parts = [curve for curve in curves if wanted[curve.row]]
    notes = tuple(curves.notes)
    found: dict[str, Progress] = {}
    for measure in measures:
        own = wanted & (runs["solver"] != "").to_numpy() if measure == "gap" else wanted
        chosen = [curve for curve in parts if curve.measure == measure and own[curve.row]]
        found[measure] = Progress(_falling(runs, chosen, own, measure == "gap"), notes)
    return found


def _falling(runs: pd.DataFrame, parts: Sequence[Curve], wanted: ndarray, gap: bool) -> pd.DataFrame:
    """The curves of one measure as a frame, with a row of ∞ for each wanted run without a curve."""
    spent = _evaluations(runs)[:, None].copy()
    for curve in parts:
        spent[curve.row] = curve.spent
    caps, spent = _caps(runs, spent, [gap])
    lacking = np.flatnonzero(wanted & ~np.isin(np.arange(len(runs)), [curve.row for curve in parts]))
    seconds = _spent_s(runs)
    never = [np.array([np.inf])] * len(lacking)
    row = np.concatenate([*(np.full(len(c.values), c.row) for c in parts), lacking]).astype(int)
    about = _about(runs).iloc[row].reset_index(drop=True)
    frame = about.assign(
        evaluations=np.concatenate([*(c.evaluations for c in parts), spent[lacking, 0]]).astype(np.float64),
        seconds=np.concatenate([*(c.seconds for c in parts), seconds[lacking]]).astype(np.float64),
        value=np.concatenate([np.empty(0), *(c.values for c in parts), *never]),
        spent=spent[row, 0],
        cap=caps[row, 0],
        at_end=np.isin(row, [curve.row for curve in parts if curve.at_end and curve.spent > 0]),
    )
    return frame.iloc[np.argsort(row, kind="stable")].reset_index(drop=True)


def _found(
    results: Reader, runs: pd.DataFrame, targets: Sequence[Target], error: str, redrawing: Redrawing
) -> hit_cache.Found:
    """Find the hits in the traces."""
    found = hit_cache.Found.empty(len(runs), len(targets))
    found.spent[:] = _evaluations(runs)[:, None]
    bounds, left_out = _bounds(runs)
    _leave_out(runs, targets, error, left_out, found)
    measures = {"gap" if target.kind == "gap" else "error" for target in targets}
    curves = Curves(results, runs, error, redrawing, measures | {"gap"})
    for curve in curves:
        if curve.measure == "gap":
            found.gap[curve.row] = curve.values[-1]
        for j, target in enumerate(targets):
            if (target.kind == "gap") == (curve.measure == "gap"):
                _enter(curve, j, target, float(bounds[curve.row]), found)
    found.best = curves.bests
    found.notes += curves.notes
    found.reasons = dict(redrawing.reasons) if measures - {"gap"} or found.notes else {}
    return found


def _enter(curve: Curve, j: int, target: Target, bound: float, found: hit_cache.Found) -> None:
    """Enter what a curve says about target j."""
    limit = target.value * bound if target.kind == "error_in_bounds" else target.value
    reach = first_reached if target.kind == "gap" else reached_for_good
    at = reach(curve.values, limit)
    found.spent[curve.row, j] = curve.spent
    if at is not None:
        found.hit[curve.row, j] = True
        found.evaluations[curve.row, j] = curve.evaluations[at]
        found.seconds[curve.row, j] = curve.seconds[at]


def _bounds(runs: pd.DataFrame) -> tuple[ndarray, ndarray]:
    """Return the bound of each run's scene, and whether targets in bounds leave the run out.

    A failed run has no column ``crb_m``, so its bound is that of other runs of its scene. A run is left out if its
    scene's bound is infinite, or if there is no bound at its point of the sweep.
    """
    if "crb_m" not in runs.columns:
        return np.full(len(runs), np.nan), np.ones(len(runs), dtype=bool)
    bound = runs["crb_m"].astype(float)
    point = [name for name in swept_columns(runs) if name.startswith("scenario.")]
    scene = [*(runs[name] for name in point), pd.Series(scenes_of(runs)[0], index=runs.index)]
    of_scene = bound.groupby(scene, dropna=False).transform("first")
    at_point = bound.notna().groupby([runs[name] for name in point], dropna=False).transform("any") if point else None
    some = bool(bound.notna().any())
    lacking = ~at_point.to_numpy(dtype=bool) if at_point is not None else np.full(len(runs), not some)
    return of_scene.to_numpy(), lacking | np.isinf(of_scene.to_numpy())


def _leave_out(
    runs: pd.DataFrame, targets: Sequence[Target], error: str, left_out: ndarray, found: hit_cache.Found
) -> None:
    """Mark the rows that the frame does not have, and say so."""
    measured = error in runs.columns and bool(runs[error].notna().any())
    for j, target in enumerate(targets):
        if target.kind == "gap":
            found.kept[:, j] = (runs["solver"] != "").to_numpy()
        elif not measured:
            found.kept[:, j] = False
            found.notes.append(f"{target.label}: no run has the score {error}, so this target is left out")
        elif target.kind == "error_in_bounds" and left_out.any():
            found.kept[left_out, j] = False
            found.notes.append(
                f"{target.label}: {int(left_out.sum())} of {len(runs)} runs are of scenes without a finite bound, and "
                f"are left out"
            )


def _frame(runs: pd.DataFrame, targets: Sequence[Target], found: hit_cache.Found, gradient_cost: float) -> pd.DataFrame:
    """One row per run and target, run by run."""
    n, m = len(runs), len(targets)
    caps, spent = _caps(runs, found.spent, [target.kind == "gap" for target in targets])
    keep = found.kept.ravel()
    about = _about(runs)
    frame = about.loc[about.index.repeat(m)].reset_index(drop=True)
    labels = [target.label for target in targets]
    with np.errstate(invalid="ignore"):
        equivalents = found.evaluations * (1.0 + gradient_cost * _gradients_each(runs)[:, None])
    frame = frame.assign(
        target=labels * n,
        number=list(range(m)) * n,
        hit=found.hit.ravel(),
        evaluations=found.evaluations.ravel(),
        seconds=found.seconds.ravel(),
        evaluation_equivalents=np.where(found.hit, equivalents, np.inf).ravel(),
        spent=spent.ravel(),
        spent_s=np.repeat(_spent_s(runs), m),
        cap=caps.ravel(),
    )
    return frame[keep].reset_index(drop=True)


def _with_budgets(runs: pd.DataFrame, meta: dict[str, str]) -> pd.DataFrame:
    """The runs with the evaluations that each method may spend per problem, where the folder says so."""
    budgets = json.loads(meta.get("budgets", "{}"))
    return runs.assign(budget_evaluations=runs["method"].map(budgets)) if budgets else runs


def _about(runs: pd.DataFrame) -> pd.DataFrame:
    """The columns that say which run it is, with the index 0 to n - 1."""
    scene, run = scenes_of(runs)
    about = runs[["run_id", "method"]].assign(scene=scene, run=run)
    return about.join(runs[swept_columns(runs)]).reset_index(drop=True)


def _gradients_each(runs: pd.DataFrame) -> ndarray:
    """Gradients per evaluation of each run; 0 in folders that do not say."""
    if "gradients" not in runs.columns:
        return np.zeros(len(runs))
    gradients = np.nan_to_num(runs["gradients"].to_numpy(dtype=np.float64))
    return gradients / np.maximum(_evaluations(runs), 1.0)


def _evaluations(runs: pd.DataFrame) -> ndarray:
    return np.nan_to_num(runs["evaluations"].to_numpy(dtype=np.float64))


def _caps(runs: pd.DataFrame, spent: ndarray, of_first: Sequence[bool]) -> tuple[ndarray, ndarray]:
    """Return the caps (runs, targets), and what was spent with that of killed runs filled in.

    of_first: whether each column is about the first problem alone.
    """
    killed = runs["status"].isin(KILLED).to_numpy() & (_evaluations(runs) == 0)
    groups = [runs[name] for name in [*swept_columns(runs), "method"]]
    budget = np.full(len(runs), np.nan)
    for name in ("budget_evaluations", "budget.evaluations"):
        if name in runs.columns:
            budget = pd.to_numeric(runs[name], errors="coerce").to_numpy(dtype=np.float64)
    ok = (runs["status"] == Status.OK).to_numpy()
    caps = np.empty_like(spent)
    for j, first in enumerate(of_first):
        largest = _largest(spent[:, j], groups)
        if first:  # a run that is not ok states what it spent on all its problems
            of_ok = _largest(np.where(ok, spent[:, j], np.nan), groups)
            largest = np.where(np.isnan(of_ok), largest, of_ok)
        problems = 1.0 if first else np.maximum(np.ceil(largest / np.where(budget > 0, budget, 1.0)), 1.0)
        caps[:, j] = np.where(np.isnan(budget), largest, np.maximum(budget * problems, largest))
    return caps, np.where(killed[:, None], caps, np.minimum(spent, caps))


def _spent_s(runs: pd.DataFrame) -> ndarray:
    """Seconds of each run; where they are not known, the most of any run of the method at this swept point."""
    seconds = runs["runtime_s"].to_numpy(dtype=np.float64)
    most = _largest(seconds, [runs[name] for name in [*swept_columns(runs), "method"]])
    return np.where(np.isnan(seconds), most, seconds)


def _largest(values: ndarray, groups: list[pd.Series]) -> ndarray:
    """The largest value of each row's group."""
    if not len(values):
        return values.copy()
    series = pd.Series(values, index=groups[0].index)
    return series.groupby(groups, dropna=False).transform("max").to_numpy(dtype=np.float64)


def _key(results: Reader, runs: pd.DataFrame, targets: Sequence[Target], error: str) -> str:
    """A hash of everything that decides the hits, except for libraries that plugins need."""
    names = ["run_id", "status", "evaluations", "runtime_s", "objective", "instance_seed", error, "crb_m", "optimum"]
    names += ["formulation", "method", "scene", "run", *swept_columns(runs)]
    columns = runs[[name for name in dict.fromkeys(names) if name in runs.columns]]
    found = hashlib.sha256(pd.util.hash_pandas_object(columns, index=False).to_numpy().tobytes())
    found.update(canonical(results.references).encode())
    manifest = results.folder / "manifest.toml"
    found.update(manifest.read_bytes() if manifest.is_file() else b"")
    registry = Registry.present()
    plugins = [
        (kind, name, registry.find(kind, name).version)
        for kind in ("scenario", "formulation")
        for name in registry.names(kind)
    ]
    about = [VERSION, [target.label for target in targets], list(columns.columns), error, plugins]
    found.update(json.dumps(about).encode())
    return found.hexdigest()
