"""The problem on which solvers are checked; it counts its evaluations and records the evaluated points."""

from __future__ import annotations

import hashlib
import threading

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench.core import Problem

__all__ = ["Probe"]


class Probe(Problem):
    """A small test problem that counts its evaluations and keeps a digest of all evaluated points.

    The shapes are defined in terms of u = (x - lower)/(upper - lower), which lies in [0, 1]ⁿ:

    - "bowl" is the mean of (u_j - centre_j)², whose minimum 0 lies inside the box;
    - "plateau" is the bowl, but NaN where u_1 > 0.45;
    - "flat" is 1 everywhere;
    - "rising" is the sum of u and "falling" its negative, so that the minimum lies in a corner.

    lower: lower bounds, shape (n,).
    upper: upper bounds, shape (n,).
    shape: "bowl", "plateau", "flat", "falling" or "rising".
    gradient: whether the problem offers its gradient.
    stop: exception to raise, instead of returning values, from evaluation ``stop_at`` on; None: never.
    stop_at: number of the evaluation, counted from 1, from which on ``stop`` is raised.
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
        self.has_gradient = gradient  # type: ignore[misc]  # set per instance
        self.centre = 0.3 + 0.4 * ((1.0 + np.arange(len(self.lower))) * 0.6180339887498949 % 1.0)
        self.shape = shape
        self.stop, self.stop_at = stop, stop_at
        self.stops = 0
        self.evaluations = 0
        self.threads: set[int] = set()  # those that evaluate
        self._seen = hashlib.sha256()

    @property
    def range(self) -> float:
        """The largest value of the bowl in the box; its smallest value is 0."""
        return float(np.mean(np.maximum(self.centre, 1.0 - self.centre) ** 2))

    @property
    def digest(self) -> str:
        """A fingerprint of all evaluated points, in their order."""
        return self._seen.hexdigest()

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        self.threads.add(threading.get_ident())
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
