"""Summarizes runs in a table with one row per swept point and method, including the spread of the errors."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from nfbench.core import Status

from .intervals import quantile_interval
from .parameters import parameters
from .targets import swept_columns

__all__ = ["default_groups", "summarize"]


def summarize(
    runs: pd.DataFrame, by: Sequence[str] | None = None, *, error: str = "rmse_m", outlier_m: float = 1.0
) -> pd.DataFrame:
    """Summarize runs in one row per group.

    runs: table with one row per run.
    by: columns that define the groups; None for the swept keys, formulation, solver and method.
    error: name of the score by which methods are ranked.
    outlier_m: position error above which the estimate of a source counts as an outlier [m].

    The rows are in order of first appearance of their group. All columns except ``runs`` and ``failed`` are computed
    from the runs with status ok, and are NaN where no such run has a value:

    * ``runs``: number of runs; ``failed``: number of runs with another status than ok.
    * ``rmse_m``: root mean square of the runs' ``rmse_m``; ``rmse_m_low`` and ``rmse_m_high``: empty, because no
      interval of it is valid: a few outliers decide its value.
    * ``median_m`` and ``q90_m``: median and 90 % quantile of ``rmse_m`` over the runs; ``median_m_low`` and
      ``median_m_high``: the 95 % interval of the median over scenes, in which runs that are not ok count as infinite
      and of several runs on one scene the median counts; NaN for fewer than 6 scenes.
    * ``outlier_rate``: share of the true sources of all runs whose error exceeds ``outlier_m`` or that were not found.
    * ``crb_m``: root mean square of the Cramér–Rao bound.
    * ``evaluations`` and ``runtime_s``: means over the runs.
    * ``floor_m``: root mean square of the error that remains at any SNR.
    * ``gospa_m``: root mean square of the GOSPA; ``sources_found``: mean over the runs.
    * ``median_error_in_bounds`` and ``median_gap``: medians of these columns of the runs, where they exist.
    * For each column such as ``azimuth_rmse_deg``, the errors of one parameter of the sources: ``azimuth_rmse_deg``,
      its root mean square; ``azimuth_rmse_deg_median``, ``azimuth_rmse_deg_median_low`` and
      ``azimuth_rmse_deg_median_high``, computed like ``median_m``; ``azimuth_bias_deg``, median of the signed errors of
      all sources that were found; and ``crb_azimuth_deg``, root mean square of the bound, where there is one.
    * If ``error`` is not ``rmse_m``: ``<error>``, ``<error>_low``, ``<error>_high``, ``<error>_median``,
      ``<error>_q90``, ``<error>_median_low`` and ``<error>_median_high``, computed like the columns of ``rmse_m``.

    A run that found no source has no ``rmse_m``, but it counts in ``outlier_rate`` and ``gospa_m``. A few scenes with
    closely spaced sources may dominate ``crb_m``, as outliers may dominate ``rmse_m``; compare the two columns only in
    studies that keep the sources apart. Raises ValueError if ``by`` names a column that does not exist.
    """
    by = default_groups(runs) if by is None else list(by)
    missing = [name for name in by if name not in runs.columns]
    if missing:
        raise ValueError(f"by: expected columns of runs, got {', '.join(missing)}; known: {', '.join(runs.columns)}")
    rows = []
    for key, group in runs.groupby(by, sort=False, dropna=False):
        rows.append({**dict(zip(by, key, strict=True)), **_summary(group, error, outlier_m)})
    return pd.DataFrame(rows)


def default_groups(runs: pd.DataFrame) -> list[str]:
    """Return the columns of the swept keys, followed by formulation, solver and method."""
    return [*swept_columns(runs), "formulation", "solver", "method"]


def _summary(group: pd.DataFrame, error: str, outlier_m: float) -> dict[str, Any]:
    ok = group[group["status"] == Status.OK]
    row: dict[str, Any] = {"runs": len(group), "failed": len(group) - len(ok)}
    row |= _spread(_values(ok, "rmse_m"), "rmse_m", "median_m", "q90_m")
    row["outlier_rate"] = _outlier_rate(ok, outlier_m)
    row["crb_m"] = _root_mean_square(_values(ok, "crb_m"))
    row["evaluations"] = _mean(_values(ok, "evaluations"))
    row["runtime_s"] = _mean(_values(ok, "runtime_s"))
    row["floor_m"] = _root_mean_square(_values(ok, "floor_m"))
    row["gospa_m"] = _root_mean_square(_values(ok, "gospa_m"))
    row["sources_found"] = _mean(_values(ok, "sources_found"))
    for name in ("error_in_bounds", "gap"):
        if name in ok.columns and name != error:
            values = _values(ok, name)
            row[f"median_{name}"] = float(np.median(values)) if len(values) else np.nan
    if error != "rmse_m":
        row |= _spread(_values(ok, error), error, f"{error}_median", f"{error}_q90")
        row |= _median_interval(group, error, f"{error}_median")
    row |= _median_interval(group, "rmse_m", "median_m")
    return {**row, **{name: value for name, value in _of_parameters(group, ok).items() if name not in row}}


def _of_parameters(group: pd.DataFrame, ok: pd.DataFrame) -> dict[str, float]:
    """The errors and bounds of the single parameters."""
    row: dict[str, float] = {}
    for parameter in parameters(group.columns):
        errors, median = _values(ok, parameter.error), f"{parameter.error}_median"
        row[parameter.error] = _root_mean_square(errors)
        row[median] = float(np.median(errors)) if len(errors) else np.nan
        row |= _median_interval(group, parameter.error, median)
        signed = [_values(ok, name) for name in parameter.signed(ok.columns)]
        row[parameter.bias] = float(np.median(np.concatenate(signed))) if any(map(len, signed)) else np.nan
        if parameter.bound in group.columns:
            row[parameter.bound] = _root_mean_square(_values(ok, parameter.bound))
    return row


def _median_interval(group: pd.DataFrame, error: str, name: str) -> dict[str, float]:
    """The 95 % interval of the median over scenes; runs that are not ok count as infinite."""
    low = high = np.nan
    if error in group.columns:
        errors = group[error].where(group["status"] == Status.OK).fillna(np.inf)
        scenes = group["scene"] if "scene" in group.columns else pd.Series(range(len(group)), group.index)
        if len(group) and np.isfinite(errors).any():
            low, high = quantile_interval(errors.groupby(scenes).median().to_numpy(dtype=np.float64))
    return {f"{name}_low": low, f"{name}_high": high}


def _spread(errors: Float[ndarray, " runs"], name: str, median: str, q90: str) -> dict[str, float]:
    return {
        name: _root_mean_square(errors),
        f"{name}_low": np.nan,
        f"{name}_high": np.nan,
        median: float(np.median(errors)) if len(errors) else np.nan,
        q90: float(np.quantile(errors, 0.9)) if len(errors) else np.nan,
    }


def _outlier_rate(ok: pd.DataFrame, outlier_m: float) -> float:
    """Return the share of sources over all runs whose error exceeds ``outlier_m`` or that were not found."""
    columns = [name for name in ok.columns if re.fullmatch(r"error_\d+_m", name)]
    errors = ok[columns].to_numpy(dtype=np.float64)
    errors = errors[~np.isnan(errors)]
    # NaN: the source was not found, or it exists only in other runs of the sweep; the former are counted below
    missed = 0.0
    if {"sources", "sources_found"} <= set(ok.columns):
        missed = float(np.maximum(ok["sources"] - ok["sources_found"], 0).sum())
    total = len(errors) + missed
    return float((np.sum(errors > outlier_m) + missed) / total) if total else np.nan


def _values(ok: pd.DataFrame, name: str) -> Float[ndarray, " runs"]:
    values = ok[name].to_numpy(dtype=np.float64) if name in ok.columns else np.empty(0)
    return values[~np.isnan(values)]


def _root_mean_square(values: Float[ndarray, " runs"]) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def _mean(values: Float[ndarray, " runs"]) -> float:
    return float(values.mean()) if len(values) else np.nan
