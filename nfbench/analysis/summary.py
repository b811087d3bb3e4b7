"""Sums up runs: one row per swept point and method, with the spread that a mean would hide."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from nfbench.core import Status

from .statistics import rms, rms_interval

__all__ = ["default_groups", "summarize"]


def summarize(
    runs: pd.DataFrame, by: Sequence[str] | None = None, *, error: str = "rmse_m", outlier_m: float = 1.0
) -> pd.DataFrame:
    """One row per group of ``by`` (default: swept keys, formulation, solver, method), in order of appearance.

    Over the runs that are ok: ``rmse_m`` the root of the mean square error of a run, with a 95 % bootstrap interval
    ``rmse_m_low``, ``rmse_m_high`` (percentiles of 2,000 resamples; NaN for fewer than 6 runs); ``median_m``
    and ``q90_m`` over runs; ``outlier_rate`` the share of true sources, of all runs, further off than ``outlier_m`` or
    not found at all (``sources`` that exceed ``sources_found``); ``crb_m`` the root mean square bound where runs have
    one; ``evaluations`` and ``runtime_s`` the means; ``floor_m`` the root mean square of the error that no SNR removes,
    and ``gospa_m``, and the mean of ``sources_found``, where runs have them. ``failed`` counts the others. A run that
    found nothing has no ``rmse_m``, but counts in ``outlier_rate`` and ``gospa_m``. Few scenes with sources close
    together own ``crb_m``, as outliers own ``rmse_m``: compare the two where sources are kept apart.
    An ``error`` other than ``rmse_m`` is summed up in the columns ``<error>``, ``_low``, ``_high``, ``median``,
    ``q90`` beside them.
    """
    by = default_groups(runs) if by is None else list(by)
    missing = [name for name in by if name not in runs.columns]
    if missing:
        raise ValueError(f"by: expected columns of runs, got {', '.join(missing)}; known: {', '.join(runs.columns)}")
    rows = []
    for key, group in runs.groupby(by, sort=False, dropna=False):
        rows.append({**dict(zip(by, key, strict=True)), **_summary(group, str(key), error, outlier_m)})
    return pd.DataFrame(rows)


def default_groups(runs: pd.DataFrame) -> list[str]:
    """Swept keys, then formulation, solver and method."""
    return [name for name in runs.columns if name.startswith("scenario.")] + ["formulation", "solver", "method"]


def _summary(group: pd.DataFrame, name: str, error: str, outlier_m: float) -> dict[str, Any]:
    ok = group[group["status"] == Status.OK]
    rng = np.random.default_rng(zlib.crc32(name.encode()))  # the interval is a function of the table
    row: dict[str, Any] = {"runs": len(group), "failed": len(group) - len(ok)}
    row |= _spread(_values(ok, "rmse_m"), rng, "rmse_m", "median_m", "q90_m")
    row["outlier_rate"] = _outlier_rate(ok, outlier_m)
    row["crb_m"] = _root_mean_square(_values(ok, "crb_m"))
    row["evaluations"] = _mean(_values(ok, "evaluations"))
    row["runtime_s"] = _mean(_values(ok, "runtime_s"))
    row["floor_m"] = _root_mean_square(_values(ok, "floor_m"))
    row["gospa_m"] = _root_mean_square(_values(ok, "gospa_m"))
    row["sources_found"] = _mean(_values(ok, "sources_found"))
    if error != "rmse_m":
        row |= _spread(_values(ok, error), rng, error, f"{error}_median", f"{error}_q90")
    return row


def _spread(
    errors: Float[ndarray, " runs"], rng: np.random.Generator, name: str, median: str, q90: str
) -> dict[str, float]:
    low, high = rms_interval(errors, rng)
    return {
        name: _root_mean_square(errors),
        f"{name}_low": low,
        f"{name}_high": high,
        median: float(np.median(errors)) if len(errors) else np.nan,
        q90: float(np.quantile(errors, 0.9)) if len(errors) else np.nan,
    }


def _outlier_rate(ok: pd.DataFrame, outlier_m: float) -> float:
    """Share of sources, over all runs, whose error exceeds ``outlier_m`` or which no estimate is matched with."""
    columns = [name for name in ok.columns if re.fullmatch(r"error_\d+_m", name)]
    errors = ok[columns].to_numpy(dtype=np.float64)
    errors = errors[~np.isnan(errors)]
    # an error that is NaN is of a source that was missed, or that another run of the sweep has and this one has not
    missed = 0.0
    if {"sources", "sources_found"} <= set(ok.columns):
        missed = float(np.maximum(ok["sources"] - ok["sources_found"], 0).sum())
    total = len(errors) + missed
    return float((np.sum(errors > outlier_m) + missed) / total) if total else np.nan


def _values(ok: pd.DataFrame, name: str) -> Float[ndarray, " runs"]:
    values = ok[name].to_numpy(dtype=np.float64) if name in ok.columns else np.empty(0)
    return values[~np.isnan(values)]


def _root_mean_square(values: Float[ndarray, " runs"]) -> float:
    return float(rms(values)) if len(values) else np.nan


def _mean(values: Float[ndarray, " runs"]) -> float:
    return float(values.mean()) if len(values) else np.nan
