"""The target of a run: when its solver is stopped, given a target that is not an objective value."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, final

from numpy import ndarray

from nfbench.core import Formulation, Incompatible, Instance, Problem, Scenario, TargetTable

__all__ = ["Stopping"]


@final
class Stopping:
    """Decides for each problem of a run when the solver is stopped at ``target``.

    Raises Incompatible, with the reason, if the target needs a Cramér–Rao bound and the instance has none.
    """

    def __init__(self, target: Any, scenario: Scenario, formulation: Formulation, instance: Instance) -> None:
        self.table = target if isinstance(target, TargetTable) else None
        self.measure, self.formulation, self.instance = scenario.ranked_by(), formulation, instance
        self.limit = self.table.value if self.table else math.nan
        if self.table and self.table.kind == "error_in_bounds":
            bounds: Callable[[], dict[str, float]] = getattr(instance, "bounds", dict)
            bound = bounds().get("crb_m", math.nan)
            if not 0.0 < bound < math.inf:
                raise Incompatible("target.error_in_bounds: the instance has no Cramér–Rao bound")
            self.limit *= bound

    def test(self, problem: Problem) -> Callable[[ndarray, float], bool] | None:
        """Return whether a best point and its value reach the target; None if the objective value alone decides.

        Raises Incompatible, with the reason, if that cannot be decided for this problem.
        """
        if self.table is None:
            return None
        if self.table.kind == "gap":
            if getattr(problem, "minimum", None) is None:
                raise Incompatible("target.gap: no reference optimum is known")
            return None
        if self.formulation.estimates(self.instance, problem.lower[None]) is None:
            name = type(self.formulation).__name__
            text = f"the estimate of {name} is not a function of the minimizer of one problem"
            raise Incompatible(f"target.{self.table.kind}: {text}")
        return self._error_reached

    def _error_reached(self, x: ndarray, value: float) -> bool:
        estimates = self.formulation.estimates(self.instance, x[None])
        return estimates is not None and bool(self.instance.errors(self.measure, estimates)[0] <= self.limit)
