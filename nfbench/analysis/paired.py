"""Compares two sets of runs on the same scenes: two results of one study, or a tuned setting with the default."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .intervals import ratio_interval
from .sign_flips import log_ratios, mean_over_points, sign_flip_pvalue, signed_ranks

__all__ = ["PairedChange", "paired_change", "tuning_verdict"]

ALPHA = 0.05
CHANGE = 0.01  # relative change of the error below which tuning counts as having no effect


@dataclass(frozen=True)
class PairedChange:
    """How errors change from a first to a second set of runs on the same scenes.

    ratio: typical ratio second ÷ first, the Hodges–Lehmann estimate over the scenes. low, high: ends of its 95 %
    interval, NaN for fewer than 6 scenes. p: two-sided p-value of no change, exact. scenes: number of scenes.
    """

    ratio: float
    low: float
    high: float
    p: float
    scenes: int

    @property
    def can_be_judged(self) -> bool:
        """Whether this many scenes could show any change."""
        return 2.0 ** (1 - self.scenes) <= ALPHA


def paired_change(first: Float[ndarray, "points n"], second: Float[ndarray, "points n"]) -> PairedChange:
    """Compare two sets of errors, (points, n), one row per swept point and one column per scene; ∞ for failed runs.

    Scores are summed over the points of a scene, since the points share their scenes. Raises ValueError for NaN.
    """
    scores = signed_ranks(log_ratios(second, first)).sum(axis=0)
    logs = log_ratios(second, first, ties=False)
    ratio, low, high = ratio_interval(mean_over_points(logs)) if logs.size else (math.nan,) * 3
    return PairedChange(ratio, low, high, sign_flip_pvalue(scores), logs.shape[1])


def tuning_verdict(default: Float[ndarray, "points n"], tuned: Float[ndarray, "points n"]) -> str:
    """State the factor by which tuning changes the error, and whether the change is significant.

    default, tuned: errors of the two settings on the same scenes, (points, n); NaN where a run has no error. A run
    without an error counts as worse than any other.
    """
    before, after = (np.where(np.isnan(errors), np.inf, errors) for errors in (default, tuned))
    found = paired_change(before, after)
    failed = [int(np.isinf(errors).any(axis=0).sum()) for errors in (before, after)]
    if not found.can_be_judged:
        return f"{found.scenes} held-out scenes are too few to compare: use at least 6, better 100."
    interval = f"95\u00a0% interval {found.low:.3g} – {found.high:.3g}, p = {found.p:.2g}"
    text = f"{found.ratio:.3g} times the default's error on {found.scenes} held-out scenes ({interval})"
    if any(failed):
        text += f" (failures: {failed[1]} of the tuned setting, {failed[0]} of the default)"
    if found.low >= 1 - CHANGE and found.high <= 1 + CHANGE:
        return f"The tuned setting has {text}: they are the same within {CHANGE:.0%}. Keep the default."
    if found.p > ALPHA:
        return f"The tuned setting has {text}: the difference is not significant. Use more scenes, or keep the default."
    if found.ratio < 1 and failed[1] > failed[0]:
        return f"The tuned setting has {text}: a trade-off, as the lower error comes with more failures."
    if found.ratio < 1:
        return f"The tuned setting has {text}: it is better."
    return f"The tuned setting has {text}: it is worse, as it fits only the training scenes. Keep the default."
