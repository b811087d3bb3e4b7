"""What the evaluations of a run cost: the time inside the problem, and how many of them were made at once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from numpy import ndarray

__all__ = ["EVERY", "Spending"]

EVERY = 16  # one of so many single points is timed; a clock at each would cost several per cent of a short evaluation


@dataclass(slots=True)
class Spending:
    """Counted by the meter while a solver runs.

    batches: number of calls that evaluated a batch of points. batched, batched_s: number of evaluations in these, and
    their time [s]. timed, timed_s: number of single points that were timed, and their time. gradients_s: time of the
    evaluations with gradients.
    """

    batches: int = 0
    batched: int = 0
    batched_s: float = 0.0
    timed: int = 0
    timed_s: float = 0.0
    gradients_s: float = 0.0

    def time_one(self, value: Callable[[ndarray], float], x: ndarray) -> float:
        """Return the value at one point, and add its time."""
        clock = time.perf_counter()
        found = value(x)
        clock = time.perf_counter() - clock
        self.timed_s += clock
        self.timed += 1
        return found

    def inside_s(self, evaluations: int, gradients: int) -> float:
        """Return the time inside the problem of all evaluations [s]; NaN if none was timed."""
        whole, whole_s = self.batched + gradients, self.batched_s + self.gradients_s
        single = evaluations - whole
        if single <= 0:
            return whole_s
        count, seconds = (self.timed, self.timed_s) if self.timed else (whole, whole_s)
        return whole_s + single * seconds / count if count else math.nan
