"""The contract of a solver: it minimizes any problem within its budget and knows nothing of antennas."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .meter import MeteredProblem
from .options import Options

__all__ = ["AskTell", "AskTellSolver", "Solver", "SolverInfo"]


@dataclass(frozen=True)
class SolverInfo:
    """What a solver is, as data: tests, tables and manifests select by these, never by name.

    stochastic: uses the generator it is given. batched: evaluates many points at a time.
    needs_gradient: works only where ``problem.has_gradient``; uses_gradient: takes it where there is one.
    global_search: looks beyond one basin.
    converges: drives its best point to high precision (false: samples, like random search).
    reference: authors, year and DOI of the algorithm. requires: modules it imports when it runs, beyond what its
    package always installs; extra: the optional extra of that package that installs them.
    composed: runs solvers that its options name, and so is in no group.
    """

    stochastic: bool = True
    batched: bool = False
    needs_gradient: bool = False
    uses_gradient: bool = False
    global_search: bool = True
    converges: bool = True
    reference: str = ""
    extra: str | None = None
    requires: tuple[str, ...] = ()
    composed: bool = False


@dataclass(frozen=True)
class Solver(Options, ABC):
    """An optimization algorithm. Subclass as a frozen dataclass: its fields are its options.

    ``minimize`` asks ``problem.evaluate(X)`` for a batch or ``problem(x)`` for one point, reads ``problem.lower``,
    ``.upper``, ``.dimension`` and ``.remaining``, and draws randomness from ``rng`` alone. It returns nothing: the
    meter knows the best point, and the last population where ``problem.keep_population(X, values)`` tells it. It may
    end early; if it never would, BudgetExhausted, which it must let pass, ends it.
    """

    info: ClassVar[SolverInfo] = SolverInfo()

    def warm_up(self) -> None:
        """Compile or load what ``minimize`` needs; called before any clock runs."""

    @abstractmethod
    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        """Minimize ``problem`` until its budget is used up or nothing is left to do."""


class AskTell(Protocol):
    """The running state of an algorithm that proposes points and is told their values."""

    def ask(self) -> Float[ndarray, "p n"]:
        """The next points to evaluate, one a row, within the box; none (p = 0) ends the search."""

    def tell(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        """The values of the points last asked for."""


@dataclass(frozen=True)
class AskTellSolver(Solver, ABC):
    """Base of ask/tell algorithms: owns the loop; a subclass only starts its state."""

    @abstractmethod
    def start(self, problem: MeteredProblem, rng: np.random.Generator) -> AskTell:
        """The algorithm's state before its first ``ask``."""

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        state = self.start(problem, rng)
        while len(X := state.ask()):
            state.tell(X, problem.evaluate(X))
