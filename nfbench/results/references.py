"""The proven optima of a study as a table, what gaps are measured from, and which proofs the runs contradict."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.core import Status
from nfbench.study import swept_column

from .cells import cell
from .reference_table import COLUMNS
from .values import settings

__all__ = [
    "Key",
    "Proof",
    "canonical",
    "judged",
    "label_of",
    "origin_of_gaps",
    "problems",
    "proofs",
    "reference_frame",
    "with_optimum",
]

ROUNDING = 1e-9  # of max(1, |value|): two values that differ by less are computed by different code, and are equal
Key: TypeAlias = tuple[Any, ...]
_PLAIN = ("scene", "instance_seed", "formulation", "status", "message", "value", "gap", "certified", "step", "seconds")


@dataclass(frozen=True)
class Proof:
    """What is proven about the optimum of a problem: the smallest value found, and a bound on how far it is above it.

    value: smallest value that the proof has found. gap: bound on value minus minimum. certified: whether it is proven.
    """

    value: float
    gap: float
    certified: bool

    def holds(self, best: float) -> bool:
        """Whether the value is proven, and ``best``, the best value of any run, does not contradict it."""
        lowest = self.value - self.gap - ROUNDING * max(1.0, abs(self.value))
        return self.certified and not best < lowest

    def reference(self, best: float) -> float:
        """The reference optimum, given the best value of any run."""
        return self.value if self.holds(best) else min(best, self.value)


def reference_frame(rows: Iterable[tuple[Any, ...]]) -> pd.DataFrame:
    """One row per finished proof, from the columns of ``ReferenceTable.finished``."""
    found = [dict(zip(COLUMNS, row, strict=True)) for row in rows]
    swept = settings(found[0]["swept"]) if found else {}
    others = list(dict.fromkeys(name for row in found for name in sorted(row["columns"])))
    unknowns = max((len(row["point"] or ()) for row in found), default=0)
    table: dict[str, Any] = {"reference_id": [row["reference_id"] for row in found]}
    table |= {swept_column(key): [cell(settings(row["swept"])[key]) for row in found] for key in swept}
    table |= {name: [row[name] for row in found] for name in _PLAIN}
    table |= {name: [row["columns"].get(name, math.nan) for row in found] for name in others}
    for j in range(unknowns):
        table[f"x_{j}"] = [row["point"][j] if row["point"] and j < len(row["point"]) else math.nan for row in found]
    numbers = dict.fromkeys(("value", "gap", "seconds"), np.float64)
    return pd.DataFrame(table).astype({**numbers, "certified": bool, "scene": int, "step": int, "instance_seed": int})


def problems(frame: pd.DataFrame) -> list[Key]:
    """The identity of the first problem of each run or proof: point of the sweep, scene and formulation."""
    swept = [name for name in frame.columns if name.startswith("scenario.")]
    scene = frame["scene"] if "scene" in frame.columns else frame["repetition"]  # in older folders
    columns = [*(frame[name] for name in swept), frame["instance_seed"], frame["formulation"], scene]
    return list(zip(*(column.tolist() for column in columns), strict=True))


def proofs(references: pd.DataFrame) -> dict[Key, Proof]:
    """The proofs that have given a value, by problem."""
    about = zip(references["value"].tolist(), references["gap"].tolist(), references["certified"].tolist(), strict=True)
    ok = (references["status"] == Status.OK).tolist()
    found = zip(problems(references), ok, about, strict=True)
    return {key: Proof(*row) for key, is_ok, row in found if is_ok and math.isfinite(row[0])}


def judged(references: pd.DataFrame, runs: pd.DataFrame, bests: ndarray) -> pd.DataFrame:
    """The references with what the runs say about them: the columns of ``references.csv``.

    ``best_found`` is the best value that any run has found for the problem, and ``contradicted_by`` names the methods
    with a better value than the certified one, beyond its gap and rounding, the best first. Such a certificate is
    wrong; the proof, and not the method, is at fault.

    bests: best value of each run's first problem, (runs,); NaN where there is none.
    """
    found: dict[Key, list[tuple[float, str]]] = {}
    for key, best, method in zip(problems(runs), bests.tolist(), runs["method"].tolist(), strict=True):
        if not math.isnan(best):
            found.setdefault(key, []).append((best, method))
    proven = proofs(references)
    lowest, against = [], []
    for key in problems(references):
        values, proof = sorted(found.get(key, [])), proven.get(key)
        lowest.append(values[0][0] if values else math.nan)
        wrong = [name for value, name in values if proof and proof.certified and not proof.holds(value)]
        against.append("; ".join(dict.fromkeys(wrong)))
    return references.assign(best_found=np.array(lowest, dtype=np.float64), contradicted_by=against)


def with_optimum(runs: pd.DataFrame, references: pd.DataFrame) -> pd.DataFrame:
    """The runs with the certified optimum in ``optimum`` where none is known; ``references`` is that of ``judged``."""
    sound = references[references["certified"] & (references["contradicted_by"] == "")]
    values = {key: proof.value for key, proof in proofs(sound).items()}
    if not values:
        return runs
    solved = (runs["solver"] != "").tolist()
    proven = [values.get(key, math.nan) if use else math.nan for key, use in zip(problems(runs), solved, strict=True)]
    known = runs["optimum"].to_numpy(dtype=np.float64) if "optimum" in runs.columns else np.full(len(runs), np.nan)
    return runs.assign(optimum=np.where(np.isnan(known), proven, known))


def origin_of_gaps(runs: pd.DataFrame, table: pd.DataFrame) -> str:
    """What the gaps of these runs are measured from, in words.

    table: the same rows with the certified optima. "best known value" is said if it is so in any scene.
    """
    solved = (runs["solver"] != "").to_numpy()
    for name, frame in (("known minimum", runs), ("proven optimum", table)):
        if solved.any() and "optimum" in frame.columns and frame["optimum"].notna().to_numpy()[solved].all():
            return name
    return "best known value"


def label_of(row: dict[Any, Any]) -> str:
    """Where a proof belongs, in words: its formulation, scene and swept values."""
    swept = [f"{key.removeprefix('scenario.')} = {value}" for key, value in row.items() if key.startswith("scenario.")]
    return ", ".join([f"{row['formulation']}, scene {row['scene']}", *swept])


def canonical(references: pd.DataFrame) -> str:
    """What the gaps of runs depend on, as text."""
    names = ["reference_id", "formulation", "status", "value", "gap", "certified"]
    return json.dumps([references[name].tolist() for name in names])
