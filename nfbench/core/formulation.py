"""The contract of a formulation, which turns an instance into problems and their minimizers into an estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeAlias

from numpy import ndarray

from .minimum import Minimum
from .options import Options
from .problem import Problem
from .reference import Reference
from .scenario import Instance

__all__ = ["Formulation", "Minimize", "Solution"]

Minimize: TypeAlias = Callable[[Problem], Minimum]
"""Minimizes a problem with the run's solver and budget. If this fails, the call does not return and the run ends."""


@dataclass(frozen=True, eq=False)
class Solution:
    """An estimate with more to say about it than its position, such as standard errors or a certificate.

    estimate: the estimate, in the form that ``instance.score`` expects.
    columns: numbers by the names of the columns in which a study stores them; they must differ from those of the
        scores.
    """

    estimate: ndarray
    columns: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Formulation(Options, ABC):
    """A way to solve an instance. Subclass it as a frozen dataclass; its fields are the keys of ``[[formulation]]``.

    ``accepts`` is the class of instances that the formulation can solve. If ``needs_solver`` is false, the formulation
    runs once instead of once per solver, and it must not call ``minimize``.
    """

    accepts: ClassVar[type[Instance]]
    needs_solver: ClassVar[bool] = True

    def warnings(self, scenario: Any) -> list[str]:
        """Return sentences about options that are valid but probably not what was meant for this scenario.

        ``scenario`` is one that draws instances of the class ``accepts``. The rest is as in ``Scenario.warnings``. An
        example is a default grid that takes long for a large array. The default is an empty list.
        """
        return []

    def warm_up(self) -> None:
        """Load or compile what ``solve`` needs with these options; the time is not part of any measured time."""

    def estimates(self, instance: Any, X: ndarray) -> ndarray | None:
        """Return the estimates (r, ...) that ``solve`` would return if its only minimizer were each row of X (r, n).

        This gives the error along a trace. The default is None: the estimate does not depend on the minimizer of a
        single problem alone, for example because the formulation minimizes several problems or refines the minimizer.
        """
        return None

    def reference(self, instance: Any) -> Reference | None:
        """Return the optimum of the first problem that ``solve`` minimizes, as far as it can be proven.

        A study with ``[reference]`` calls this once per scene and measures the gaps of all methods from the result. The
        result must depend on nothing but the instance and the options. The default is None: no proof is known.
        """
        return None

    @abstractmethod
    def solve(self, instance: Any, minimize: Minimize) -> ndarray | Solution:
        """Return the estimate for ``instance``, in the form that ``instance.score`` expects, alone or as a Solution.

        ``instance`` is an object of the class ``accepts``. Raise Incompatible, with the reason, if the formulation
        cannot solve this instance.
        """
