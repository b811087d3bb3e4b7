"""A plane through an objective, which figures of a landscape show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .problem import Problem

__all__ = ["Cut", "Plane"]


@final
@dataclass(frozen=True, eq=False)
class Cut:
    """Two coordinates of a problem that vary while the others are fixed.

    name: name of the objective, which may be followed by what is fixed, e.g. ``ESF, source 1``.
    problem: the problem to cut.
    through: a point in the plane, shape (n,).
    free: indices of the horizontal and the vertical coordinate.
    axes: labels of the two axes with their units.
    scale: factors from the problem's units to those of the labels.
    marks: true positions to mark in the plane, in the problem's units, shape (k, 2).
    spectrum: whether to show the objective upside down, as a spectrum whose peaks are the minima.
    about: a sentence about what the objective measures; may be empty.
    """

    name: str
    problem: Problem
    through: Float[ndarray, " n"]
    free: tuple[int, int]
    axes: tuple[str, str]
    scale: tuple[float, float]
    marks: Float[ndarray, "k 2"]
    spectrum: bool = False
    about: str = ""

    def plane(self) -> Plane:
        """Return the problem whose unknowns are the two free coordinates."""
        return Plane(self.problem, self.through, self.free)


@final
class Plane(Problem):
    """A problem as a function of two of its coordinates, in their units; the others are fixed.

    problem: the problem. through: a point in the plane, shape (n,). free: indices of the two coordinates.
    """

    def __init__(self, problem: Problem, through: Float[ndarray, " n"], free: tuple[int, int]) -> None:
        self._problem, self._through, self._free = problem, through, list(free)
        self.lower, self.upper = problem.lower[self._free], problem.upper[self._free]
        self.has_gradient = problem.has_gradient  # type: ignore[misc]  # of this plane, not of all

    def evaluate(self, X: Float[ndarray, "p 2"]) -> Float[ndarray, " p"]:
        full = np.tile(self._through, (len(X), 1))
        full[:, self._free] = X
        return self._problem.evaluate(full)

    def value_and_gradient(self, x: Float[ndarray, " 2"]) -> tuple[float, Float[ndarray, " 2"]]:
        full = np.array(self._through)
        full[self._free] = x
        value, gradient = self._problem.value_and_gradient(full)
        return value, gradient[self._free]
