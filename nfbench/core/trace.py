"""The trace of a run: how its best value fell with evaluations and seconds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

__all__ = ["MAX_ROWS", "Recorder", "Trace"]

MAX_ROWS = 999  # the rows of a trace stay under 1,000


@dataclass(frozen=True)
class Trace:
    """Improvements of the best value, in order; the first row is the first evaluation, the last row the last one.

    evaluations: (r,) evaluations made when the row was written. seconds: (r,) since the solver's start [s].
    values: (r,) best value so far. points: (r, n) where it was found.
    """

    evaluations: Int[ndarray, " r"]
    seconds: Float[ndarray, " r"]
    values: Float[ndarray, " r"]
    points: Float[ndarray, "r n"]

    def __len__(self) -> int:
        return len(self.values)

    def thinned(self, rows: int) -> Trace:
        """At most ``rows`` (>= 2) rows, evenly chosen, with the first and the last one kept."""
        if len(self) <= rows:
            return self
        keep = np.unique(np.linspace(0, len(self) - 1, rows).astype(int))
        return Trace(self.evaluations[keep], self.seconds[keep], self.values[keep], self.points[keep])


@dataclass
class Recorder:
    """Collects a trace while a solver runs, in bounded memory: when full, every second row between the ends goes."""

    rows: list[tuple[int, float, float, ndarray]] = field(default_factory=list)

    def add(self, evaluation: int, seconds: float, value: float, point: ndarray) -> None:
        """Note an improvement; ``point`` must not change afterwards."""
        if len(self.rows) >= MAX_ROWS - 1:  # room for the closing row
            del self.rows[1:-1:2]
        self.rows.append((evaluation, seconds, value, point))

    def trace(self, dimension: int, evaluations: int, seconds: float) -> Trace:
        """The trace as it stands after ``evaluations`` evaluations and ``seconds``."""
        rows = list(self.rows)
        if rows and rows[-1][0] < evaluations:
            rows.append((evaluations, seconds, *rows[-1][2:]))
        return Trace(
            np.array([row[0] for row in rows], dtype=np.int64),
            np.array([row[1] for row in rows], dtype=np.float64),
            np.array([row[2] for row in rows], dtype=np.float64),
            np.array([row[3] for row in rows], dtype=np.float64).reshape(len(rows), dimension),
        )
