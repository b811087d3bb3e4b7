"""Groups of solvers: every installed one that has a property, by one name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nfbench.core import OptionError, Options, PluginError, Solver, SolverInfo, build, suggest

from .registry import Registry

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

    exclude: names of solvers that are left out. include: further solvers as tables, such as single algorithms of a
    wrapped library; the group has them where they are installed.
    """

    group: str
    exclude: tuple[str, ...] = ()
    include: tuple[dict[str, Any], ...] = ()

    def validate(self) -> None:
        if self.group not in GROUPS:
            known = suggest(self.group, GROUPS)
            raise OptionError(type(self).__name__, [("group", f"unknown group {self.group!r}{known}")])


def members(registry: Registry, table: dict[str, Any]) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """What ``{group = …, exclude = […], include = […]}`` stands for, and what is left out, and why.

    The first holds each solver's table by where it comes from, those of the group sorted by name and then those it
    includes. Left out are solvers that fail to import and included ones that are not installed; others of the group
    that are not installed do not count. Raises OptionError for an unknown key, group, or name to exclude or include.
    """
    group = build(Group, table)
    known = registry.names("solver")
    named: list[tuple[str, Any]] = [(f"exclude[{i}]", name) for i, name in enumerate(group.exclude)]
    named += [(f"include[{i}].kind", extra.get("kind")) for i, extra in enumerate(group.include)]
    problems = [
        (path, "is required" if name is None else f"unknown solver {name!r}{suggest(str(name), known)}")
        for path, name in named
        if name not in known
    ]
    found: dict[str, dict[str, Any]] = {}
    left_out = []
    for name in sorted({*known} - {*group.exclude}):
        plugin = registry.find("solver", name)
        try:
            cls = plugin.resolve()
            assert issubclass(cls, Solver)
            missing = plugin.missing()
        except PluginError as error:
            left_out.append(f"{error}; it is left out of group {group.group}")
            continue
        if GROUPS[group.group](cls.info) and not cls.info.composed and not missing:
            found[f"group: {name}"] = {"kind": name}
    for i, extra in enumerate(group.include):
        if extra.get("kind") not in known:
            continue
        try:
            missing = registry.find("solver", extra["kind"]).missing()
            why = f"solver {extra['kind']} {missing}" if missing else ""
        except PluginError as error:
            why = str(error)
        if why:
            left_out.append(f"{why}; it is left out of group {group.group}")
        else:
            found[f"include[{i}]"] = extra
    if not found and not problems:
        problems = [("group", f"no installed solver is in {group.group!r}")]
    if problems:
        raise OptionError("Group", problems)
    return found, left_out
