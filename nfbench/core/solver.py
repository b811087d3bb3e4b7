"""The contract of a solver, which minimizes any problem within a budget."""

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
    """The properties of a solver. Tests, tables and groups select solvers by these properties, not by name.

    stochastic: whether the solver uses the random generator it is given.
    batched: whether the solver evaluates many points at a time.
    needs_gradient: whether the solver works only if ``problem.has_gradient`` is true.
    uses_gradient: whether the solver uses the gradient if the problem has one.
    global_search: whether the solver searches beyond one basin of attraction.
    converges: whether the best point converges to high precision; false for solvers that only sample, such as random
    search.
    reference: authors, year and DOI of the algorithm.
    extra: name of the package's optional extra that installs the modules in ``requires``; None if there is none.
    requires: modules that the solver imports when it runs and that its package does not always install.
    composed: whether the solver runs other solvers, which its options name; such solvers belong to no group.
    needs_evaluations: whether the solver works only if the budget limits the evaluations, because its search depends on
    the share of them that is spent.
    plans_evaluations: whether the search depends on the number of evaluations in the budget; if the budget has none,
    the solver plans for its option ``horizon``.
    accepts_start: whether the solver continues from ``problem.start`` if points are given there.
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
    needs_evaluations: bool = False
    plans_evaluations: bool = False
    accepts_start: bool = False


@dataclass(frozen=True)
class Solver(Options, ABC):
    """An optimization algorithm. Subclass it as a frozen dataclass; its fields are its options.

    ``minimize`` evaluates a batch with ``problem.evaluate(X)`` or one point with ``problem(x)``. It may read
    ``problem.lower``, ``problem.upper``, ``problem.dimension`` and ``problem.remaining``, and it must draw all random
    numbers from ``rng``. It returns nothing, because the meter keeps the best point, and also the last population if
    the solver calls ``problem.keep_population(X, values)``. It may return early. Otherwise the exception
    BudgetExhausted, which the solver must not catch, ends it.
    """

    info: ClassVar[SolverInfo] = SolverInfo()

    @classmethod
    def unusable(cls) -> dict[str, str]:
        """Return the values of the option ``algorithm`` that do not work with the installed libraries, with reasons.

        The solver's ``validate`` refuses them. The default is that all values work. The method is called only if the
        modules that the solver requires are installed.
        """
        return {}

    def warm_up(self) -> None:
        """Compile or load what ``minimize`` needs. It is called before the run is timed."""

    @abstractmethod
    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        """Minimize ``problem`` until the budget is used up or the algorithm ends."""


class AskTell(Protocol):
    """The state of an algorithm with an ask/tell interface, which proposes points and receives their values."""

    def ask(self) -> Float[ndarray, "p n"]:
        """Return the next points to evaluate, one per row, within the box. An empty batch (p = 0) ends the search."""

    def tell(self, X: Float[ndarray, "p n"], values: Float[ndarray, " p"]) -> None:
        """Receive the values of the points that the last call of ``ask`` returned."""


@dataclass(frozen=True)
class AskTellSolver(Solver, ABC):
    """Base class of algorithms with an ask/tell interface. It implements the loop; a subclass implements ``start``."""

    @abstractmethod
    def start(self, problem: MeteredProblem, rng: np.random.Generator) -> AskTell:
        """Return the state of the algorithm before the first call of ``ask``."""

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        state = self.start(problem, rng)
        while len(X := state.ask()):
            state.tell(X, problem.evaluate(X))
