"""The numbers behind the view of single scenes: outcomes by method, positions, and traces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.analysis import Outcomes, scene_table
from nfbench.core import Status
from nfbench.results import Progress

from .redrawn import Redrawn
from .study import Study, numbers

__all__ = ["chosen_scenes", "outcome_tables", "places", "traces"]

CELLS = 200_000  # outcomes of single scenes and methods that are embedded
SCENES = 300  # pairs of point and scene with positions and traces
ROWS = 14  # of a trace
Scenes = dict[int, list[Any]]  # of each point


def outcome_tables(study: Study) -> list[dict[str, Any] | None]:
    """The outcomes at each point: the scenes, the hardest first, and the errors and hits of each method in them."""
    cells = sum(len(each.scenes) for each in study.outcomes if each is not None)
    most = max(CELLS // max(cells, 1), 10)
    return [None if each is None else _outcomes(study, each, most) for each in study.outcomes]


def _outcomes(study: Study, each: Outcomes, most: int) -> dict[str, Any]:
    table = scene_table(each)
    order = [each.scenes.index(scene) for scene in table["scene"]]
    columns = sorted(range(len(each.methods)), key=lambda i: study.index[each.methods[i]])[:most]
    failed = np.zeros(each.hits.shape, dtype=int) if each.failed is None else each.failed
    return {
        "scenes": [int(scene) for scene in table["scene"]],
        "share": numbers(table["share"], 3),
        "solved": [int(n) for n in table["solved_by"]],
        "best": numbers(table["best_error"], 3),
        "methods": [study.index[each.methods[i]] for i in columns],
        "all": len(each.methods),
        "runs": [int(each.runs[i]) for i in columns],
        "error": [numbers(each.error[order, i], 3) for i in columns],
        "hits": [each.hits[order, i].tolist() for i in columns],
        "failed": [failed[order, i].tolist() if failed[:, i].any() else None for i in columns],
        "target": study.goal(each.target),
    }


def chosen_scenes(study: Study) -> Scenes:
    """The scenes of each point that can be opened, the hardest first: all, or as many as fit in the page."""
    most = max(SCENES // max(len(study.points), 1), 4)
    return {i: list(scene_table(each)["scene"][:most]) for i, each in enumerate(study.outcomes) if each is not None}


def traces(study: Study, found: Progress | None, scenes: Scenes) -> dict[int, dict[int, dict[int, Any]]]:
    """The first run of each shown method in each scene: evaluations and values, by point, scene and method."""
    if found is None:
        return {}
    names = {study.methods[i] for i in study.shown}
    frame = found.frame[found.frame["method"].isin(names) & (found.frame["run"] == 0)]
    result: dict[int, dict[int, dict[int, Any]]] = {}
    x, y = (frame[name].to_numpy(dtype=np.float64) for name in ("evaluations", "value"))
    for rows, point, number, method in _runs(study, frame, scenes):
        if np.isfinite(y[rows]).any():
            scene = result.setdefault(point, {}).setdefault(number, {})
            thin = _thinned(x[rows], y[rows])
            scene[method] = [numbers(thin[0], 6), numbers(thin[1], 3)]
    return result


def _runs(study: Study, frame: pd.DataFrame, scenes: Scenes) -> Iterator[tuple[ndarray, int, int, int]]:
    """Yield the rows of each run in one of these scenes, with its point, scene and method."""
    code, _ = pd.factorize(frame["run_id"])
    order = np.argsort(code, kind="stable")
    places, methods, numbers_ = study.places(frame), frame["method"].tolist(), frame["scene"].tolist()
    wanted = {(point, scene) for point, chosen in scenes.items() for scene in chosen}
    for rows in np.split(order, np.flatnonzero(np.diff(code[order])) + 1):
        if len(rows) and (places[rows[0]], numbers_[rows[0]]) in wanted:
            yield rows, places[rows[0]], int(numbers_[rows[0]]), study.index[methods[rows[0]]]


def _thinned(x: ndarray, y: ndarray) -> tuple[ndarray, ndarray]:
    """At most ROWS rows, evenly spaced in the logarithm of the cost, with the first and the last."""
    if len(x) <= ROWS:
        return x, y
    at = np.geomspace(max(x[0], 1.0), max(x[-1], 1.0), ROWS)
    rows = np.unique(np.append(np.searchsorted(x, at[:-1], side="right") - 1, len(x) - 1).clip(0))
    return x[rows], y[rows]


def places(study: Study, redrawn: Redrawn, scenes: Scenes) -> dict[int, dict[int, Any]]:
    """The true positions, and those that the first run of each shown method has found [m], by point and scene.

    They are those that the study has stored or, in the folder of an older version, those of redrawn scenes.
    """
    names = {study.methods[i] for i in study.shown}
    stored = study.results.positions
    if len(stored):
        return _stored(study, stored[stored["method"].isin(names) & (stored["run"] == 0)], scenes)
    runs = study.runs[study.runs["method"].isin(names) & (study.runs["run"] == 0)]
    runs = runs[runs["status"] == Status.OK]
    wanted = {(point, scene) for point, chosen in scenes.items() for scene in chosen}
    rows = [row for row in runs.to_dict("records") if (study.place(row), row["scene"]) in wanted]
    ids = {row["run_id"] for row in rows}
    estimates = {run_id: estimate for run_id, estimate in study.results.estimates() if run_id in ids}
    found: dict[int, dict[int, Any]] = {}
    for row in rows:
        pair = redrawn.positions(study.place(row), row, estimates.get(row["run_id"]), study.error)
        if pair is not None:
            scene = found.setdefault(study.place(row), {}).setdefault(
                int(row["scene"]), {"truth": _triples(pair[0]), "found": {}}
            )
            scene["found"][study.index[row["method"]]] = _triples(pair[1])
    return found


def _stored(study: Study, rows: pd.DataFrame, scenes: Scenes) -> dict[int, dict[int, Any]]:
    found: dict[int, dict[int, Any]] = {}
    truth = rows[["true_x_m", "true_y_m", "true_z_m"]].to_numpy(dtype=np.float64)
    estimate = rows[["x_m", "y_m", "z_m"]].to_numpy(dtype=np.float64)
    for own, point, number, method in _runs(study, rows, scenes):
        scene = found.setdefault(point, {}).setdefault(number, {"truth": _triples(truth[own]), "found": {}})
        scene["found"][method] = _triples(estimate[own])
    return found


def _triples(positions: Iterable[Iterable[float]]) -> list[list[Any]]:
    """Positions as lists [m]; those that do not exist are left out."""
    return [numbers(place) for place in positions if not any(math.isnan(value) for value in place)]
