"""Compares two folders of one study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from nfbench.analysis import default_groups
from nfbench.core import StoreError

from .results import Results

__all__ = ["Comparison", "compare"]

ROUNDING = 1e-9  # relative: what another BLAS or CPU may change without anybody minding
COMPARED = ("objective", "evaluations")


@dataclass(frozen=True)
class Comparison:
    """What two folders of one study have in common and where they differ.

    only_first, only_second: runs that one folder alone has. rows: runs of both that differ, with the columns
    ``<name>_first``, ``<name>_second`` and ``change`` (greatest relative difference of a number; inf where the status
    differs). equal, rounding: runs identical to the bit, and those within 1e-9. methods: where rows differ, each
    method's RMSE in both folders and whether the second lies outside the first's 95 % interval.
    """

    equal: int
    rounding: int
    only_first: int
    only_second: int
    rows: pd.DataFrame
    methods: pd.DataFrame

    @property
    def matters(self) -> bool:
        """Whether a method's RMSE moved out of its 95 % interval, a status changed, or runs are missing."""
        statuses = bool(len(self.rows)) and bool(np.isinf(self.rows["change"]).any())
        moved = bool(len(self.methods)) and bool(self.methods["outside"].any())
        return statuses or moved or bool(self.only_first or self.only_second)


def compare(first: str | Path, second: str | Path) -> Comparison:
    """Compare the runs of two folders, matched by what was asked for: scenario point, method and repetition.

    Raises StoreError where a folder holds no results.
    """
    one, two = Results(Path(first)), Results(Path(second))
    a, b, error = one.runs, two.runs, one.meta["error"]
    key = [name for name in a.columns if name.startswith("scenario.")] + ["method", "repetition"]
    if lacking := [name for name in key if name not in b.columns]:
        raise StoreError(f"{first} and {second} sweep different keys: {', '.join(lacking)} only in the first")
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
    """The greatest relative difference of each row's numbers, inf where the statuses differ."""
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
    groups = default_groups(one.runs)
    columns = [*groups, error, f"{error}_low", f"{error}_high"]
    table = one.summary()[columns].merge(two.summary()[[*groups, error]], on=groups, suffixes=("_first", "_second"))
    outside = (table[f"{error}_second"] < table[f"{error}_low"]) | (table[f"{error}_second"] > table[f"{error}_high"])
    return table.assign(outside=outside)
