"""The trace of a run: its best value as a function of evaluations and time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

__all__ = ["MAX_ROWS", "Recorder", "Trace"]

MAX_ROWS = 999  # a trace has fewer than 1,000 rows


@dataclass(frozen=True)
class Trace:
    """The improvements of the best value, in order.

    The first row describes the first evaluation, and the last row the state after the last evaluation.

    evaluations: number of evaluations made at each row, (r,).
    seconds: wall-clock time since the start of the solver at each row [s], (r,).
    values: best value so far at each row, (r,).
    points: point with the best value at each row, (r, n).
    """

    evaluations: Int[ndarray, " r"]
    seconds: Float[ndarray, " r"]
    values: Float[ndarray, " r"]
    points: Float[ndarray, "r n"]

    def __len__(self) -> int:
        return len(self.values)

    def thinned(self, rows: int) -> Trace:
        """Return a trace of at most ``rows`` (>= 2) evenly spaced rows, including the first and the last."""
        if len(self) <= rows:
            return self
        keep = np.unique(np.linspace(0, len(self) - 1, rows).astype(int))
        return Trace(self.evaluations[keep], self.seconds[keep], self.values[keep], self.points[keep])


@dataclass
class Recorder:
    """Collects a trace in bounded memory while a solver runs.

    When it is full, every second row is deleted, except for the first and the last.
    """

    rows: list[tuple[int, float, float, ndarray]] = field(default_factory=list)

    def add(self, evaluation: int, seconds: float, value: float, point: ndarray) -> None:
        """Record an improvement. ``point`` must not change afterwards."""
        if len(self.rows) >= MAX_ROWS - 1:  # leaves room for the row that trace() appends
            del self.rows[1:-1:2]
        self.rows.append((evaluation, seconds, value, point))

    def contradiction(self, evaluations: object, best_value: object, limit: int) -> str | None:
        """What of a meter's count and best value contradicts the budget or the trace; None if nothing does."""
        count, _, value, _ = self.rows[-1] if self.rows else (0, 0.0, math.inf, None)
        if isinstance(evaluations, int) and evaluations > limit:
            return f"expected at most {limit} evaluations, got {evaluations}: the solver changed the budget"
        if not isinstance(evaluations, int) or evaluations < count:
            return f"expected at least {count} evaluations, got {evaluations!r}: the solver changed the count"
        if type(best_value) is not float or best_value != value:
            return f"expected the best value {value!r}, got {best_value!r}: the solver changed it"
        return None

    def trace(self, dimension: int, evaluations: int, seconds: float) -> Trace:
        """Return the trace after ``evaluations`` evaluations and ``seconds`` seconds."""
        rows = list(self.rows)
        if rows and rows[-1][0] < evaluations:
            rows.append((evaluations, seconds, *rows[-1][2:]))
        return Trace(
            np.array([row[0] for row in rows], dtype=np.int64),
            np.array([row[1] for row in rows], dtype=np.float64),
            np.array([row[2] for row in rows], dtype=np.float64),
            np.array([row[3] for row in rows], dtype=np.float64).reshape(len(rows), dimension),
        )
