"""Groups of solvers: names for all installed solvers with a common property."""

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
    """A group of solvers: ``group = "global"`` in place of a kind stands for every installed solver of that group.

    The solvers have their default options. Solvers that run other solvers, such as a portfolio, belong to no group.

    group: name of the group.
    exclude: names of solvers to leave out of the group.
    include: tables of further solvers to add, such as single algorithms of a wrapped library. Those that are not
    installed are left out with a warning.
    """

    group: str
    exclude: tuple[str, ...] = ()
    include: tuple[dict[str, Any], ...] = ()

    def validate(self) -> None:
        if self.group not in GROUPS:
            known = suggest(self.group, GROUPS)
            raise OptionError(type(self).__name__, [("group", f"unknown group {self.group!r}{known}")])


def members(registry: Registry, table: dict[str, Any]) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Return the solvers that ``{group = …, exclude = […], include = […]}`` stands for, and warnings.

    The first item maps the origin of each solver to its table: first the solvers of the group, sorted by name, then
    the included ones. The second lists the solvers that were left out, with the reason: those that fail to import and
    included ones that are not installed. Other solvers that are not installed are not listed. Raises OptionError for
    an unknown key or group, for an unknown solver in ``exclude`` or ``include``, and if the group has no solver.
    """
    group = build(Group, table)
    known = registry.names("solver")
    entries: list[tuple[str, Any]] = [(f"exclude[{i}]", name) for i, name in enumerate(group.exclude)]
    entries += [(f"include[{i}].kind", extra.get("kind")) for i, extra in enumerate(group.include)]
    problems = [
        (path, "is required" if name is None else f"unknown solver {name!r}{suggest(str(name), known)}")
        for path, name in entries
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
            reason = f"solver {extra['kind']} {missing}" if missing else ""
        except PluginError as error:
            reason = str(error)
        if reason:
            left_out.append(f"{reason}; it is left out of group {group.group}")
        else:
            found[f"include[{i}]"] = extra
    if not found and not problems:
        problems = [("group", f"expected a group with at least one installed solver, got {group.group!r}")]
    if problems:
        raise OptionError("Group", problems)
    return found, left_out
