"""What rows say about methods, in one sentence that says no more than they show."""

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
EXCESS = 0.02  # of the best mean square error, which is 1 % of the RMSE: a smaller excess does not count
CHANGE = 0.01  # of the error: tuning that changes it less changes nothing


def verdict(runs: pd.DataFrame, error: str) -> str:
    """Which method has the smallest error over these runs, and which of the others it cannot be told from.

    Only the methods with the fewest failures can be named. Each other method is compared with the one named on the
    instances they share: it counts as worse where the 95 % bootstrap interval of its paired excess in squared error
    lies above 2 % of the best mean square, which is 1 % of the RMSE. Where a run found too few or too many sources,
    which flatters its error of those matched, all are compared by their GOSPA instead.
    """
    ok = runs[runs["status"] == Status.OK]
    by = ""
    counted = {"sources", "sources_found"} <= set(ok.columns)
    if error == "rmse_m" and counted and (ok["sources_found"] - ok["sources"]).any():
        by, error = "Not all found the true number of sources, so by gospa_m: ", "gospa_m"
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
            f"{found}), but {pairs} {'repetition does' if pairs == 1 else 'repetitions do'} not rank methods: "
            f"set repetitions to {MIN_RUNS} or more, better 100."
        )
    few = [method for method in others if len((squares[method] - squares[best]).dropna()) < MIN_RUNS]
    level = [method for method in others if method not in few and not _worse(squares[method], squares[best])]
    told = f"not told from it: {', '.join(level)}" if level else "every other method is worse by more than 1\u00a0%"
    if few:
        told += f"; too rarely ok to compare: {', '.join(few)}"
    return f"{found}, {pairs} repetitions); {told} (95\u00a0% paired bootstrap)."


def _worse(squares: pd.Series[float], best: pd.Series[float]) -> bool:
    excess = (squares - best).dropna().to_numpy()
    low, _ = percentile_interval(bootstrap(mean, excess, rng=np.random.default_rng(0), resamples=RESAMPLES))
    return bool(low > EXCESS * best.mean())


def judge(default: Float[ndarray, " scenes"], tuned: Float[ndarray, " scenes"]) -> str:
    """What paired errors say: by what factor tuning changes them, and whether that can be told from none.

    The factor is the geometric mean of tuned/default over scenes where both have an error, with the 95 % percentile
    bootstrap interval over scenes. It counts where the interval lies beyond 1 % of no change.
    """
    logs = np.log(tuned) - np.log(default)
    logs = logs[~np.isnan(logs)]
    n = len(logs)
    if n < MIN_RUNS:
        return f"{n} held-out scenes with both errors do not tell: take {MIN_RUNS} or more, better 100."
    means = bootstrap(mean, logs, rng=np.random.default_rng(0), resamples=RESAMPLES)
    factor, low, high = np.exp([logs.mean(), *percentile_interval(means)])
    interval = f"95\u00a0% paired bootstrap {low:.3g} – {high:.3g}"
    found = f"{factor:.3g} times the default's error on {n} held-out scenes ({interval})"
    if high < 1 - CHANGE:
        return f"The tuned setting has {found}: it is better."
    if low > 1 + CHANGE:
        return f"The tuned setting has {found}: it is worse, and only fitted the training scenes. Keep the default."
    if low >= 1 - CHANGE and high <= 1 + CHANGE:
        return f"The tuned setting has {found}: that is the same within {CHANGE:.0%}. Keep the default."
    return f"The tuned setting has {found}: they cannot be told apart. Take more scenes, or keep the default."
