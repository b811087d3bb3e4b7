"""Solvers over solvers: options that name another solver by its table, and how that one is run on a part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Annotated, Any, TypeAlias, cast

import numpy as np
from pydantic import PlainValidator

from .errors import BudgetExhausted, OptionError, PluginError
from .meter import MeteredProblem
from .options import Named, Options
from .registry import Registry
from .solver import Solver, SolverInfo

__all__ = ["InnerSolver", "combined", "inner", "run_part", "solver_of", "versions"]


def inner(kind: str, **options: Any) -> Named:
    """A registered solver as an :data:`InnerSolver` option holds it, e.g. for a default.

    Raises OptionError for an unknown or uninstalled solver, or wrong options.
    """
    registry = Registry.present()
    try:
        return Named(kind, registry.make("solver", kind, options), registry.find("solver", kind).version)
    except PluginError as error:
        raise OptionError("", [("kind", str(error))]) from error


def _inner(value: Any) -> Named:
    if isinstance(value, Named):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"expected a table with the kind of a solver, got {value!r}")
    kind = value.get("kind")
    if not isinstance(kind, str):
        came = f"expected a text, got {kind!r}" if "kind" in value else "is required"
        raise OptionError("", [("kind", f"{came}; known: {', '.join(Registry.present().names('solver'))}")])
    return inner(kind, **{name: item for name, item in value.items() if name != "kind"})


InnerSolver: TypeAlias = Annotated[Named, PlainValidator(_inner)]
"""An option that is another solver, given by its table: ``{ kind = "de", population = 20 }``."""


def solver_of(named: Named) -> Solver:
    """The solver that an :data:`InnerSolver` option holds."""
    return cast(Solver, named.made)


def combined(info: SolverInfo, solvers: Iterable[Solver]) -> SolverInfo:
    """``info`` with what follows from the solvers that are run: true where it is of any of them."""
    infos = [solver.info for solver in solvers]
    names = ("stochastic", "batched", "needs_gradient", "uses_gradient", "global_search", "converges")
    found: dict[str, Any] = {name: any(getattr(each, name) for each in infos) for name in names}
    return replace(info, **found)


def run_part(solver: Solver, part: MeteredProblem, rng: np.random.Generator) -> bool:
    """Let a solver minimize a part of a problem, with a child of ``rng``. Returns whether it ended before the part did.

    BudgetExhausted passes where it is not the part that is used up, but the whole.
    """
    try:
        solver.minimize(part, rng.spawn(1)[0])
    except BudgetExhausted:
        if not part.spent:
            raise
    return not part.spent


def versions(made: Options) -> Iterator[str]:
    """The versions of all plugins that the options of this one name."""
    for field in fields(made):
        value = getattr(made, field.name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, Named):
                yield item.version
                yield from versions(item.made)
