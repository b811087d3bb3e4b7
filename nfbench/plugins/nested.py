"""Options that hold another solver or formulation, and runs of a solver on part of a budget."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import PlainValidator

from nfbench.core import (
    BudgetExhausted,
    Formulation,
    MeteredProblem,
    OptionError,
    Options,
    PluginError,
    PluginOption,
    Solver,
    SolverInfo,
)

from .registry import Registry

__all__ = [
    "NestedFormulation",
    "NestedSolver",
    "combined_info",
    "formulation_of",
    "nested_formulation",
    "nested_solver",
    "run_part",
    "solver_of",
    "versions",
]


def nested_solver(kind: str, **options: Any) -> PluginOption:
    """Return a registered solver as the value of a :data:`NestedSolver` option, e.g. for its default.

    Raises OptionError if the solver is unknown or not installed, or if its options are invalid.
    """
    return _nested("solver", kind, options)


def nested_formulation(kind: str, **options: Any) -> PluginOption:
    """Return a registered formulation as the value of a :data:`NestedFormulation` option, e.g. for its default.

    Raises OptionError if the formulation is unknown, or if its options are invalid.
    """
    return _nested("formulation", kind, options)


def _nested(contract: str, kind: str, options: Mapping[str, Any]) -> PluginOption:
    registry = Registry.present()
    try:
        return PluginOption(kind, registry.make(contract, kind, options), registry.find(contract, kind).version)
    except PluginError as error:
        raise OptionError("", [("kind", str(error))]) from error


def _as_option(contract: str, value: Any) -> PluginOption:
    if isinstance(value, PluginOption):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"expected a table with the kind of a {contract}, got {value!r}")
    kind = value.get("kind")
    if not isinstance(kind, str):
        problem = f"expected a string, got {kind!r}" if "kind" in value else "is required"
        raise OptionError("", [("kind", f"{problem}; known: {', '.join(Registry.present().names(contract))}")])
    return _nested(contract, kind, {name: item for name, item in value.items() if name != "kind"})


def _as_solver(value: Any) -> PluginOption:
    return _as_option("solver", value)


def _as_formulation(value: Any) -> PluginOption:
    return _as_option("formulation", {"kind": value} if isinstance(value, str) else value)


NestedSolver: TypeAlias = Annotated[PluginOption, PlainValidator(_as_solver)]
"""An option whose value is another solver, given as a table such as ``{ kind = "de", population = 20 }``."""

NestedFormulation: TypeAlias = Annotated[PluginOption, PlainValidator(_as_formulation)]
"""An option whose value is another formulation, given as a name, or as a table such as ``{ kind = "music" }``."""


def solver_of(option: PluginOption) -> Solver:
    """Return the solver of a :data:`NestedSolver` option."""
    assert isinstance(option.made, Solver)
    return option.made


def formulation_of(option: PluginOption) -> Formulation:
    """Return the formulation of a :data:`NestedFormulation` option."""
    assert isinstance(option.made, Formulation)
    return option.made


def combined_info(info: SolverInfo, solvers: Iterable[Solver]) -> SolverInfo:
    """Return ``info`` with the properties of the nested solvers; a property is true if any of them has it."""
    infos = [solver.info for solver in solvers]
    names = (
        *("stochastic", "batched", "needs_gradient", "uses_gradient", "global_search", "converges"),
        *("needs_evaluations", "plans_evaluations"),
    )
    combined: dict[str, Any] = {name: any(getattr(nested, name) for nested in infos) for name in names}
    return replace(info, **combined)


def run_part(solver: Solver, part: MeteredProblem, rng: np.random.Generator) -> bool:
    """Run a solver on ``part``, with a generator spawned from ``rng``; return whether the solver ended early.

    ``part`` comes from ``MeteredProblem.part`` and has part of the budget of the whole problem. The solver ended early
    if it returned before the budget of the part was used up. Raises BudgetExhausted only if the budget of the whole
    problem is used up or its target has been reached.
    """
    try:
        solver.minimize(part, rng.spawn(1)[0])
    except BudgetExhausted:
        if not part.spent:
            raise
    return not part.spent


def versions(made: Options) -> Iterator[str]:
    """Yield the versions of all plugins in the options of ``made``, including nested ones."""
    for field in fields(made):
        value = getattr(made, field.name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, PluginOption):
                yield item.version
                yield from versions(item.made)
