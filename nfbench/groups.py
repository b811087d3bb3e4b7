"""Groups of solvers: every installed one that has a property, by one name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from .errors import OptionError, PluginError
from .options import Options, build, suggest
from .registry import Registry
from .solver import Solver, SolverInfo

__all__ = ["GROUPS", "Group", "members"]

GROUPS: dict[str, Callable[[SolverInfo], bool]] = {
    "all": lambda info: True,
    "global": lambda info: info.global_search,
    "local": lambda info: not info.global_search,
    "gradient": lambda info: info.needs_gradient or info.uses_gradient,
    "derivative-free": lambda info: not (info.needs_gradient or info.uses_gradient),
    "batched": lambda info: info.batched,
    "stochastic": lambda info: info.stochastic,
    "deterministic": lambda info: not info.stochastic,
}


@dataclass(frozen=True)
class Group(Options):
    """``group = "global"``, in place of a kind: every installed solver of that group, with its default options.

    Solvers over solvers, such as a portfolio, are in none.

    exclude: names of solvers that are left out.
    """

    group: str
    exclude: tuple[str, ...] = ()

    def validate(self) -> None:
        if self.group not in GROUPS:
            known = suggest(self.group, GROUPS)
            raise OptionError(type(self).__name__, [("group", f"unknown group {self.group!r}{known}")])


def members(registry: Registry, table: dict[str, Any]) -> tuple[list[str], list[str]]:
    """The names of the solvers that ``{group = …, exclude = […]}`` stands for, sorted; and what is left out, and why.

    Left out are solvers that fail to import; those whose extra is not installed do not count. Raises OptionError for
    an unknown key, group or excluded name.
    """
    group = build(Group, table)
    known = registry.names("solver")
    problems = [
        (f"exclude[{i}]", f"unknown solver {name!r}{suggest(name, known)}")
        for i, name in enumerate(group.exclude)
        if name not in known
    ]
    names, left_out = [], []
    for name in sorted({*known} - {*group.exclude}):
        plugin = registry.find("solver", name)
        try:
            info = cast(type[Solver], plugin.resolve()).info
            missing = plugin.missing()
        except PluginError as error:
            left_out.append(f"{error}; it is left out of group {group.group}")
            continue
        if GROUPS[group.group](info) and not info.composed and not missing:
            names.append(name)
    if not names and not problems:
        problems = [("group", f"no installed solver is in {group.group!r}")]
    if problems:
        raise OptionError("Group", problems)
    return names, left_out
