"""The first points of solvers: those that a run starts from, or else random ones."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from jaxtyping import Float
from numpy import ndarray

__all__ = ["first_point", "first_population"]


class _Meter(Protocol):
    """What is needed of a meter."""

    start: Float[ndarray, "p n"] | None
    start_values: Float[ndarray, " p"] | None

    @property
    def dimension(self) -> int: ...
    def evaluate(self, X: ndarray) -> ndarray: ...
    def from_unit(self, U: ndarray) -> ndarray: ...
    def to_unit(self, X: ndarray) -> ndarray: ...


def first_population(
    meter: _Meter, size: int, rng: np.random.Generator
) -> tuple[Float[ndarray, "size n"], Float[ndarray, " size"]]:
    """Return an evaluated initial population, as ``MeteredProblem.first_population`` does."""
    if meter.start is None or meter.start_values is None:
        x = meter.from_unit(rng.random((size, meter.dimension)))
        return x, meter.evaluate(x)
    kept = np.sort(np.argsort(meter.start_values, kind="stable")[:size])
    x, f = meter.start[kept], meter.start_values[kept]
    more = meter.from_unit(rng.random((size - len(x), meter.dimension)))
    return np.vstack([x, more]), np.concatenate([f, meter.evaluate(more)])


def first_point(meter: _Meter, rng: np.random.Generator) -> Float[ndarray, " n"]:
    """Return a point of the unit box to start at, as ``MeteredProblem.first_point`` does."""
    if meter.start is None or meter.start_values is None:
        return rng.random(meter.dimension)
    return np.asarray(np.clip(meter.to_unit(meter.start[meter.start_values.argmin()]), 0.0, 1.0))
