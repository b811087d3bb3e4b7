"""The optimum of a problem as a proof gives it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxtyping import Float
from numpy import ndarray

__all__ = ["Reference"]


@dataclass(frozen=True, eq=False)
class Reference:
    """The result of a proof of the optimum of a problem.

    value: smallest value that the proof has found, in the unit of the problem: the value at ``point``.
    gap: proven bound on ``value`` minus the minimum of the problem, at least 0; inf if nothing is proven.
    certified: whether the proof succeeded, so that gaps are measured from ``value``; ``gap`` is then finite.
    point: point with that value, (n,); None to store none.
    step: number of the step in which the proof failed, from 1; 0 if it did not fail.
    columns: further numbers by the names of the columns of ``references.csv`` in which they are stored.
    """

    value: float
    gap: float
    certified: bool
    point: Float[ndarray, " n"] | None = None
    step: int = 0
    columns: Mapping[str, float] = field(default_factory=dict)
