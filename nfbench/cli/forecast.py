"""Forecasts how long a study takes, from the runs that are finished."""

from __future__ import annotations

import math
import time
from collections import Counter, defaultdict

from nfbench.study import RunRecord, RunSpec, Study

__all__ = ["Forecast", "rough_duration"]

ENOUGH_S = 5.0  # after which there is a forecast
PROOFS = ""  # stands for the proofs of optima, among the labels of methods
LONG_S = 120.0  # a shorter study needs no forecast


class Forecast:
    """The time left, judging each method by its own finished runs; methods without any count like the mean of others.

    A study runs scene by scene, so the methods that take long are known after its first scene.
    """

    def __init__(self, study: Study, workers: str = "") -> None:
        points = len(study.points) * study.scenes
        self._planned = Counter(
            {method.label: points * (study.runs_per_scene if method.is_stochastic else 1) for method in study.methods}
        )
        if study.proven:
            self._planned[PROOFS] = study.references
        self._workers = workers
        self._seconds: dict[str, float] = defaultdict(float)
        self._count: Counter[str] = Counter()
        self._todo, self._start = sum(self._planned.values()), time.monotonic()
        self._said = False

    def begin(self, todo: int) -> None:
        """Start the clock; ``todo`` runs and proofs are left."""
        self._todo, self._start = todo, time.monotonic()

    def add(self, spec: RunSpec, record: RunRecord) -> None:
        label = spec.method.label if spec.asks == "estimate" else PROOFS
        self._count[label] += 1
        self._seconds[label] += 0.0 if math.isnan(record.runtime_s) else record.runtime_s

    def left_s(self, now: float) -> float:
        """Seconds until the study ends; NaN before the first run has finished."""
        done = sum(self._count.values())
        if not done:
            return math.nan
        elapsed, spent = now - self._start, sum(self._seconds.values())
        share = self._todo / max(sum(self._planned.values()), 1)  # of each method; the others were done before
        if spent <= 0:
            return elapsed / done * max(self._todo - done, 0)
        mean = spent / done
        expected = 0.0
        for label, planned in self._planned.items():
            count = self._count[label]
            each = self._seconds[label] / count if count else mean
            expected += max(planned * share - count, 0.0) * each
        return elapsed / spent * expected

    def sentence(self, now: float) -> str | None:
        """How long the study takes, once, as soon as this is known; None before, after, and for a short study."""
        seen = all(self._count[label] for label in self._planned)
        elapsed = now - self._start
        if self._said or elapsed < ENOUGH_S or not (seen or elapsed >= 6 * ENOUGH_S):
            return None
        self._said = True
        total = elapsed + self.left_s(now)
        if total < LONG_S:
            return None
        done = sum(self._count.values())
        rough = "" if seen else "; not every method has finished a run yet"
        return f"The study takes {rough_duration(total)}{self._workers}, judging by its first {done:,} runs{rough}."


def rough_duration(seconds: float) -> str:
    """A time in words, with as many digits as a forecast deserves: "about 3 h"."""
    for unit, size in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            value = seconds / size
            return f"about {value:.0f} {unit}" if value >= 10 else f"about {value:.1f} {unit}".replace(".0 ", " ")
    return f"about {seconds:.0f} s"
