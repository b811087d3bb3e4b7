"""The numbers behind the figures that compare methods: measures at each point, distributions and progress."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import pandas as pd

from nfbench.analysis import ALL, Axis, Block, fixed_budget_table, runtime_distribution
from nfbench.results import Progress, find_progresses

from .study import Study, number, numbers

__all__ = [
    "FIGURES",
    "after_budget",
    "bound_of",
    "budgets",
    "distributions",
    "headings",
    "measures",
    "progress",
    "rank_rows",
]

AXES: tuple[Axis, ...] = ("evaluations", "seconds")
CELLS = 100_000  # numbers of all distributions together
FIGURES = 16  # methods whose progress is embedded
RANK_COLUMNS = ("solved_share", "solved_low", "solved_high", "error_ratio", "ratio_low", "ratio_high", "mean_rank")


def measures(study: Study) -> list[dict[str, Any]]:
    """What the figure of comparison can show: names, and the value and interval of each method at each point."""
    error, metres = study.error, study.error == "rmse_m"
    median = "median_m" if metres else f"{error}_median"
    unit = " [m]" if metres else ""
    listed: list[tuple[str, str, pd.DataFrame, float]] = [
        (median, study.label("median", f"Median error{unit}" if metres else f"Median {error}"), study.summary, 1.0),
        (error, study.label("rmse", f"RMSE{unit}" if metres else f"RMS {error}"), study.summary, 1.0),
        ("median_error_in_bounds", "Median error in bounds", study.summary, 1.0),
    ]
    if metres and (study.summary["outlier_rate"] > 0).any():
        far = f"Sources off by more than {float(study.meta['outlier_m']):g} m [%]"
        listed.append(("outlier_rate", far, study.summary, 100.0))
    for target in study.targets:
        rows = study.target_table[study.target_table["target"] == target]
        listed += [
            ("share", f"Runs that reach {study.goal(target)} [%]", rows, 100.0),
            ("ert", f"Evaluations per hit of {study.goal(target)} (ERT)", rows, 1.0),
            ("ert_s", f"Seconds per hit of {study.goal(target)} (ERT)", rows, 1.0),
        ]
    listed += [
        ("evaluations", "Evaluations per run", study.summary, 1.0),
        ("runtime_s", study.label("runtime", "Time per run [s]"), study.summary, 1.0),
    ]
    found = [_measure(study, *each) for each in listed if each[0] in each[2].columns]
    return [each for each in found if any(v not in (None, "inf") for row in each["value"] for v in row)]


def _measure(study: Study, column: str, name: str, table: pd.DataFrame, factor: float) -> dict[str, Any]:
    k, n = len(study.methods), len(study.points)
    sides = {"value": column, "low": f"{column}_low", "high": f"{column}_high"}
    arrays = {side: np.full((k, n), math.nan) for side, key in sides.items() if key in table.columns}
    for row in table.to_dict("records"):
        if (place := study.place(row)) >= 0:
            for side in arrays:
                arrays[side][study.index[row["method"]], place] = factor * row[sides[side]]
    found: dict[str, Any] = {"name": name, "log": factor == 1.0, "bounded": column == "rmse_m"}
    found["ert"] = column.startswith("ert")
    found |= {
        side: [numbers(row) for row in array]
        for side, array in arrays.items()
        if side == "value" or not np.isnan(array).all()
    }
    return found


def bound_of(study: Study) -> list[Any] | None:
    """The root mean square of the Cramér–Rao bound at each point; None where it is unknown."""
    if "crb_m" not in study.summary.columns or study.error != "rmse_m" or study.summary["crb_m"].isna().all():
        return None
    values = [math.nan] * len(study.points)
    for row in study.summary.to_dict("records"):
        if not math.isnan(row["crb_m"]):
            values[study.place(row)] = row["crb_m"]
    return numbers(values)


def headings(study: Study) -> dict[str, str]:
    """The headings of the table of methods that the manifest may name."""
    unit = " [m]" if study.error == "rmse_m" else ""
    defaults = {"median": f"median error{unit}", "rms": f"RMS error{unit}", "time": "time per run [s]"}
    keys = {"median": "median", "rms": "rmse", "time": "runtime"}
    return {name: study.label(keys[name], default) for name, default in defaults.items()}


def rank_rows(study: Study) -> list[dict[str, Any]]:
    """The table of methods at each point, and over all of them, which comes first if there are several points."""
    found = []
    first = 0
    frame = study.evidence.ranking.frame
    for block in study.evidence.ranking.blocks:
        found.append(_table(study, block, frame.iloc[first : first + len(block.methods)]))
        first += len(block.methods)
    overall = [each for each in found if each["point"] < 0]
    return overall + [each for each in found if each["point"] >= 0]


def _table(study: Study, block: Block, rows: pd.DataFrame) -> dict[str, Any]:
    overall = ALL in map(str, block.swept.values())
    point = -1 if overall else study.place(block.swept)
    best = {block.methods[i] for i in block.order}
    summaries = {} if overall else {row["method"]: row for row in _at(study, study.summary, point)}
    metres = study.error == "rmse_m"
    median = "median_m" if metres else f"{study.error}_median"
    lines = []
    for i, row in enumerate(rows.to_dict("records")):
        own = summaries.get(row["method"], {})
        seconds = [each.columns["seconds"][:, i] for each in block.points if "seconds" in each.columns]
        line: dict[str, Any] = {
            "method": study.index[row["method"]],
            "best": row["method"] in best,
            **{name: number(row[name]) for name in RANK_COLUMNS},
            "ert": number(block.ert[i]),
            "seconds": number(np.median(np.concatenate(seconds))) if seconds and block.n else None,
            "median": number(own.get(median, math.nan)),
            "rms": number(own.get(study.error, math.nan)),
            "time": number(own.get("runtime_s", math.nan)),
            "failed": sum(int(each.failed[:, i].sum()) for each in block.points if each.failed is not None),
        }
        lines.append(line)
    order = {study.index[block.methods[i]]: place for place, i in enumerate(block.order)}
    lines.sort(key=lambda each: (order.get(each["method"], len(order)), each["mean_rank"] or math.inf))
    return {"point": point, "n": block.n, "target": study.goal(block.points[0].target), "rows": lines}


def _at(study: Study, table: pd.DataFrame, point: int) -> Iterator[dict[Any, Any]]:
    return (row for row in table.to_dict("records") if study.place(row) == point)


def distributions(study: Study) -> dict[str, list[list[dict[int, Any]]]]:
    """The costs, and the share of runs [‰] that a method has solved after each, by axis, target, point and method.

    Each curve ends at the budget of its method.
    """
    hits = study.evidence.hits.frame
    curves = len(study.methods) * len(study.points) * max(len(study.targets), 1) * len(AXES)
    most = int(np.clip(CELLS / max(curves, 1), 12, 60))
    found: dict[str, list[list[dict[int, Any]]]] = {}
    for axis in AXES:
        found[axis] = [[{} for _ in study.points] for _ in study.targets]
        for key, rows in hits.groupby(["target", "method"], sort=False):
            target, method = key
            table = runtime_distribution(rows, axis, points=most, bands=False)
            _enter(study, found[axis][study.targets.index(str(target))], table, axis, study.index[str(method)])
    return found


def _enter(study: Study, points: list[dict[int, Any]], table: pd.DataFrame, axis: Axis, method: int) -> None:
    """Enter the curves of one method and target, without the costs at which nothing changes."""
    places = np.array(study.places(table))
    shares = (1000 * table["share"].to_numpy(dtype=np.float64)).round().astype(int)
    costs = table[axis].to_numpy(dtype=np.float64)
    for rows in np.split(np.arange(len(table)), np.flatnonzero(np.diff(places)) + 1):
        kept = np.append(True, np.diff(shares[rows]) != 0)
        kept[-1] = True
        points[places[rows[0]]][method] = [numbers(costs[rows][kept]), shares[rows][kept].tolist()]


def budgets(study: Study) -> list[str]:
    """The methods whose progress is embedded: those that the figures show at first, and the next best ones."""
    first = [study.methods[i] for i in study.shown]
    return list(dict.fromkeys([*first, *study.methods]))[:FIGURES]


def progress(study: Study) -> dict[str, Progress]:
    """How the error and the gap of the runs of ``budgets`` fell, as far as there are any."""
    evidence, runs = study.evidence, study.evidence.runs
    measures: list[Literal["gap", "error"]] = ["error"] if study.error in runs.columns else []
    gaps, bests = evidence.hits.gaps, evidence.hits.bests
    if gaps is not None and bests is not None and np.isfinite(gaps).any():
        measures.append("gap")
        runs = runs.assign(optimum=bests - gaps)  # of which the reference may come from a run of another method
    return find_progresses(study.results, measures, runs=runs[runs["method"].isin(budgets(study))])


def _budgets(frame: pd.DataFrame) -> list[float]:
    """1, 2, 5, 10, … and the cap of each method, so that every curve ends at its own budget."""
    caps = frame["cap"].to_numpy(dtype=np.float64)
    caps = np.unique(caps[caps > 0])
    if not len(caps):
        return [0.0]
    steps = (float(f"{factor}e{k}") for k in range(math.ceil(math.log10(caps[-1])) + 1) for factor in (1, 2, 5))
    return sorted({*(step for step in steps if step <= caps[-1]), *caps.tolist()})


def after_budget(study: Study, found: Progress) -> list[dict[str, Any]]:
    """The median with its interval after each budget at each point: ``{"x": …, "m": {method: [value, low, high]}}``."""
    table = fixed_budget_table(found.frame, _budgets(found.frame))
    points: list[dict[str, Any]] = [{"x": [], "m": {}} for _ in study.points]
    for _, rows in table.groupby([*study.swept, "method"], sort=False):
        first = rows.iloc[0].to_dict()
        point = points[study.place(first)]
        point["x"] = numbers(rows["evaluations"], 7)
        columns = [numbers(rows[name]) for name in ("median", "median_low", "median_high")]
        if any(value not in (None, "inf") for value in columns[0]):
            point["m"][study.index[first["method"]]] = columns
    return points
