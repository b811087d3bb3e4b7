"""The problem that solvers are checked on: it counts, and remembers what it saw."""

from __future__ import annotations

import hashlib

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench.core import Problem

__all__ = ["Probe"]


class Probe(Problem):
    """A small test problem that counts its evaluations and remembers in a digest every point it saw.

    With u = (x - lower)/(upper - lower) in [0, 1]: "bowl" is the mean of (u_j - centre_j)², its minimum 0 inside the
    box; "plateau" the bowl, but NaN where u_1 > 0.45; "flat" is 1; "falling" and "rising" are the sum of u, falling or
    rising, with their minimum in a corner. From evaluation ``stop_at`` on, ``stop`` is raised instead.
    """

    def __init__(
        self,
        lower: Float[ndarray, " n"],
        upper: Float[ndarray, " n"],
        shape: str = "bowl",
        gradient: bool = False,
        stop: type[BaseException] | None = None,
        stop_at: int = 0,
    ) -> None:
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        self.has_gradient = gradient  # type: ignore[misc]  # each probe decides for itself
        self.centre = 0.3 + 0.4 * ((1.0 + np.arange(len(self.lower))) * 0.6180339887498949 % 1.0)
        self.shape = shape
        self.stop, self.stop_at = stop, stop_at
        self.stops = 0
        self.evaluations = 0
        self._seen = hashlib.sha256()

    @property
    def range(self) -> float:
        """The bowl's largest value in the box; its smallest is 0."""
        return float(np.mean(np.maximum(self.centre, 1.0 - self.centre) ** 2))

    @property
    def digest(self) -> str:
        """A fingerprint of all points evaluated, in order."""
        return self._seen.hexdigest()

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        if self.stop is not None and self.evaluations + len(X) >= self.stop_at:
            self.stops += 1
            raise self.stop(f"at evaluation {self.stop_at}")
        self.evaluations += len(X)
        self._seen.update(np.ascontiguousarray(X).tobytes())
        u = (X - self.lower) / (self.upper - self.lower)
        if self.shape == "flat":
            return np.ones(len(u))
        if self.shape in ("falling", "rising"):
            return np.asarray(u.sum(axis=1) * (1.0 if self.shape == "rising" else -1.0))
        values = np.mean((u - self.centre) ** 2, axis=1)
        if self.shape == "plateau":
            values[u[:, 0] > 0.45] = np.nan
        return np.asarray(values)

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        width = self.upper - self.lower
        value = float(self.evaluate(x[None, :])[0])
        if self.shape == "flat":
            return value, np.zeros_like(x)
        if self.shape in ("falling", "rising"):
            return value, (1.0 if self.shape == "rising" else -1.0) / width
        return value, 2.0 * ((x - self.lower) / width - self.centre) / (width * len(x)) + 0.0 * value
