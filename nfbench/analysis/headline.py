"""The answer of a study in two sentences, and how hard each of its scenes is."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from .outcomes import Outcomes
from .ranking import Block
from .sentences import cost_text, names

__all__ = ["headline", "scene_table"]


def headline(block: Block, rows: pd.DataFrame) -> tuple[str, str]:
    """Return two sentences on a block of a ranking: which method at what cost, and how sure that is.

    block: the ranking at one swept point or over all of them. rows: its rows in the frame of the ranking.
    """
    n, k = block.n, len(block.methods)
    if n == 0:
        return f"No scene was finished by all {k} methods.", "Nothing is ranked yet."
    if not block.order:
        best = min(range(k), key=lambda i: (-float(rows["solved_share"].iloc[i]), float(rows["mean_rank"].iloc[i])))
        if k == 1:
            return f"{_record(block, rows, best)}.", f"It is the only method, so nothing is compared; {_scenes(n)}."
        return (
            f"No method can be recommended yet: {_scenes(n)} cannot rank {k} methods, {block.needed} would.",
            f"So far, {_record(block, rows, best)}; this order may change with more scenes.",
        )
    first, *rest = block.order
    cost = cost_text(block, first)
    record = _record(block, rows, first).removeprefix(block.methods[first]).strip()
    which = f"Use {block.methods[first]}: it {record}{f' and needs {cost}' if cost else ''}."
    if k == 1:
        return f"{_record(block, rows, first)}.", f"It is the only method, so nothing is compared; {_scenes(n)}."
    parts = []
    if rest:
        parts.append(f"{names([block.methods[i] for i in rest])} cannot be distinguished from it")
    if len(rest) < k - 1:
        parts.append(f"{_beaten(block)} (the risk of any wrong exclusion is at most 5 %)")
    return which, f"On {_scenes(n)}, {'; '.join(parts)}."


WORSE = {"reliability": "less reliable", "error": "less accurate", "cost": "more expensive"}  # by stage


def _beaten(block: Block) -> str:
    """How many methods each stage of the ranking has excluded: "5 of the other 9 methods are significantly less …"."""
    inside, lost = np.ones(len(block.methods), dtype=bool), []
    for stage in block.stages:
        lost.append((int(np.sum(inside & ~stage.best.inside)), WORSE[stage.name]))
        inside = stage.best.inside
    lost = [(count, how) for count, how in lost if count]
    total = sum(count for count, _ in lost)
    if len(lost) == 1:
        which = "the other method is" if total == 1 else f"the other {total} methods are"
        return f"{which} significantly {lost[0][1]}"
    (count, how), *more = lost
    first = f"{count} of the other {total} methods {'is' if count == 1 else 'are'} significantly {how}"
    return names([first, *(f"{count} {how}" for count, how in more)])


def _record(block: Block, rows: pd.DataFrame, i: int) -> str:
    """What a method has reached: "a reached error ≤ 3 bounds in 98 % of runs (95 % interval 90–100 %)"."""
    row = rows.iloc[i]
    target = block.points[0].target
    goal = f"reached {target}" if target else "ended with an estimate"
    share, low, high = (float(row[name]) for name in ("solved_share", "solved_low", "solved_high"))
    interval = "" if math.isnan(low) else f" (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    return f"{block.methods[i]} {goal} in {100 * share:.0f} % of its runs{interval}"


def scene_table(outcomes: Outcomes) -> pd.DataFrame:
    """Return one row per scene of a swept point, the hardest first.

    The columns are ``scene``; ``share``, the mean over the methods of the share of their runs that hit the first
    target; ``solved_by``, the number of methods that hit it in all runs; and ``median_error`` and ``best_error``, over
    the methods. Scenes with equal shares are in the order of their median error, the largest first.
    """
    shares = outcomes.hits / np.maximum(outcomes.runs, 1)
    frame = pd.DataFrame(
        {
            "scene": list(outcomes.scenes),
            "share": shares.mean(axis=1),
            "solved_by": (outcomes.hits == outcomes.runs).sum(axis=1),
            "median_error": np.median(outcomes.error, axis=1) if outcomes.error.size else [],
            "best_error": outcomes.error.min(axis=1) if outcomes.error.size else [],
        }
    )
    return frame.sort_values(["share", "median_error"], ascending=[True, False], kind="stable", ignore_index=True)


def _scenes(n: int) -> str:
    return f"{n} scene{'' if n == 1 else 's'}"
