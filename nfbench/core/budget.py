"""The limits on what a solver may spend on one problem."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from pydantic import PlainValidator

from .errors import Incompatible
from .options import Ge, Gt, Le, Lt, Options, _shown, build
from .problem import Problem

__all__ = ["Budget", "TargetOption", "TargetTable", "objective_target"]


@dataclass(frozen=True)
class TargetTable(Options):
    """A target that is not an objective value. Exactly one of the three is given.

    gap: objective value minus the known minimum of the problem, in the problem's unit.
    error: error of the estimate, in the unit of the scenario's ``error``.
    error_in_bounds: error of the estimate divided by the Cramér–Rao bound of the instance.
    """

    gap: Annotated[float, Gt(0.0), Lt(math.inf)] | None = None
    error: Annotated[float, Gt(0.0), Lt(math.inf)] | None = None
    error_in_bounds: Annotated[float, Gt(0.0), Lt(math.inf)] | None = None

    def validate(self) -> None:
        given = {name: value for name, value in vars(self).items() if value is not None}
        if len(given) != 1:
            raise ValueError(f"expected one of gap, error and error_in_bounds, got {', '.join(given) or 'none'}")

    @property
    def kind(self) -> str:
        """Name of the option that is given."""
        return next(name for name, value in vars(self).items() if value is not None)

    @property
    def value(self) -> float:
        """Value of the option that is given."""
        return float(getattr(self, self.kind))


def _target(value: Any) -> float | TargetTable | None:
    if value is None or isinstance(value, TargetTable):
        return value
    if isinstance(value, Mapping):
        return build(TargetTable, {name: item for name, item in value.items() if item is not None})
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and abs(value) <= sys.float_info.max:
        return float(value)
    raise ValueError(f"expected a finite number or a table with gap, error or error_in_bounds, got {_shown(value)}")


TargetOption: TypeAlias = Annotated[Any, PlainValidator(_target)]
"""An option that is an objective value, a :class:`TargetTable`, as an object or as a table, or None."""


@dataclass(frozen=True)
class Budget(Options):
    """The limits on what a solver may spend on one problem. At least one of evaluations and seconds is required.

    evaluations: maximum number of evaluations of the objective, at most 10^15; None for no limit.
    seconds: maximum wall-clock time [s] from the start of the solver, at most 10^9, checked before each evaluation, and
    within a batch of evaluations; None for no limit.
    target: objective value, in the problem's unit, at or below which the solver is stopped, or a table with one of
    ``gap``, ``error`` and ``error_in_bounds``; None for no target.
    """

    evaluations: Annotated[int, Ge(1), Le(10**15)] | None = None
    seconds: Annotated[float, Gt(0.0), Le(1e9)] | None = None
    target: TargetOption = None

    def validate(self) -> None:
        if self.evaluations is None and self.seconds is None:
            raise ValueError("expected a limit on evaluations or seconds, got neither")


def objective_target(problem: Problem, budget: Budget, reached: object) -> float:
    """The objective value at which the run ends; −inf if there is none. Raises Incompatible or ValueError."""
    target = budget.target
    if reached is not None or target is None:
        return -math.inf
    if not isinstance(target, TargetTable):
        return float(target)
    if target.gap is None:
        raise ValueError(f"budget.target: {target.kind} needs the function `reached`, got none")
    minimum = getattr(problem, "minimum", None)
    if minimum is None:
        raise Incompatible(f"target.gap: no reference optimum is known for {type(problem).__name__}")
    value = float(minimum + target.gap)  # to the last digit, the largest value with value − minimum ≤ gap
    while value - minimum > target.gap:
        value = math.nextafter(value, -math.inf)
    while math.nextafter(value, math.inf) - minimum <= target.gap:
        value = math.nextafter(value, math.inf)
    return value
