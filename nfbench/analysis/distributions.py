"""Distributions of the cost to reach targets, and of what a budget buys: curves and tables of optimizer benchmarks."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from .intervals import bounded_mean_interval, ecdf_pointwise, quantile_interval
from .targets import quantile, swept_columns, target_table

__all__ = [
    "AXES",
    "Axis",
    "aocc",
    "aocc_table",
    "attainment",
    "fixed_budget_table",
    "fixed_target_table",
    "performance_profile",
    "runtime_distribution",
    "value_at",
]

Axis: TypeAlias = Literal["evaluations", "evaluation_equivalents", "seconds"]
AXES: tuple[Axis, ...] = ("evaluations", "evaluation_equivalents", "seconds")
POINTS = 100  # most points of a curve


def runtime_distribution(
    hits: pd.DataFrame, axis: Axis = "evaluations", *, points: int = POINTS, bands: bool = True
) -> pd.DataFrame:
    """Return the share of (scene, run, target) that each method has reached after a cost, over all targets in ``hits``.

    hits: one row per run and target, as ``nfbench.results.find_hits`` returns it.
    axis: the cost: "evaluations", "evaluation_equivalents" or "seconds".
    points: largest number of points of a curve; with more distinct costs they are spaced evenly in their logarithm.
    bands: whether to compute ``low`` and ``high``, which takes most of the time.

    Each scene has the same weight. One row per point, with the swept keys, ``method``, the axis, ``share``, and the
    pointwise 95 % band ``low`` to ``high`` over scenes: Clopper–Pearson for one target and one run per scene, that of
    a bounded mean otherwise. It is not a band of the whole curve, and says nothing about differences between curves.
    All curves of a swept point end at the smallest cap of its methods, or at the longest run on the axis of seconds.

    Raises ValueError if the axis is unknown.
    """
    _check_axis(axis)
    swept = swept_columns(hits)
    keys: list[tuple[Any, ...]] = []
    curves: list[ndarray] = []
    for about, at_point in _groups(hits, swept):
        grid = _grid(at_point, axis, points)
        for method, group in at_point.groupby("method", sort=False):
            shares, single = _shares(group, axis, grid)
            low, high = _band(shares, single) if bands else np.full((2, len(grid)), math.nan)
            curves.append(np.stack([grid, shares.mean(axis=0), low, high], axis=1))
            keys += [(*about.values(), method)] * len(grid)
    names, numbers = [*swept, "method"], [axis, "share", "low", "high"]
    if not curves:
        return pd.DataFrame(columns=[*names, *numbers])
    return pd.DataFrame(keys, columns=names).join(pd.DataFrame(np.concatenate(curves), columns=numbers))


def _grid(hits: pd.DataFrame, axis: Axis, points: int) -> Float[ndarray, " x"]:
    """The costs at which the curves of one swept point are computed."""
    if axis == "seconds":
        end = float(hits["spent_s"].max())
    else:
        method, labels = pd.factorize(hits["method"])
        caps = np.zeros(len(labels))
        np.fmax.at(caps, method, hits["cap"].to_numpy(dtype=np.float64))
        end = float(caps[caps > 0].min()) if (caps > 0).any() else 0.0
    costs = hits[axis].to_numpy(dtype=np.float64)[hits["hit"].to_numpy(dtype=bool)]
    costs = np.unique(np.append(costs[costs <= end], end))
    positive = costs[costs > 0]
    if len(costs) > points and len(positive) > 1:
        costs = np.unique(np.append(np.geomspace(positive[0], end, points - 1), costs[:1]))
        costs[-1] = end
    return costs


def _shares(group: pd.DataFrame, axis: Axis, grid: Float[ndarray, " x"]) -> tuple[Float[ndarray, "n x"], bool]:
    """The share of each scene's runs and targets reached at each cost, and whether there is one of each per scene."""
    scene = pd.factorize(group["scene"])[0]
    count = np.bincount(scene)
    cost = np.where(group["hit"].to_numpy(dtype=bool), group[axis].to_numpy(dtype=np.float64), np.inf)
    reached = np.zeros((len(count), len(grid) + 1))
    np.add.at(reached, (scene, np.searchsorted(grid, cost)), 1.0)
    return reached.cumsum(axis=1)[:, :-1] / count[:, None], bool(count.max() == 1)


def _band(shares: Float[ndarray, "n x"], single: bool) -> tuple[ndarray, ndarray]:
    """The pointwise band of the mean over scenes."""
    if single:
        return ecdf_pointwise(shares.sum(axis=0).astype(int), len(shares))
    known: dict[bytes, tuple[float, float]] = {}
    ends = [_interval(known, column) for column in np.minimum(shares, 1.0).T]
    low, high = np.array(ends).reshape(-1, 2).T
    return low, high


def _interval(known: dict[bytes, tuple[float, float]], column: ndarray) -> tuple[float, float]:
    """The interval of the mean of one column, which often equals that of its neighbour."""
    key = np.ascontiguousarray(column).tobytes()
    if key not in known:
        known[key] = bounded_mean_interval(column, 0.0, 1.0)
    return known[key]


def fixed_target_table(hits: pd.DataFrame, column: str = "ert") -> pd.DataFrame:
    """Return one row per swept point and target, and one column per method, with a column of ``target_table``.

    Raises ValueError if ``target_table`` has no such column.
    """
    table = target_table(hits)
    if column not in table.columns:
        raise ValueError(f"column: expected a column of the table of targets, got {column!r}")
    index = [*swept_columns(hits), "target"]
    wide = table.pivot_table(index=index, columns="method", values=column, sort=False, dropna=False, observed=True)
    return wide.reindex(columns=list(dict.fromkeys(table["method"]))).rename_axis(columns=None).reset_index()


def fixed_budget_table(progress: pd.DataFrame, budgets: Sequence[float] | None = None) -> pd.DataFrame:
    """Return what each method has reached after a number of evaluations.

    progress: one row per improvement, as ``nfbench.results.find_progress`` returns it, of gaps or errors.
    budgets: numbers of evaluations; None for 1, 2, 5, 10, … up to the largest cap, and the smallest cap.

    One row per swept point, method and budget, with the swept keys, ``method``, ``evaluations``, ``runs``, and over
    the scenes ``median``, with its 95 % interval ``median_low`` to ``median_high`` between order statistics, ``q25``,
    ``q75`` and ``q90``. The value of a scene is the median over its runs; it is inf before a run's first evaluation
    and for runs that are not ok. All are NaN beyond the cap of the method, and before the end of runs of which only
    the final value is known.
    """
    swept = swept_columns(progress)
    rows: list[dict[str, Any]] = []
    chosen = _budgets(progress) if budgets is None else sorted(float(budget) for budget in budgets)
    for about, group in _groups(progress, [*swept, "method"]):
        values = np.array([value_at(run, chosen) for _, run in group.groupby("run_id", sort=False)])
        scenes = group.groupby("run_id", sort=False)["scene"].first().to_numpy()
        cap = float(group["cap"].max())
        for budget, column in zip(chosen, values.T, strict=True):
            row = {**about, "evaluations": budget, "runs": len(column)}
            rows.append(row | (_spread(column, scenes) if budget <= cap else dict.fromkeys(SPREAD, math.nan)))
    return pd.DataFrame(rows, columns=[*swept, "method", "evaluations", "runs", *SPREAD])


SPREAD = ("median", "median_low", "median_high", "q25", "q75", "q90")


def _spread(values: Float[ndarray, " runs"], scenes: ndarray) -> dict[str, float]:
    """Quantiles over scenes of the median over runs."""
    numbers = pd.factorize(scenes)[0]
    if np.isnan(values).any():
        return dict.fromkeys(SPREAD, math.nan)
    each = np.array([quantile(values[numbers == number], 0.5) for number in range(numbers.max() + 1)])
    low, high = quantile_interval(each, 0.5)
    ends = {"median": quantile(each, 0.5), "median_low": low, "median_high": high}
    return ends | {"q25": quantile(each, 0.25), "q75": quantile(each, 0.75), "q90": quantile(each, 0.9)}


def _budgets(progress: pd.DataFrame) -> list[float]:
    """1, 2, 5, 10, … up to the largest cap, and the smallest cap."""
    caps = progress.groupby("method")["cap"].max()
    caps = caps[caps > 0]
    if not len(caps):
        return [0.0]
    decades = range(math.ceil(math.log10(caps.max())) + 1)
    steps = (float(step * 10**decade) for decade in decades for step in (1, 2, 5))
    return sorted({*(step for step in steps if step <= caps.max()), float(caps.min())})


def value_at(run: pd.DataFrame, evaluations: Sequence[float]) -> Float[ndarray, " x"]:
    """Return the value of one run, the rows of ``progress``, after each number of evaluations.

    Before the first row it is inf, or NaN if only the final value of the run is known.
    """
    before = math.nan if "at_end" in run.columns and run["at_end"].any() else math.inf
    place = np.searchsorted(run["evaluations"].to_numpy(dtype=np.float64), np.asarray(evaluations), side="right")
    return np.append(before, run["value"].to_numpy(dtype=np.float64))[place]


def attainment(
    progress: pd.DataFrame, percentiles: Sequence[float] = (25, 50, 75), *, cost: str = "evaluations"
) -> pd.DataFrame:
    """Return the empirical attainment surfaces of each method: what a share of its runs has reached by a cost.

    progress: as in ``fixed_budget_table``. percentiles: shares of the runs [%]. cost: column with the cost,
    "evaluations" or "seconds".

    One row per corner of a surface, with the swept keys, ``method``, ``percentile``, the cost and ``value``: at least
    this share of the runs has a value of at most ``value`` from this cost on, and no smaller pair has this property.
    Runs that are not ok count as never reaching anything. Computed by moocore (Fonseca, Guerreiro, López-Ibáñez &
    Paquete 2011); raises ImportError if it is not installed.
    """
    eaf = _moocore("eaf")
    swept = swept_columns(progress)
    tables: list[pd.DataFrame] = []
    for about, group in _groups(progress, [*swept, "method"]):
        runs = pd.factorize(group["run_id"])[0]
        lasting = group["value"].iloc[::-1].groupby(runs[::-1]).cummax().iloc[::-1]  # an error may rise again
        points = np.column_stack([group[cost], lasting]).astype(np.float64)
        finite = np.isfinite(points).all(axis=1)
        if not finite.any():
            continue
        far = np.abs(points[finite]).max(axis=0) * 2 + 1  # where runs without a value are put
        never = np.setdiff1d(runs, runs[finite])
        inputs = np.vstack([points[finite], np.tile(far, (len(never), 1))])
        sets = np.concatenate([runs[finite], never])
        order = np.argsort(sets, kind="stable")
        found = np.asarray(eaf(inputs[order], sets[order], percentiles=list(percentiles)))
        found = found[(found[:, :2] < far).all(axis=1)]
        found = found[np.lexsort((found[:, 0], found[:, 2]))]
        corners = {"percentile": found[:, 2], cost: found[:, 0], "value": found[:, 1]}
        tables.append(pd.DataFrame(about | corners))
    columns = [*swept, "method", "percentile", cost, "value"]
    return pd.concat(tables, ignore_index=True)[columns] if tables else pd.DataFrame(columns=columns)


def _moocore(name: str) -> Callable[..., Any]:
    try:
        function: Callable[..., Any] = getattr(importlib.import_module("moocore"), name)
    except ImportError as error:
        raise ImportError(
            "attainment surfaces need moocore, which is not installed here: pip install moocore"
        ) from error
    return function


def aocc(
    evaluations: Float[ndarray, " r"],
    values: Float[ndarray, " r"],
    budget: float,
    low: float,
    high: float,
    *,
    log_time: bool = False,
) -> float:
    """Return the area over the convergence curve of one run, a share from 0 to 1; larger is better.

    evaluations: evaluations made at each improvement, (r,), increasing.
    values: best gap or error so far at each, (r,).
    budget: evaluations B at which the area ends.
    low, high: log10 of the values that count as 1 and 0; the same for all runs that are compared.
    log_time: whether time counts by its logarithm, from 1 to B, which is another measure.

    (1/B)·∫₀ᴮ (1 − clip((log10 g(t) − low)/(high − low), 0, 1)) dt, where evaluation j counts from t = j on and the
    curve is flat after the last one. Raises ValueError unless low < high and budget > 0 (> 1 in logarithmic time).
    """
    if not low < high:
        raise ValueError(f"low, high: expected low < high, got {low} and {high}")
    if not budget > (1 if log_time else 0):
        raise ValueError(f"budget: expected more than {1 if log_time else 0}, got {budget}")
    t = np.clip(np.append(np.asarray(evaluations, dtype=np.float64), budget), 1.0 if log_time else 0.0, budget)
    t = np.log10(t) if log_time else t
    with np.errstate(divide="ignore"):
        logs = np.log10(np.maximum(np.asarray(values, dtype=np.float64), 0.0))
    share = 1.0 - np.clip((logs - low) / (high - low), 0.0, 1.0)
    return float(np.sum(np.diff(t) * share) / (math.log10(budget) if log_time else budget))


def aocc_table(
    progress: pd.DataFrame, low: float, high: float, budget: float | None = None, *, log_time: bool = False
) -> pd.DataFrame:
    """Return the mean area over the convergence curve of each method; see ``aocc``.

    progress: as in ``fixed_budget_table``. budget: evaluations at which the area ends; None for the smallest cap.

    One row per swept point and method, with the swept keys, ``method``, ``runs``, ``aocc``, and its 95 % interval over
    scenes ``aocc_low`` to ``aocc_high``, that of a bounded mean. Runs that are not ok count as 0. The area is NaN where
    only the final value of a run is known.
    """
    swept = swept_columns(progress)
    rows = []
    for about, at_point in _groups(progress, swept):
        caps = at_point.groupby("method")["cap"].max()
        end = float(caps[caps > 0].min()) if budget is None else budget
        for method, group in at_point.groupby("method", sort=False):
            areas = [
                (
                    run["scene"].iloc[0],
                    aocc(run["evaluations"].to_numpy(), run["value"].to_numpy(), end, low, high, log_time=log_time),
                )
                for _, run in group.groupby("run_id", sort=False)
            ]
            mean, lower, upper = math.nan, math.nan, math.nan
            if "at_end" not in group.columns or not group["at_end"].any():
                each = pd.Series([area for _, area in areas]).groupby([scene for scene, _ in areas]).mean().to_numpy()
                mean, (lower, upper) = each.mean(), bounded_mean_interval(np.clip(each, 0.0, 1.0), 0.0, 1.0)
            row = {"method": method, "runs": len(areas), "aocc": mean, "aocc_low": lower, "aocc_high": upper}
            rows.append(about | row)
    return pd.DataFrame(rows, columns=[*swept, "method", "runs", "aocc", "aocc_low", "aocc_high"])


def performance_profile(
    hits: pd.DataFrame, axis: Axis = "evaluations", *, cost: Literal["ert", "median"] = "ert"
) -> pd.DataFrame:
    """Return the performance profiles of the methods (Dolan & Moré 2002), over all scenes, targets and swept points.

    hits, axis: as in ``runtime_distribution``. cost: cost of a method on one scene for one target: its expected running
    time over the runs there, or their median.

    One row per corner of a profile, with ``method``, ``ratio`` and ``share``: the share of problems, each a scene with
    a target, on which the method costs at most ``ratio`` times the smallest cost of all methods in ``hits``. A problem
    counts only if all methods have run on it. One that no method solves counts as unsolved by all. A profile depends on
    which methods are in the table.

    Raises ValueError if the axis or the cost is unknown.
    """
    _check_axis(axis)
    if cost not in ("ert", "median"):
        raise ValueError(f"cost: expected 'ert' or 'median', got {cost!r}")
    hit = hits["hit"].to_numpy(dtype=bool)
    reached = np.where(hit, hits[axis].to_numpy(dtype=np.float64), np.inf)
    end = hits["spent_s" if axis == "seconds" else "spent"].to_numpy(dtype=np.float64)
    table = hits.assign(_hit=hit, _cost=reached, _spent=np.where(hit, reached, end))
    by = [*swept_columns(hits), "scene", "target", "method"]
    groups = table.groupby(by, sort=False, dropna=False)
    if cost == "ert":
        sums = groups[["_spent", "_hit"]].sum()
        each = pd.Series(np.where(sums["_hit"] > 0, sums["_spent"] / sums["_hit"].clip(lower=1), np.inf), sums.index)
    else:
        each = groups["_cost"].agg(lambda costs: quantile(costs.to_numpy(), 0.5))
    wide = each.unstack("method", sort=False).dropna()
    costs = np.maximum(wide.to_numpy(dtype=np.float64), 1e-9 if axis == "seconds" else 1.0)
    best = costs.min(axis=1, keepdims=True, initial=np.inf)
    with np.errstate(invalid="ignore"):
        ratios = np.where(np.isfinite(costs), costs / best, np.inf)
    profiles = [
        pd.DataFrame({"method": method, "ratio": ratio, "share": [float(np.mean(column <= r)) for r in ratio]})
        for method, column in zip(wide.columns, ratios.T, strict=True)
        for ratio in [np.unique(np.append(column[np.isfinite(column)], 1.0))]
    ]
    return pd.concat(profiles, ignore_index=True) if profiles else pd.DataFrame(columns=["method", "ratio", "share"])


def _groups(frame: pd.DataFrame, by: list[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """The values of the columns ``by`` and the rows with them, in order of appearance; all rows if there are none."""
    if not by:
        if len(frame):
            yield {}, frame
        return
    for key, group in frame.groupby(by, sort=False, dropna=False):
        yield dict(zip(by, key, strict=True)), group


def _check_axis(axis: str) -> None:
    if axis not in AXES:
        raise ValueError(f"axis: expected one of {', '.join(AXES)}, got {axis!r}")
