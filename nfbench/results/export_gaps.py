"""The runs of a study as other tools want them: the gap of each run's first problem, and every failure as a miss."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.analysis import Target
from nfbench.core import Status, Trace

from .curves import Curves, scenes_of
from .export import Exported, status_or
from .hits import find_hits
from .redrawing import Redrawing
from .results import Results
from .rows import TracedRun

__all__ = ["INFINITE", "GapRun", "GapRuns", "Gaps", "point_of"]

INFINITE = 3e21  # what COCO's loggers write for an infinite value; readers of these formats do not accept inf


@final
class Gaps:
    """The gaps along the first trace of every run that is ok, kept in a temporary file.

    The gap is the best value so far minus the reference optimum, as for targets; see ``Curves``.
    """

    def __init__(self, results: Results, runs: pd.DataFrame) -> None:
        self._at: dict[str, tuple[int, int]] = {}
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed with this object
        try:
            self._read(results, runs)
        except BaseException:
            self._file.close()
            raise

    def _read(self, results: Results, runs: pd.DataFrame) -> None:
        run_ids = runs["run_id"].tolist()
        curves = Curves(results, runs, results.meta["error"], Redrawing(results.folder), ("gap",))
        for curve in curves:
            self._at[run_ids[curve.row]] = (self._file.tell(), len(curve.values))
            self._file.write(np.ascontiguousarray(curve.values, dtype=np.float64).tobytes())

    def of(self, run_id: str) -> ndarray | None:
        """The gaps (r,) of a run, inf where the value is not finite; None if it has none."""
        if run_id not in self._at:
            return None
        start, count = self._at[run_id]
        self._file.seek(start)
        return np.frombuffer(self._file.read(8 * count), dtype=np.float64)

    def close(self) -> None:
        """Delete the file."""
        self._file.close()


@dataclass(frozen=True)
class GapRun:
    """A run to export, for one problem.

    run: the run. scene: number of its scene. seed: seed of its scene. dimension: number of unknowns.
    evaluations: evaluations when each row was written, (r,), from 1.
    gaps: gap so far, (r,), at least 0 and at most INFINITE.
    offset: reference optimum, so that value = gap + offset; 0 for a miss.
    best: row of the best value. point: point with that value, (dimension,); empty for a miss.
    missed: whether the run is not ok, so that it reaches no target.
    """

    run: TracedRun
    scene: int
    seed: int
    dimension: int
    evaluations: ndarray
    gaps: ndarray
    offset: float
    best: int
    point: ndarray
    missed: bool = False


@final
class GapRuns:
    """Yields the runs of a study that an export with gaps contains, in order, and counts the others.

    results: results folder. exported: counts the runs.

    A run that is not ok is a miss: it has spent its evaluations and has reached nothing, as in ``targets.csv``. Two
    misses in a row never end and begin with the same value, because iohinspector drops repeated values.
    """

    def __init__(self, results: Results, exported: Exported) -> None:
        self._results, self._exported = results, exported
        self.runs = runs = results.runs
        self._row = {run_id: i for i, run_id in enumerate(runs["run_id"])}
        self._scene, self._seed = scenes_of(runs)[0].tolist(), runs["instance_seed"].tolist()
        failed = bool(((runs["status"] != Status.OK) & (runs["solver"] != "")).any())
        self._spent = _spent(results, runs) if failed else {}
        self._dimensions = self._found_dimensions() if failed else {}

    def __iter__(self) -> Iterator[GapRun]:
        gaps = Gaps(self._results, self.runs)
        try:
            for run in self._results.traced_runs():
                if run.run_id not in self._row:  # finished since the frame was read
                    continue
                found = self._ok(run, gaps.of(run.run_id)) if run.status == Status.OK else self._miss(run)
                if self._exported.takes(None if found else status_or(run, "without a trace")) and found:
                    self._exported.misses += found.missed
                    yield found
        finally:
            gaps.close()

    def _ok(self, run: TracedRun, gaps: ndarray | None) -> GapRun | None:
        if gaps is None or not run.traces:
            return None
        trace = run.traces[0]
        i, row = int(trace.values.argmin()), self._row[run.run_id]
        offset = float(trace.values[-1] - gaps[-1]) if np.isfinite(gaps[-1]) else 0.0
        gaps = np.clip(np.where(np.isfinite(gaps), gaps, INFINITE), 0.0, INFINITE)
        about = self._scene[row], self._seed[row], trace.points.shape[1]
        return GapRun(run, *about, trace.evaluations, gaps, offset, i, trace.points[i])

    def _miss(self, run: TracedRun) -> GapRun | None:
        row = self._row[run.run_id]
        dimension = self._dimension(run, self._seed[row])
        if dimension is None or not run.solver:
            return None
        spent = max(int(self._spent.get(run.run_id, 0.0)), 1)
        evaluations = np.array([1, spent] if spent > 1 else [1])
        gaps = np.array([2 * INFINITE, INFINITE] if spent > 1 else [INFINITE * (1 + self._exported.misses % 2)])
        about = self._scene[row], self._seed[row], dimension
        return GapRun(run, *about, evaluations, gaps, 0.0, len(gaps) - 1, np.empty(0), missed=True)

    def _found_dimensions(self) -> dict[tuple[str, str, int | None], int]:
        """The number of unknowns at each point of the sweep by formulation and scene, and, under None, of any scene."""
        found: dict[tuple[str, str, int | None], int] = {}
        for run in self._results.traced_runs():
            if run.traces and run.run_id in self._row:
                for seed in (self._seed[self._row[run.run_id]], None):
                    found[point_of(run.swept), run.formulation, seed] = _unknowns(run.traces[0])
        return found

    def _dimension(self, run: TracedRun, seed: int) -> int | None:
        at = point_of(run.swept), run.formulation
        return self._dimensions.get((*at, seed), self._dimensions.get((*at, None)))


def point_of(swept: dict[str, Any]) -> str:
    """Return the point of the sweep as text, without what is swept in the budget, which changes no problem."""
    return json.dumps({k: v for k, v in swept.items() if not k.startswith("budget.")}, sort_keys=True)


def _unknowns(trace: Trace) -> int:
    return int(trace.points.shape[1])


def _spent(results: Results, runs: pd.DataFrame) -> dict[str, float]:
    """The evaluations that each run has spent, as ``targets.csv`` counts them."""
    frame = find_hits(results, [Target("gap", 1.0)], runs=runs, cached=False).frame
    return dict(zip(frame["run_id"], frame["spent"].fillna(0.0), strict=True))
