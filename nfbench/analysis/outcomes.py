"""What the runs of a study come to, one number per scene and method: error, hits and cost at each swept point."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from nfbench.core import Status

__all__ = ["Outcomes", "Point", "common", "outcomes"]

Swept = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The outcomes of k methods on n common scenes at one swept point.

    methods: labels, (k,). scenes: identities of the common scenes, (n,). error: median over the runs, ∞ where a run has
    no estimate, (n, k). runs: runs per scene, (k,). hits: number of runs that hit the first target, (n, k). cost:
    evaluations to that hit, median over the runs, ∞ without, (n, k). spent: evaluations up to the hit or end, summed
    over the runs, (n, k). cap: the most evaluations that a run may spend, ∞ without a limit, (k,). target: label of the
    first target. left_out: number of scenes that some methods have not finished, or to which the target does not apply.
    error_name: what the error is, for texts. columns: further values, median over the runs, ∞ where missing, (n, k)
    each. failed, ended: number of runs without an estimate, (n, k), and of runs by status, (n, k) each.
    """

    methods: tuple[str, ...]
    scenes: tuple[Hashable, ...]
    error: Float[ndarray, "n k"]
    runs: Int[ndarray, " k"]
    hits: Int[ndarray, "n k"]
    cost: Float[ndarray, "n k"]
    spent: Float[ndarray, "n k"]
    cap: Float[ndarray, " k"]
    target: str = ""
    left_out: int = 0
    error_name: str = "error"
    columns: Mapping[str, Float[ndarray, "n k"]] = field(default_factory=dict)
    failed: Int[ndarray, "n k"] | None = None
    ended: Mapping[str, Int[ndarray, "n k"]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape, k = (len(self.scenes), len(self.methods)), len(self.methods)
        per_scene = {name: getattr(self, name) for name in ("error", "hits", "cost", "spent")}
        per_scene |= dict(self.columns) | dict(self.ended)
        for name, values in per_scene.items():
            if values.shape != shape:
                raise ValueError(f"{name}: expected the shape (scenes, methods) = {shape}, got {values.shape}")
            if np.isnan(values).any():
                raise ValueError(f"{name}: expected numbers or ∞, got NaN")
        if self.runs.shape != (k,) or self.cap.shape != (k,):
            raise ValueError(f"runs, cap: expected the shape ({k},), got {self.runs.shape} and {self.cap.shape}")
        if ((self.hits < 0) | (self.hits > self.runs)).any():
            raise ValueError(f"hits: expected 0 to runs per scene, got {self.hits.min()} to {self.hits.max()}")

    def select(self, scenes: Iterable[Hashable] | None = None, methods: Iterable[str] | None = None) -> Outcomes:
        """Return the outcomes of these scenes and methods, in their order; None for all.

        Raises ValueError if one is missing.
        """
        rows = self._positions(self.scenes, scenes, "scenes")
        cols = self._positions(self.methods, methods, "methods")
        part = np.ix_(rows, cols)
        return Outcomes(
            methods=tuple(self.methods[c] for c in cols),
            scenes=tuple(self.scenes[r] for r in rows),
            error=self.error[part],
            runs=self.runs[cols],
            hits=self.hits[part],
            cost=self.cost[part],
            spent=self.spent[part],
            cap=self.cap[cols],
            target=self.target,
            left_out=self.left_out + len(self.scenes) - len(rows),
            error_name=self.error_name,
            columns={name: values[part] for name, values in self.columns.items()},
            failed=None if self.failed is None else self.failed[part],
            ended={name: values[part] for name, values in self.ended.items()},
        )

    @staticmethod
    def _positions(known: tuple[Any, ...], wanted: Iterable[Any] | None, name: str) -> list[int]:
        if wanted is None:
            return list(range(len(known)))
        where = {item: position for position, item in enumerate(known)}
        wanted = list(wanted)
        if missing := [item for item in wanted if item not in where]:
            raise ValueError(f"{name}: expected some of {', '.join(map(str, known))}, got {missing[0]}")
        return [where[item] for item in wanted]


Point = tuple[Swept, Outcomes]


def common(points: Sequence[Point]) -> list[Point]:
    """Return the points restricted to the methods and scenes that all of them have, in the order of the first."""
    if not points:
        return []
    first = points[0][1]
    methods = [m for m in first.methods if all(m in each.methods for _, each in points)]
    everywhere = set(first.scenes).intersection(*(each.scenes for _, each in points))
    scenes = [s for s in first.scenes if s in everywhere]
    return [(swept, each.select(scenes, methods)) for swept, each in points]


def outcomes(
    runs: pd.DataFrame, hits: pd.DataFrame, error: str, swept: Sequence[str], *, columns: Sequence[str] = ()
) -> list[Point]:
    """Return the swept values and the outcomes of each swept point, in order of first appearance.

    runs: one row per run with the columns run_id, method, scene, run, status, ``error``, evaluations and the swept
    ones. hits: one row per run and target with the columns run_id, target, number, hit, evaluations, seconds, spent and
    cap; targets are numbered from 0. error: column of the error, NaN without an estimate. swept: names of the swept
    columns. columns: further columns of runs to keep. The seconds to the first target are kept as ``seconds``.

    A run counts as failed, with infinite error, unless its status is ok and it has an error. A scene takes part once
    every method has all its runs there. It is left out if hits lacks it, because the first target does not apply. Where
    that target applies to no scene of a point, a run hits if it has not failed, at no known cost. Raises ValueError for
    missing columns or an error below 0.
    """
    _expect("runs", runs, ["run_id", "method", "scene", "run", "status", error, "evaluations", *swept, *columns])
    _expect("hits", hits, ["run_id", "target", "number", "hit", "evaluations", "seconds", "spent", "cap"])
    table, target = _per_run(runs, hits, error, columns), ""
    first = hits[hits["number"] == 0]
    if len(first):
        target = str(first["target"].iloc[0])
    if not swept:
        return [({}, _outcomes(table, target, error, columns))] if len(table) else []
    found = []
    for key, group in table.groupby(list(swept), sort=False, dropna=False):
        found.append((dict(zip(swept, key, strict=True)), _outcomes(group, target, error, columns)))
    return found


def _per_run(runs: pd.DataFrame, hits: pd.DataFrame, error: str, columns: Sequence[str]) -> pd.DataFrame:
    """Return runs with the columns _error, _failed, _hit, _cost, _seconds, _spent and _cap, without NaN in these."""
    first = hits[hits["number"] == 0].drop_duplicates("run_id").set_index("run_id")
    table = runs.copy()
    ok = (table["status"] == Status.OK).to_numpy()
    value = table[error].to_numpy(dtype=np.float64, na_value=np.nan)
    if (value < 0).any():
        raise ValueError(f"{error}: expected errors of at least 0, got {np.nanmin(value)}")
    table["_failed"] = ~ok | np.isnan(value)
    table["_error"] = np.where(table["_failed"], np.inf, value)

    def joined(name: str) -> Float[ndarray, " rows"]:
        return table["run_id"].map(first[name]).to_numpy(dtype=np.float64, na_value=np.nan)

    table["_known"] = table["run_id"].isin(first.index)
    hit = np.nan_to_num(joined("hit"), nan=0.0) > 0
    evaluations = np.nan_to_num(table["evaluations"].to_numpy(dtype=np.float64, na_value=np.nan), nan=0.0)
    spent, cap = joined("spent"), joined("cap")
    to_hit, seconds = joined("evaluations"), joined("seconds")
    table["_hit"] = hit
    table["_cost"] = np.where(hit & ~np.isnan(to_hit), to_hit, np.inf)
    table["_seconds"] = np.where(hit & ~np.isnan(seconds), seconds, np.inf)
    spent = np.where(np.isnan(spent), evaluations, spent)
    table["_spent"] = np.where(np.isfinite(table["_cost"]), np.minimum(table["_cost"], spent), spent)
    table["_cap"] = np.where(np.isnan(cap), np.inf, cap)
    for name in columns:
        numbers = table[name].to_numpy(dtype=np.float64, na_value=np.nan)
        table[f"_column {name}"] = np.where(~ok | np.isnan(numbers), np.inf, numbers)
    return table


def _outcomes(table: pd.DataFrame, target: str, error: str, columns: Sequence[str]) -> Outcomes:
    """Return the outcomes of one swept point from the rows of :func:`_per_run`."""
    methods = list(dict.fromkeys(table["method"]))
    if not table["_known"].any():  # no target applies here
        target, table = "", table.assign(_hit=~table["_failed"], _known=True)
    count = table.pivot_table(index="scene", columns="method", values="run", aggfunc="count", fill_value=0, sort=False)
    count = count[methods]
    per_method = count.max()
    known = table.groupby("scene")["_known"].any().reindex(count.index).to_numpy(dtype=bool)
    complete: Bool[ndarray, " scenes"] = (count == per_method).all(axis=1).to_numpy() & known
    scenes = count.index[complete]

    def values(name: str, how: str) -> Float[ndarray, "n k"]:
        wide = table.pivot_table(index="scene", columns="method", values=name, aggfunc=how, sort=False)  # type: ignore[arg-type]
        return wide.reindex(index=scenes, columns=methods).to_numpy(dtype=np.float64)

    statuses = {str(status): table["status"] == status for status in dict.fromkeys(table["status"])}
    table = table.assign(**{f"_status {name}": rows.astype(int) for name, rows in statuses.items()})
    cap = table.groupby("method")["_cap"].max().reindex(methods).to_numpy(dtype=np.float64)
    return Outcomes(
        methods=tuple(map(str, methods)),
        scenes=tuple(scenes),
        error=values("_error", "median"),
        runs=per_method.to_numpy(dtype=np.int64),
        hits=values("_hit", "sum").astype(np.int64),
        cost=values("_cost", "median"),
        spent=values("_spent", "sum"),
        cap=cap,
        target=target,
        left_out=int((~complete).sum()),
        error_name=error,
        columns={
            "seconds": values("_seconds", "median"),
            **{name: values(f"_column {name}", "median") for name in columns},
        },
        failed=values("_failed", "sum").astype(np.int64),
        ended={name: values(f"_status {name}", "sum").astype(np.int64) for name in statuses},
    )


def _expect(name: str, table: pd.DataFrame, columns: Sequence[str]) -> None:
    if missing := [column for column in dict.fromkeys(columns) if column not in table.columns]:
        raise ValueError(f"{name}: expected the columns {', '.join(columns)}; missing: {', '.join(missing)}")
