"""Compares two results folders of the same study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from nfbench.analysis import default_groups
from nfbench.core import StoreError

from .results import Results

__all__ = ["Comparison", "compare"]

ROUNDING = 1e-9  # relative difference that another BLAS or CPU may cause
COMPARED = ("objective", "evaluations")


@dataclass(frozen=True)
class Comparison:
    """Which runs of two results folders agree, and which differ.

    equal: number of runs with the same status, error, objective and evaluations, bit for bit.
    rounding: number of runs whose relative difference is at most 1e-9.
    only_first, only_second: number of runs that only this folder has.
    rows: the runs that differ by more, with the columns ``<name>_first``, ``<name>_second`` and ``change``, the
    greatest relative difference of a number (inf if the status differs, or only one of the numbers is finite).
    methods: each method's error in both folders, and whether the second lies outside the first's 95 % interval
    (column ``outside``); empty if no rows differ.
    """

    equal: int
    rounding: int
    only_first: int
    only_second: int
    rows: pd.DataFrame
    methods: pd.DataFrame

    @property
    def matters(self) -> bool:
        """Whether a method's error left its 95 % interval, a status changed, or a folder lacks runs."""
        statuses = bool(len(self.rows)) and bool(np.isinf(self.rows["change"]).any())
        moved = bool(len(self.methods)) and bool(self.methods["outside"].any())
        return statuses or moved or bool(self.only_first or self.only_second)


def compare(first: str | Path, second: str | Path) -> Comparison:
    """Compare the runs of two folders. Runs are matched by scenario point, method and repetition.

    Raises StoreError if a folder holds no results, or if the second does not sweep all keys of the first.
    """
    one, two = Results(Path(first)), Results(Path(second))
    a, b, error = one.runs, two.runs, one.meta["error"]
    key = [name for name in a.columns if name.startswith("scenario.")] + ["method", "repetition"]
    if lacking := [name for name in key if name not in b.columns]:
        raise StoreError(f"cannot compare {first} with {second}: only the first sweeps {', '.join(lacking)}")
    both = a.merge(b, on=key, how="outer", suffixes=("_first", "_second"), indicator=True)
    joined = both[both["_merge"] == "both"]
    names = [name for name in (error, *COMPARED) if f"{name}_first" in joined.columns]
    change = _change(joined, names)
    differing = joined[change > ROUNDING]
    shown = key + [f"{name}_{side}" for name in ("status", *names) for side in ("first", "second")]
    rows = differing[shown].assign(change=change[change > ROUNDING])
    return Comparison(
        equal=int((change == 0).sum()),
        rounding=int(((change > 0) & (change <= ROUNDING)).sum()),
        only_first=int((both["_merge"] == "left_only").sum()),
        only_second=int((both["_merge"] == "right_only").sum()),
        rows=rows,
        methods=_methods(one, two, error) if len(rows) else pd.DataFrame(),
    )


def _change(joined: pd.DataFrame, names: list[str]) -> pd.Series[float]:
    """The greatest relative difference among each row's numbers; inf where the statuses differ."""
    change = np.zeros(len(joined))
    for name in names:
        x, y = (joined[f"{name}_{side}"].to_numpy(dtype=float) for side in ("first", "second"))
        scale = np.maximum(np.abs(x), np.abs(y))
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = np.where((x == y) | (np.isnan(x) & np.isnan(y)), 0.0, np.abs(x - y) / scale)
        change = np.maximum(change, np.where(np.isnan(relative), np.inf, relative))
    same_status = joined["status_first"] == joined["status_second"]
    return pd.Series(np.where(same_status, change, np.inf), index=joined.index)


def _methods(one: Results, two: Results, error: str) -> pd.DataFrame:
    """Each method's error in both folders at each scenario point."""
    groups = default_groups(one.runs)
    columns = [*groups, error, f"{error}_low", f"{error}_high"]
    table = one.summary()[columns].merge(two.summary()[[*groups, error]], on=groups, suffixes=("_first", "_second"))
    outside = (table[f"{error}_second"] < table[f"{error}_low"]) | (table[f"{error}_second"] > table[f"{error}_high"])
    return table.assign(outside=outside)
