"""Prints the registered plugins: the tables of ``nfbench list`` and the page of ``nfbench show``."""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import typing
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from nfbench.core import (
    OneOf,
    OptionError,
    Options,
    PluginError,
    PluginOption,
    Solver,
    SolverInfo,
    Tune,
    canonical,
    suggest,
)
from nfbench.plugins import GROUPS, Registry

__all__ = ["Filter", "print_catalogue", "print_plugin"]


@dataclasses.dataclass(frozen=True)
class Filter:
    """Which solvers to list. A field that is None does not restrict the list.

    group: name of the group, a key of GROUPS.
    needs_gradient: whether the solvers need a gradient.
    batched: whether the solvers evaluate points in batches.
    stochastic: whether the solvers are stochastic.
    uninstalled: whether to list plugins whose extra is not installed, too.
    """

    group: str | None = None
    needs_gradient: bool | None = None
    batched: bool | None = None
    stochastic: bool | None = None
    uninstalled: bool = False

    def __post_init__(self) -> None:
        if self.group is not None and self.group not in GROUPS:
            raise OptionError("list", [("--group", f"unknown group {self.group!r}{suggest(self.group, GROUPS)}")])

    def admits(self, info: SolverInfo) -> bool:
        """Whether a solver with these properties is listed."""
        properties = (
            (self.needs_gradient, info.needs_gradient),
            (self.batched, info.batched),
            (self.stochastic, info.stochastic),
        )
        if self.group is not None and (info.composed or not GROUPS[self.group](info)):
            return False
        return all(want in (None, has) for want, has in properties)


def print_catalogue(registry: Registry, kinds: Iterable[str], console: Console, chosen: Filter | None = None) -> None:
    """Print one table per kind. ``chosen`` filters the solvers. Plugins that fail to import show their error."""
    chosen = chosen or Filter()
    for kind in kinds:
        table = Table(title=f"{kind}s", title_justify="left", title_style="bold")
        for head in _HEADS[kind]:
            table.add_column(head, overflow="fold")
        hidden: list[str] = []
        for name in registry.names(kind):
            plugin = registry.find(kind, name)
            missing = None
            try:
                cls = plugin.resolve()
                missing = plugin.missing()
                cells = _row(kind, cls, missing)
                if issubclass(cls, Solver) and not chosen.admits(cls.info):
                    continue
            except PluginError as error:
                cells = [f"[red]{escape(str(error))}[/red]"]
            if missing and not chosen.uninstalled:
                hidden.append(name)
                continue
            table.add_row(name, *cells)
        console.print(table)
        if hidden:
            console.print(f"Not installed: {', '.join(hidden)} (nfbench list {kind}s --all)")
    for file, why in registry.broken.items():
        console.print(f"[red]{file.name} could not be imported: {escape(why)}[/red]")


def print_plugin(registry: Registry, kind: str, name: str, console: Console) -> None:
    """Print a plugin's docstring, and each option with type and default. Raises PluginError if it is unknown."""
    plugin = registry.find(kind, name)
    cls = plugin.resolve()
    console.print(f"[bold]{kind} {name}[/bold] ({plugin.origin})\n")
    console.print(_doc(cls), markup=False)
    if issubclass(cls, Solver):
        for field in dataclasses.fields(cls.info):
            value = getattr(cls.info, field.name)
            if value not in ("", None, ()):
                value = ", ".join(value) if isinstance(value, tuple) else value
                console.print(f"  {field.name}: {value}", markup=False)
    if missing := plugin.missing():
        console.print(f"\n{name} {missing}", markup=False, style="yellow", soft_wrap=True)
    _print_options("options", cls, console)
    for name, hint in typing.get_type_hints(cls, include_extras=True).items():
        for mark in _marks(hint):
            if isinstance(mark, OneOf):
                for kind_, choice in mark.classes.items():
                    _print_options(f'{name} = {{ kind = "{kind_}", … }}', choice, console)
        if _is_table(hint):
            _print_options(f"{name} = {{ … }}", hint, console)


def _print_options(title: str, cls: type, console: Console) -> None:
    """Print a table of the options of one class."""
    table = Table(title=escape(title), title_justify="left", title_style="bold")
    for head in ("name", "type", "default"):
        table.add_column(head, overflow="fold")
    hints = typing.get_type_hints(cls, include_extras=True)
    for option in dataclasses.fields(cls):
        table.add_row(option.name, escape(_type(hints[option.name])), escape(_default(option)))
    if table.row_count:
        console.print(table)


_HEADS = {
    "solver": ("name", "search", "points", "random", "gradient", "extra", "reference"),
    "formulation": ("name", "needs a solver", "description"),
    "scenario": ("name", "ranked by", "description"),
}


def _row(kind: str, cls: Any, missing: str | None) -> list[str]:
    if kind == "solver":
        info = cls.info
        return [
            "global" if info.global_search else "local",
            "batch" if info.batched else "single",
            "yes" if info.stochastic else "no",
            "needed" if info.needs_gradient else "used" if info.uses_gradient else "no",
            f"{info.extra or ''}{' (not installed)' if missing else ''}".strip(),
            escape(info.reference),
        ]
    first_line = _doc(cls).partition("\n")[0]
    description = f"{first_line} (not installed)" if missing else first_line
    return [("yes" if cls.needs_solver else "no") if kind == "formulation" else cls.error, description]


def _doc(cls: type) -> str:
    """The class's own docstring; empty if it only has the signature that dataclasses generate."""
    doc = inspect.getdoc(cls) or ""
    if doc.startswith(f"{cls.__name__}("):
        return ""
    # join wrapped lines so that the terminal can wrap them; paragraphs, lists and "name: …" start a new line
    return re.sub(r"(?<=\S)\n(?![\n\s]|\w[\w, ]*: )", " ", doc)


def _type(hint: Any) -> str:
    """A field's type in the terms of a manifest: ``int >= 4``, ``"clip" | "resample"``."""
    if marks := _marks(hint):
        if isinstance(marks[0], OneOf):
            return "table of kind " + " | ".join(marks[0].classes)
        limits = [_limit(mark) for mark in marks]
        return " ".join([_type(typing.get_args(hint)[0]), *filter(None, limits)])
    if _is_table(hint) or hint is PluginOption:
        return "table"
    if typing.get_origin(hint) is tuple:
        parts = [_type(part) for part in typing.get_args(hint) if part is not ...]
        return f"[{', '.join(parts)}{', …' if ... in typing.get_args(hint) else ''}]"
    if typing.get_origin(hint) is typing.Literal:
        return " | ".join(repr(choice) for choice in typing.get_args(hint))
    if typing.get_args(hint) and typing.get_origin(hint) not in (tuple, list, dict):
        return " | ".join(_type(part) for part in typing.get_args(hint) if part is not type(None))
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint).replace("typing.", "")


def _is_table(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Options)


def _marks(hint: Any) -> tuple[Any, ...]:
    """The marks that ``Annotated`` adds to the type."""
    return typing.get_args(hint)[1:] if typing.get_origin(hint) is typing.Annotated else ()


def _limit(mark: Any) -> str:
    if isinstance(mark, Tune):
        return f"(tuned in {mark.low:g} … {mark.high:g})"
    for sign, attribute in ((">=", "ge"), (">", "gt"), ("<=", "le"), ("<", "lt")):
        if abs(getattr(mark, attribute, math.inf)) < math.inf:
            return f"{sign} {getattr(mark, attribute)}"
    return ""


def _default(option: dataclasses.Field[Any]) -> str:
    if option.default is not dataclasses.MISSING:
        value = option.default
    elif option.default_factory is dataclasses.MISSING:
        return "required"
    else:
        value = option.default_factory()
    plain = canonical(value)
    if isinstance(plain, list) and plain and all(isinstance(item, dict) for item in plain):
        return f"[{', '.join(item['kind'] if 'kind' in item else str(item) for item in plain)}]"
    if isinstance(plain, dict):
        given = ", ".join(f"{name} = {item}" for name, item in plain.items() if item is not None)
        return plain.get("kind") or f"{{ {given} }}".replace("{  }", "{}")
    return "none" if value is None else str(plain)
