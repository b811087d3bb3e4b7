"""The gap and the error of runs as functions of what they have spent, from their traces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
import pandas as pd
from numpy import ndarray

from nfbench.core import Instance, Status, Trace

from .reader import Reader
from .redrawing import UNRELATED, Redrawing
from .references import Key, problems, proofs
from .rows import TracedRun

__all__ = ["Curve", "Curves", "scenes_of"]


MOST_NOTES = 20  # as the message of an exception may differ from run to run


@dataclass(frozen=True)
class Curve:
    """What a run had reached after each of its improvements, for runs with status ok.

    row: position of the run in the frame of runs.
    measure: "gap", of the first problem; or "error", of the estimate from the best point so far.
    evaluations: evaluations made, (r,).
    seconds: seconds since the start of the solver, (r,); of the whole run if ``at_end``.
    values: gap or error, (r,); inf where there is none.
    spent: evaluations at the end, of the first problem for a gap and of the whole run for an error.
    at_end: whether only the final error is known, as one row at the end of the run.
    """

    row: int
    measure: Literal["gap", "error"]
    evaluations: ndarray
    seconds: ndarray
    values: ndarray
    spent: int
    at_end: bool = False


def scenes_of(runs: pd.DataFrame) -> tuple[ndarray, ndarray]:
    """Return the number of the scene and the number of the run on it; in older folders the repetition, and 0."""
    scene = runs["scene"] if "scene" in runs.columns else runs["repetition"]
    run = runs["run"] if "run" in runs.columns else pd.Series(0, index=runs.index)
    return scene.to_numpy(), run.to_numpy()


@final
class Curves:
    """The curves of all runs of a folder; ``notes`` and ``bests`` are complete when all have been yielded.

    runs: the frame of runs. error: name of the error measure. redrawing: scenes of the folder. measures: which curves
    are wanted.

    The gap is measured from the reference optimum of the run's first problem: its known minimum, else its certified
    optimum, else the best value that any run or an unfinished proof has found for it. A certified optimum that a run
    contradicts counts as not certified. Runs with the same formulation share that problem if they are of the same scene
    at the same point of the sweep.

    bests: best value of each run's first problem, (runs,), also of runs that are not ok; NaN where there is none.
    """

    def __init__(
        self,
        results: Reader,
        runs: pd.DataFrame,
        error: str,
        redrawing: Redrawing,
        measures: Collection[str] = ("gap", "error"),
    ) -> None:
        self._measures = measures
        self._results, self._error, self._redrawing = results, error, redrawing
        self._ids = runs["run_id"].tolist()
        self._row = {run_id: i for i, run_id in enumerate(self._ids)}
        self._ok = (runs["status"] == Status.OK).to_numpy()
        self._final = _column(runs, error)
        self._evaluations, self._runtime_s = _column(runs, "evaluations"), _column(runs, "runtime_s")
        self._seed = runs["instance_seed"].to_numpy()
        self._optimum = _column(runs, "optimum")
        self._problem = problems(runs)
        self._proofs = proofs(results.references)
        self.bests = np.full(len(runs), np.nan)
        self._left = Counter(problem for problem, ok in zip(self._problem, self._ok, strict=True) if ok)
        self._known: dict[Key, float] = {}
        for i in np.flatnonzero(np.isfinite(self._optimum)):
            self._known.setdefault(self._problem[i], float(self._optimum[i]))
        self._waiting: dict[Key, list[tuple[int, Trace]]] = {}
        self._odd: dict[str, set[str]] = {}
        self._damaged = 0

    @property
    def notes(self) -> list[str]:
        """Sentences about what could not be computed along the traces."""
        notes = [f"{', '.join(sorted(labels))}: {reason}" for reason, labels in self._odd.items()]
        if self._damaged:
            notes.append(
                f"the traces of {self._damaged} runs are damaged, so what they reached on the way is not known"
            )
        return notes

    def __iter__(self) -> Iterator[Curve]:
        # scene by scene, so that each scene is drawn once for all runs on it
        order = [self._ids[i] for i in np.argsort(self._seed, kind="stable").tolist()]
        for run in self._results.traced_runs(lenient=True, only=order):
            row = self._row.get(run.run_id)
            self._damaged += bool(run.damage)
            if row is not None and run.traces and len(run.traces[0]) and run.status != Status.INVALID:
                self.bests[row] = run.traces[0].values[-1]
            if row is None or not self._ok[row]:
                continue
            instance = self._instance(run, row)
            if "error" in self._measures:
                yield self._error_curve(row, run, instance)
            if "gap" in self._measures:
                yield from self._gap_curves(row, run, instance)
        for problem, waiting in self._waiting.items():  # of runs that have been forgotten since the frame was read
            yield from _gaps(waiting, self._reference(problem, waiting))

    def _instance(self, run: TracedRun, row: int) -> Instance | None:
        needed = "error" in self._measures or not self._is_known(self._problem[row])
        if len(run.traces) != 1 or not needed or "" in self._redrawing.reasons:
            return None
        return self._redrawing.truth(run.swept, int(self._seed[row]))

    def _error_curve(self, row: int, run: TracedRun, instance: Instance | None) -> Curve:
        final = self._final[row]
        final, spent = np.inf if np.isnan(final) else float(final), int(self._evaluations[row])
        reason = "several problems are minimized"
        if len(run.traces) == 1 and len(run.traces[0]):
            trace = run.traces[0]
            errors, reason = self._redrawing.errors(self._error, instance, run.formulation, trace, final)
            if errors is None and reason != UNRELATED:  # the data may be needed
                instance = self._redrawing.instance(run.swept, int(self._seed[row]))
                errors, reason = self._redrawing.errors(self._error, instance, run.formulation, trace, final)
            if errors is not None:
                return Curve(row, "error", trace.evaluations, trace.seconds, errors, spent)
        if run.traces and len(self._odd) < MOST_NOTES:  # without traces nothing was to be expected
            text = f"{reason}, so the error is known at the end of a run only"
            self._odd.setdefault(text, set()).add(run.formulation)
        ends = np.array([spent]), np.array([self._runtime_s[row]]), np.array([final])
        return Curve(row, "error", *ends, spent, at_end=True)

    def _gap_curves(self, row: int, run: TracedRun, instance: Instance | None) -> Iterator[Curve]:
        """The gap of this run, or of all runs that share its problem once the last of them has been read."""
        problem = self._problem[row]
        self._left[problem] -= 1
        if run.traces and len(run.traces[0]):
            trace = run.traces[0]
            if not self._is_known(problem):
                minimum = self._redrawing.minimum(instance, trace)
                if minimum is not None:
                    self._known[problem] = minimum
            light = Trace(trace.evaluations, trace.seconds, trace.values, trace.points[:0])
            self._waiting.setdefault(problem, []).append((row, light))
        if problem in self._known or not self._left[problem]:
            waiting = self._waiting.pop(problem, [])
            yield from _gaps(waiting, self._reference(problem, waiting))

    def _is_known(self, problem: Key) -> bool:
        return problem in self._known or (problem in self._proofs and self._proofs[problem].certified)

    def _reference(self, problem: Key, waiting: list[tuple[int, Trace]]) -> float:
        """The reference optimum of a problem, given all runs that share it."""
        if problem in self._known:
            return self._known[problem]
        best = _best(waiting)
        return self._proofs[problem].reference(best) if problem in self._proofs else best


def _best(waiting: list[tuple[int, Trace]]) -> float:
    return min((float(trace.values[-1]) for _, trace in waiting), default=np.inf)


def _gaps(waiting: list[tuple[int, Trace]], reference: float) -> Iterator[Curve]:
    for row, trace in waiting:
        with np.errstate(invalid="ignore"):
            gaps = np.where(np.isfinite(trace.values), trace.values - reference, np.inf)
        yield Curve(row, "gap", trace.evaluations, trace.seconds, gaps, int(trace.evaluations[-1]))


def _column(runs: pd.DataFrame, name: str) -> ndarray:
    """A column as floats; NaN if there is none."""
    if name not in runs.columns:
        return np.full(len(runs), np.nan)
    return runs[name].to_numpy(dtype=np.float64)
