"""The contract of a formulation: how an instance becomes problems, and their minimizers an estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

from numpy import ndarray

from .minimum import Minimum
from .options import Options
from .problem import Problem
from .scenario import Instance

__all__ = ["Formulation", "Minimize"]

Minimize: TypeAlias = Callable[[Problem], Minimum]
"""Minimizes a problem with the run's solver and budget; the run ends here if that fails."""


@dataclass(frozen=True)
class Formulation(Options, ABC):
    """How an instance is solved. Subclass as a frozen dataclass: its fields are its options in ``[[formulation]]``.

    ``accepts`` is the class of instances it can solve. Where ``needs_solver`` is false it runs once, not once per
    solver, and never calls ``minimize``.
    """

    accepts: ClassVar[type[Instance]]
    needs_solver: ClassVar[bool] = True

    @abstractmethod
    def solve(self, instance: Any, minimize: Minimize) -> ndarray:
        """The estimate for ``instance`` (an ``accepts``), as its ``score`` expects it.

        Raises Incompatible, with the reason, where this instance is outside what the method can do.
        """
