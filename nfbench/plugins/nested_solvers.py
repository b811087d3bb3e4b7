"""Solvers that run other solvers: options that name a solver by its table, and how it is run on part of a problem."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import PlainValidator

from nfbench.core import (
    BudgetExhausted,
    MeteredProblem,
    OptionError,
    Options,
    PluginError,
    PluginOption,
    Solver,
    SolverInfo,
)

from .registry import Registry

__all__ = ["NestedSolver", "combined_info", "nested_solver", "run_part", "solver_of", "versions"]


def nested_solver(kind: str, **options: Any) -> PluginOption:
    """A registered solver as an :data:`NestedSolver` option holds it, e.g. for a default.

    Raises OptionError for an unknown or uninstalled solver, or wrong options.
    """
    registry = Registry.present()
    try:
        return PluginOption(kind, registry.make("solver", kind, options), registry.find("solver", kind).version)
    except PluginError as error:
        raise OptionError("", [("kind", str(error))]) from error


def _nested(value: Any) -> PluginOption:
    if isinstance(value, PluginOption):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"expected a table with the kind of a solver, got {value!r}")
    kind = value.get("kind")
    if not isinstance(kind, str):
        came = f"expected a text, got {kind!r}" if "kind" in value else "is required"
        raise OptionError("", [("kind", f"{came}; known: {', '.join(Registry.present().names('solver'))}")])
    return nested_solver(kind, **{name: item for name, item in value.items() if name != "kind"})


NestedSolver: TypeAlias = Annotated[PluginOption, PlainValidator(_nested)]
"""An option that is another solver, given by its table: ``{ kind = "de", population = 20 }``."""


def solver_of(option: PluginOption) -> Solver:
    """The solver that a :data:`NestedSolver` option holds."""
    assert isinstance(option.made, Solver)
    return option.made


def combined_info(info: SolverInfo, solvers: Iterable[Solver]) -> SolverInfo:
    """``info`` with the capabilities of the nested solvers: true where it is true of any of them."""
    infos = [solver.info for solver in solvers]
    names = ("stochastic", "batched", "needs_gradient", "uses_gradient", "global_search", "converges")
    found: dict[str, Any] = {name: any(getattr(each, name) for each in infos) for name in names}
    return replace(info, **found)


def run_part(solver: Solver, part: MeteredProblem, rng: np.random.Generator) -> bool:
    """Let a solver minimize part of a problem, with a child of ``rng``. Returns whether it ended before its budget did.

    BudgetExhausted is raised where the budget of the whole problem is used up, not only that of the part.
    """
    try:
        solver.minimize(part, rng.spawn(1)[0])
    except BudgetExhausted:
        if not part.spent:
            raise
    return not part.spent


def versions(made: Options) -> Iterator[str]:
    """The versions of all plugins that are named in the options of this one."""
    for field in fields(made):
        value = getattr(made, field.name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, PluginOption):
                yield item.version
                yield from versions(item.made)
