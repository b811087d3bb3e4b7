"""Comparisons of methods in one sentence, which states only what the data support."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from nfbench.core import Status

from .statistics import MIN_RUNS, bootstrap, mean, percentile_interval

__all__ = ["judge", "verdict"]

RESAMPLES = 4000
EXCESS = 0.02  # relative excess in mean square error (1 % in RMSE) below which a method does not count as worse
CHANGE = 0.01  # relative change of the error below which tuning counts as having no effect


def verdict(runs: pd.DataFrame, error: str) -> str:
    """State which method has the smallest error over these runs, and which others do not differ significantly from it.

    Only a method with the largest number of runs that have an error can be the best one. Each other method is compared
    with it on the instances that both have solved. It counts as worse if the 95 % bootstrap interval of its paired
    excess in squared error lies above 2 % of the best method's mean square error, which is 1 % of its RMSE. If any run
    found too few or too many sources, the methods are compared by GOSPA instead, because the error of the matched
    sources alone would favour such runs.
    """
    ok = runs[runs["status"] == Status.OK]
    by = ""
    counted = {"sources", "sources_found"} <= set(ok.columns)
    if error == "rmse_m" and counted and (ok["sources_found"] - ok["sources"]).any():
        by, error = "Not all runs found the true number of sources, so methods are compared by gospa_m: ", "gospa_m"
    ok = ok.dropna(subset=[error]) if error in ok.columns else ok.head(0)
    if ok.empty:
        return "No run ended with an estimate."
    squares = ok.assign(square=ok[error] ** 2).pivot(index="repetition", columns="method", values="square")
    done = squares.count()
    best = squares.mean()[done == done.max()].idxmin()
    unit = " m" if error.endswith("_m") else ""
    found = f"{by}{best} has the smallest error here ({math.sqrt(squares[best].mean()):.3g}{unit} root mean square"
    others = [method for method in squares.columns if method != best]
    pairs = int(done.max())
    if not others:
        return f"{found})."
    if pairs < MIN_RUNS:
        return (
            f"{found}), but {pairs} {'repetition is' if pairs == 1 else 'repetitions are'} too few to rank methods: "
            f"set repetitions to at least {MIN_RUNS}, better 100."
        )
    few = [method for method in others if len((squares[method] - squares[best]).dropna()) < MIN_RUNS]
    similar = [method for method in others if method not in few and not _worse(squares[method], squares[best])]
    results = []
    if similar:
        results.append(f"not significantly different: {', '.join(similar)}")
    elif len(few) < len(others):
        results.append(f"every other method {'with enough runs ' if few else ''}is worse by more than 1\u00a0%")
    if few:
        results.append(f"too few successful runs to compare: {', '.join(few)}")
    return f"{found}, {pairs} repetitions); {'; '.join(results)} (95\u00a0% paired bootstrap)."


def _worse(squares: pd.Series[float], best: pd.Series[float]) -> bool:
    excess = (squares - best).dropna().to_numpy()
    low, _ = percentile_interval(bootstrap(mean, excess, rng=np.random.default_rng(0), resamples=RESAMPLES))
    return bool(low > EXCESS * best.mean())


def judge(default: Float[ndarray, " scenes"], tuned: Float[ndarray, " scenes"]) -> str:
    """State the factor by which tuning changes the error, and whether the change is significant.

    default, tuned: errors of the default and of the tuned setting on the same scenes, (scenes,); NaN where a run has
    no error.

    The factor is the geometric mean of tuned/default over the scenes where both have an error, with a 95 % percentile
    bootstrap interval over the scenes. The change is significant if the whole interval differs from 1 by more than 1 %.
    """
    logs = np.log(tuned) - np.log(default)
    logs = logs[~np.isnan(logs)]
    n = len(logs)
    if n < MIN_RUNS:
        return f"{n} held-out scenes with both errors are too few to compare: use at least {MIN_RUNS}, better 100."
    means = bootstrap(mean, logs, rng=np.random.default_rng(0), resamples=RESAMPLES)
    factor, low, high = np.exp([logs.mean(), *percentile_interval(means)])
    interval = f"95\u00a0% paired bootstrap {low:.3g} – {high:.3g}"
    found = f"{factor:.3g} times the default's error on {n} held-out scenes ({interval})"
    if high < 1 - CHANGE:
        return f"The tuned setting has {found}: it is better."
    if low > 1 + CHANGE:
        return f"The tuned setting has {found}: it is worse, as it fits only the training scenes. Keep the default."
    if low >= 1 - CHANGE and high <= 1 + CHANGE:
        return f"The tuned setting has {found}: they are the same within {CHANGE:.0%}. Keep the default."
    return f"The tuned setting has {found}: the difference is not significant. Use more scenes, or keep the default."
