"""The landscapes of a study: what a multistart shows of the first problem of each formulation, scene by scene."""

from __future__ import annotations

import functools
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.analysis import landscape_facts
from nfbench.core import Formulation, Instance, Minimum, NfbenchError, Problem, explain
from nfbench.results import Redrawing, cell, write_whole
from nfbench.study import seed_from, swept_column

__all__ = ["first_problem", "landscape_table", "write_landscape"]

Task = tuple[Path, dict[str, Any], int, int, str, int]  # manifest, swept values, scene, its seed, formulation, starts


class _Found(BaseException):
    """Ends ``solve`` at its first problem; not an Exception, so that no formulation handles it."""


def first_problem(formulation: Formulation, instance: Instance) -> Problem | None:
    """Return the first problem that a formulation minimizes for an instance; None if it minimizes none."""
    problems: list[Problem] = []

    def minimize(problem: Problem) -> Minimum:
        problems.append(problem)
        raise _Found

    try:
        formulation.solve(instance, minimize)
    except _Found:
        return problems[0]
    return None


def write_landscape(
    manifest: Path,
    out: Path,
    starts: int,
    scenes: int | None = None,
    jobs: int = 1,
    warn: Callable[[str], object] = lambda _: None,
) -> Path:
    """Write the table of a study's landscapes to a file, and return its path. Raises NfbenchError."""
    table = landscape_table(manifest, starts, scenes, jobs, warn)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, lambda path: table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n"))
    return out


def landscape_table(
    manifest: Path,
    starts: int,
    scenes: int | None = None,
    jobs: int = 1,
    warn: Callable[[str], object] = lambda _: None,
) -> pd.DataFrame:
    """Return one row per formulation, point of the sweep and scene, with the columns of ``landscape_facts``.

    manifest: manifest of a study. Plugin files that it names are not imported.
    starts: number of local searches on each problem.
    scenes: number of scenes at each point; None for all of the study.
    jobs: number of processes; the table does not depend on it, nor do rows depend on each other.
    warn: function that receives a sentence about what is left out.

    Raises NfbenchError if the manifest cannot be read, or no formulation minimizes a problem.
    """
    tasks = list(_tasks(manifest, starts, scenes, warn))
    if jobs > 1 and len(tasks) > 1:
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            rows = list(pool.map(_row, tasks))
    else:
        rows = [_row(task) for task in tasks]
    for reason in dict.fromkeys(str(row["reason"]) for row in rows if "reason" in row):
        warn(reason)
    kept = [row for row in rows if "reason" not in row]
    if not kept:
        raise NfbenchError(f"{manifest}: no formulation of the study minimizes a problem")
    return pd.DataFrame(kept)


def _tasks(manifest: Path, starts: int, scenes: int | None, warn: Callable[[str], object]) -> Iterator[Task]:
    redrawing = _redrawing(manifest)
    if reason := redrawing.reasons.get(""):
        raise NfbenchError(f"{manifest}: {reason}")
    for label, reason in redrawing.reasons.items():
        warn(f"{label}: {reason}")
    numbers = sorted((number, seed) for seed, number in redrawing.seeds.items())[:scenes]
    for swept in redrawing.points:
        for label in redrawing.formulations:
            for number, seed in numbers:
                yield manifest, swept, number, seed, label, starts


@functools.lru_cache(maxsize=1)
def _redrawing(manifest: Path) -> Redrawing:
    return Redrawing(manifest.parent, manifest)


def _row(task: Task) -> dict[str, Any]:
    """The row of one problem, or why there is none."""
    manifest, swept, number, seed, label, starts = task
    redrawing = _redrawing(manifest)
    formulation, instance = redrawing.formulation(label), redrawing.instance(swept, seed)
    if formulation is None or instance is None:
        return {"reason": f"{label}: scene {number} cannot be drawn"}
    if not formulation.needs_solver or not isinstance(instance, formulation.accepts):
        return {"reason": f"{label} minimizes no problem that a solver is given"}
    try:
        problem = first_problem(formulation, instance)
        if problem is None:
            return {"reason": f"{label} minimizes no problem in scene {number}"}
        rng = np.random.default_rng(seed_from("landscape", seed))
        facts = landscape_facts(problem, starts, rng, _near_truth(problem, instance))
    except Exception as error:  # of a plugin
        return {"reason": f"{label}: {explain(error)}"}
    columns = {swept_column(key): cell(value) for key, value in swept.items()}
    return {"formulation": label, **columns, "scene": number, **facts}


def _near_truth(problem: Problem, instance: Instance) -> ndarray | None:
    """The truth as points of the problem, where it has the shape of one or of several."""
    truth, n = instance.truth(), problem.dimension
    if truth is None:
        return None
    truth = np.asarray(truth, dtype=np.float64)
    if truth.size == n:
        return truth.reshape(1, n)
    return truth if truth.ndim == 2 and truth.shape[1] == n else None
