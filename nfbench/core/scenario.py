"""The contracts of a scenario, what is measured, and of an instance, one draw of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy import ndarray

from .options import Options
from .problem import Problem

__all__ = ["Extra", "Instance", "ProblemInstance", "Scenario"]


class Instance(ABC):
    """One draw of a scenario: the data every method sees, and the truth by which it is scored."""

    @abstractmethod
    def score(self, estimate: ndarray) -> dict[str, float]:
        """Scores of an estimate by column name, among them the scenario's ``error``.

        Raises ValueError when the estimate's shape does not fit. A NaN ``error`` makes the run ``invalid``, unless the
        estimate is empty: to have found nothing is an answer.
        """

    def positions(self, estimate: ndarray) -> tuple[ndarray, ndarray] | None:
        """Where the sources are and where they were estimated, for figures: two (K, 3) in Cartesian metres.

        Row k of the second is the estimate assigned to source k, NaN where it has none. None, unless overridden: there
        are no positions to show.
        """
        return None

    def truth(self) -> ndarray | None:
        """The estimate whose ``error`` is 0, for checks; None where there is none to tell."""
        return None


class ProblemInstance(Instance, ABC):
    """An instance that is one problem to minimize, its minimizer the estimate: what the formulation `direct` solves."""

    problem: Problem


@dataclass(frozen=True)
class Extra:
    """What is imported when a plugin runs, beyond what its package always installs.

    name: the optional extra of that package that installs it; None where it is installed by itself. requires: modules.
    """

    name: str | None
    requires: tuple[str, ...]


@dataclass(frozen=True)
class Scenario(Options, ABC):
    """What is measured. Subclass as a frozen dataclass: its fields are the keys of ``[scenario]`` and ``[sweep]``.

    ``instance`` is the class that ``draw`` returns, by which formulations tell what they can solve.
    ``error`` names the score by which methods are ranked, smaller is better.
    """

    instance: ClassVar[type[Instance]]
    error: ClassVar[str] = "rmse_m"

    def warm_up(self) -> None:
        """Compile or load what runs will need; called before the first one, so that no clock sees it."""

    def needed_extra(self) -> Extra | None:
        """The optional library that these options need; none, unless overridden."""
        return None

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Instance:
        """Draw one instance from the generator handed in, and from nothing else."""
