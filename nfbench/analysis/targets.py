"""Targets, which say what counts as solved, and the table of how often and at what cost methods reach them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from .intervals import bounded_mean_interval, ert, ert_interval, share_interval

__all__ = [
    "Kind",
    "Target",
    "default_targets",
    "first_reached",
    "parse_targets",
    "quantile",
    "reached_for_good",
    "swept_columns",
    "target_table",
]

Kind: TypeAlias = Literal["gap", "error", "error_in_bounds"]
KINDS: tuple[Kind, ...] = get_args(Kind)

GAPS = (1e-2, 1e-4, 1e-6)
BOUNDS = (10.0, 3.0)
SMALLEST_S = 1e-6  # [s], less than any evaluation takes; a scene cannot be solved in less


@dataclass(frozen=True)
class Target:
    """What counts as solved.

    kind: "gap", best value so far minus the reference optimum of the problem, in the unit of the objective; "error",
        the study's error measure of the estimate, in its unit; or "error_in_bounds", that error divided by the
        Cramér–Rao bound of the scene.
    value: largest gap, error or ratio that counts as solved, above 0.

    Raises ValueError if the kind is unknown or the value is not a finite number above 0.
    """

    kind: Kind
    value: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if isinstance(self.value, bool) or not isinstance(self.value, int | float) or not 0 < self.value < math.inf:
            raise ValueError(f"{self.kind}: expected a finite number above 0, got {self.value!r}")
        object.__setattr__(self, "value", float(self.value))

    @property
    def label(self) -> str:
        """The target as text in tables: ``gap ≤ 1e-04``, ``error ≤ 0.1`` or ``error ≤ 3 bounds``."""
        if self.kind == "gap":
            return f"gap ≤ {np.format_float_scientific(self.value, trim='-', exp_digits=2)}"
        number = np.format_float_positional(self.value, trim="-") if 1e-4 <= self.value < 1e16 else f"{self.value!r}"
        unit = "" if self.kind == "error" else " bound" if self.value == 1 else " bounds"
        return f"error ≤ {number}{unit}"


def parse_targets(table: Mapping[str, Any]) -> tuple[Target, ...]:
    """Return the targets of a table such as ``{"error_in_bounds": [10, 3], "gap": 1e-4}``, in its order.

    Raises ValueError if a kind is unknown, a value is not a finite number above 0, or a target is repeated.
    """
    found: list[Target] = []
    for kind, values in table.items():
        if kind not in KINDS:
            raise ValueError(f"targets: expected the keys {', '.join(KINDS)}, got {kind!r}")
        for value in values if isinstance(values, list | tuple) else [values]:
            target = Target(kind, value)
            if target in found:
                raise ValueError(f"targets.{kind}: expected different values, got {value!r} twice")
            found.append(target)
    return tuple(found)


def default_targets(error: str, *, has_bounds: bool, outlier_m: float = 1.0) -> tuple[Target, ...]:
    """Return the targets of a study that names none.

    error: name of the score by which methods are ranked.
    has_bounds: whether the scenes have a Cramér–Rao bound, the column ``crb_m``.
    outlier_m: error above which the estimate of a source counts as an outlier, in the unit of the error.

    These are 10 and 3 bounds where there are bounds; gaps of 1e-2, 1e-4 and 1e-6 where the error is a gap; and
    otherwise errors of ``outlier_m`` and a tenth of it.
    """
    if error == "gap":
        return tuple(Target("gap", value) for value in GAPS)
    if has_bounds:
        return tuple(Target("error_in_bounds", value) for value in BOUNDS)
    return Target("error", outlier_m), Target("error", outlier_m / 10)


def first_reached(values: Float[ndarray, " r"], limit: float) -> int | None:
    """Return the first row whose value is at most ``limit``; None if there is none."""
    reached = values <= limit
    return int(reached.argmax()) if reached.any() else None


def reached_for_good(values: Float[ndarray, " r"], limit: float) -> int | None:
    """Return the first row from which on all values are at most ``limit``; None if the last one is larger."""
    beyond = ~(values <= limit)
    if not len(values) or beyond[-1]:
        return None
    return len(values) - int(beyond[::-1].argmax()) if beyond.any() else 0


def swept_columns(frame: pd.DataFrame) -> list[str]:
    """Return the columns of the swept keys, whose names begin with ``scenario.`` or ``budget.``, in order."""
    return [str(name) for name in frame.columns if str(name).startswith(("scenario.", "budget."))]


def quantile(values: Float[ndarray, " n"], q: float) -> float:
    """Return the q-quantile with linear interpolation; inf where it lies beyond the finite values. NaN if empty."""
    if not len(values):
        return math.nan
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    place = q * (len(ordered) - 1)
    lower = int(place)
    upper = min(lower + 1, len(ordered) - 1)
    low, high, weight = float(ordered[lower]), float(ordered[upper]), place - lower
    return low if not weight or low == high else low + weight * (high - low)


def target_table(hits: pd.DataFrame, groups: Sequence[str] | None = None) -> pd.DataFrame:
    """Return the rows of ``targets.csv``: how often, and at what cost, each method reaches each target.

    hits: one row per run and target, as ``nfbench.results.hits`` returns it.
    groups: columns that define the rows; None for the swept keys, method and target.

    The rows are in the order in which their group appears in ``hits``. Failed runs count as misses. Columns:

    * ``runs``, ``hits`` and ``share`` = hits/runs, with the 95 % interval ``share_low``, ``share_high`` over scenes:
      Clopper–Pearson, or that of a bounded mean if a scene has several runs.
    * ``ert``: evaluations that all runs spent until they reached the target or ended, divided by the number of hits;
      inf without a hit. ``ert_s`` is the same in seconds. ``_low`` and ``_high`` are their 95 % intervals over scenes,
      which assume that no run can spend more than ``cap`` evaluations, or more seconds than the longest run here. All
      three are NaN for a method that makes no evaluations.
    * ``median_evaluations``, ``q25_evaluations`` and ``q75_evaluations``: quantiles over all runs of the evaluations
      to the hit, inf for runs without one; ``median_seconds``, ``q25_seconds`` and ``q75_seconds`` in seconds.

    Raises ValueError if ``groups`` names a column that does not exist.
    """
    by = [*swept_columns(hits), "method", "target"] if groups is None else list(groups)
    if missing := [name for name in by if name not in hits.columns]:
        raise ValueError(
            f"groups: expected columns of hits, got {', '.join(missing)}; known: {', '.join(hits.columns)}"
        )
    rows = [
        {**dict(zip(by, key, strict=True)), **_row(group)} for key, group in hits.groupby(by, sort=False, dropna=False)
    ]
    return pd.DataFrame(rows, columns=[*by, *COLUMNS])


COLUMNS = (
    *("runs", "hits", "share", "share_low", "share_high", "ert", "ert_low", "ert_high", "ert_s", "ert_s_low"),
    *("ert_s_high", "median_evaluations", "q25_evaluations", "q75_evaluations", "median_seconds", "q25_seconds"),
    "q75_seconds",
)


def _row(group: pd.DataFrame) -> dict[str, float]:
    hit = group["hit"].to_numpy(dtype=bool)
    scene = pd.factorize(group["scene"])[0]
    runs = np.bincount(scene)
    hits = np.bincount(scene, weights=hit).astype(int)
    row: dict[str, float] = {"runs": len(hit), "hits": int(hit.sum()), "share": float(hit.mean())}
    if runs.max() == 1:
        row["share_low"], row["share_high"] = share_interval(int(hits.sum()), len(hits))
    else:
        row["share_low"], row["share_high"] = bounded_mean_interval(hits / runs, 0.0, 1.0)
    for unit, spent_by, cap, name, step in (
        ("evaluations", "spent", "cap", "ert", 1.0),
        ("seconds", "spent_s", "spent_s", "ert_s", SMALLEST_S),
    ):
        reached = group[unit].to_numpy(dtype=np.float64)
        spent = np.minimum(np.where(hit, reached, np.inf), group[spent_by].to_numpy(dtype=np.float64))
        steps = _expected(scene, spent / step, hits, runs, _largest(group[cap].to_numpy(dtype=np.float64)) / step)
        row |= {f"{name}{end}": step * value for end, value in zip(("", "_low", "_high"), steps, strict=True)}
    for unit in ("evaluations", "seconds"):
        reached = np.where(hit, group[unit].to_numpy(dtype=np.float64), np.inf)
        for name, q in (("median", 0.5), ("q25", 0.25), ("q75", 0.75)):
            row[f"{name}_{unit}"] = quantile(reached, q)
    return row


def _expected(
    scene: ndarray, spent: Float[ndarray, " n"], hits: ndarray, runs: ndarray, cap: float
) -> tuple[float, float, float]:
    """The expected running time and its interval; NaN where a cost is not known, or where nothing is spent."""
    if np.isnan(spent).any() or not spent.any():
        return math.nan, math.nan, math.nan
    total = np.bincount(scene, weights=spent)
    return (ert(total, hits), *ert_interval(total, hits, int(runs.max()), cap))


def _largest(values: Float[ndarray, " n"]) -> float:
    known = values[~np.isnan(values)]
    return float(known.max()) if len(known) else math.nan
