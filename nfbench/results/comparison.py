"""Compares two results folders of the same study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from nfbench.analysis import PairedChange, holm, paired_change, swept_columns
from nfbench.core import Status, StoreError

from .results import Results

__all__ = ["Comparison", "compare"]

ALPHA = 0.05  # for all methods and swept points together
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
    methods: for each swept point and method the median error in both folders, the typical ratio second ÷ first with its
    95 % interval and the p-value of no change, whether it is significant among all methods and points together (column
    ``changed``), and whether there are too few scenes to say (column ``unknown``); empty if no rows differ.
    notes: sentences about differences between the studies themselves.
    """

    equal: int
    rounding: int
    only_first: int
    only_second: int
    rows: pd.DataFrame
    methods: pd.DataFrame
    notes: tuple[str, ...] = ()

    @property
    def matters(self) -> bool:
        """Whether a method's error has changed significantly, a status changed, or a folder lacks runs."""
        statuses = bool(len(self.rows)) and bool(np.isinf(self.rows["change"]).any())
        moved = bool(len(self.methods)) and bool(self.methods["changed"].any())
        return statuses or moved or bool(self.only_first or self.only_second)

    @property
    def undecided(self) -> bool:
        """Whether the data do not tell if the difference matters: too few scenes, or no run in both folders."""
        unknown = bool(len(self.methods)) and bool(self.methods["unknown"].any())
        return not self.matters and (unknown or not (self.equal or self.rounding or len(self.rows)))


def compare(first: str | Path, second: str | Path) -> Comparison:
    """Compare the runs of two folders. Runs are matched by scenario point, method and repetition.

    Raises StoreError if a folder holds no results, or if they belong to different studies: another name, seed or error
    measure, or other swept keys. Another manifest or plugin version is noted.
    """
    one, two = Results(Path(first)), Results(Path(second))
    error, notes = _same_study(one, two)
    a, b = one.runs, two.runs
    key = [*swept_columns(a), "method", "repetition"]
    for lacking, which in ((set(key) - set(b.columns), "first"), (set(swept_columns(b)) - set(key), "second")):
        if lacking and len(a) and len(b):
            raise StoreError(
                f"cannot compare {first} with {second}: only the {which} sweeps {', '.join(sorted(lacking))}"
            )
    key = [name for name in key if name in b.columns]
    both = _objects(a, key).merge(_objects(b, key), on=key, how="outer", suffixes=("_first", "_second"), indicator=True)
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
        methods=_methods(joined, key[:-2], error) if len(rows) else pd.DataFrame(),
        notes=tuple(notes),
    )


def _same_study(one: Results, two: Results) -> tuple[str, list[str]]:
    """The error measure, and sentences about what differs. Raises StoreError if the studies are different ones."""
    ours, theirs = one.meta, two.meta
    differing = [
        f"{key} {ours[key]!r:.80} and {theirs[key]!r:.80}"
        for key in ("name", "seed", "error")
        if ours[key] != theirs[key]
    ]
    if differing:
        raise StoreError(f"cannot compare {one.folder} with {two.folder}: different studies: {'; '.join(differing)}")
    notes = []
    if ours.get("plan") != theirs.get("plan"):
        notes.append("The folders plan different runs: their manifests or the versions of plugins differ.")
    if ours.get("scenarios") != theirs.get("scenarios"):
        notes.append("The scenes differ: an option of the scenario has changed.")
    return ours["error"], notes


def _objects(runs: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """The runs with these columns as objects, because pandas does not join numbers with text."""
    return runs.astype(dict.fromkeys(names, object))


def _change(joined: pd.DataFrame, names: list[str]) -> pd.Series[float]:
    """The greatest relative difference among each row's numbers; inf where the statuses differ."""
    change = np.zeros(len(joined))
    for name in names:
        x, y = (joined[f"{name}_{side}"].to_numpy(dtype=float) for side in ("first", "second"))
        scale = np.maximum(np.abs(x), np.abs(y))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            relative = np.where((x == y) | (np.isnan(x) & np.isnan(y)), 0.0, np.abs(x - y) / scale)
        change = np.maximum(change, np.where(np.isnan(relative), np.inf, relative))
    same_status = joined["status_first"] == joined["status_second"]
    return pd.Series(np.where(same_status, change, np.inf), index=joined.index)


def _methods(joined: pd.DataFrame, swept: list[str], error: str) -> pd.DataFrame:
    """How each method's error changes at each swept point, over the scenes that both folders have."""
    if f"{error}_first" not in joined.columns:
        return pd.DataFrame()
    rows = []
    for key, runs in joined.groupby([*swept, "method"], sort=False, dropna=False):
        first, second = (_errors(runs, error, side) for side in ("first", "second"))
        negative = bool((np.minimum(first, second) < 0).any())  # such errors have no ratios
        found = PairedChange(np.nan, np.nan, np.nan, 1.0, len(first))
        if not negative:
            found = paired_change(first[None], second[None])
        differ = not np.allclose(first, second, rtol=ROUNDING, atol=0.0)
        row = dict(zip([*swept, "method"], key, strict=True))
        row |= {f"{error}_first": _median(first), f"{error}_second": _median(second)}
        row |= {"ratio": found.ratio, "low": found.low, "high": found.high, "p": found.p}
        rows.append({**row, "scenes": found.scenes, "unknown": differ and (negative or not found.can_be_judged)})
    table = pd.DataFrame(rows)
    return table.assign(changed=holm(table["p"].to_numpy()) <= ALPHA) if rows else table


def _errors(runs: pd.DataFrame, error: str, side: str) -> np.ndarray:
    """The median error of each scene; infinite for failed runs."""
    values = runs[f"{error}_{side}"].to_numpy(dtype=float)
    failed = (runs[f"status_{side}"] != Status.OK).to_numpy() | np.isnan(values)
    return pd.Series(np.where(failed, np.inf, values)).groupby(runs["scene_first"].to_numpy()).median().to_numpy()


def _median(errors: np.ndarray) -> float:
    return float(np.median(errors)) if len(errors) else float("nan")
