"""Prints the registered plugins: the tables of ``nfbench list`` and the page of ``nfbench show``."""

from __future__ import annotations

import dataclasses
import functools
import io
import math
import typing
from collections.abc import Callable, Iterable
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

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
    explain,
    printable,
    suggest,
)
from nfbench.plugins import GROUPS, Plugin, Registry, description, rehearse

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
        table = _table(f"{kind}s", _HEADS[kind])
        hidden: list[str] = []
        notes: list[str] = []
        for name in registry.names(kind):
            plugin = registry.find(kind, name)
            try:
                _try_first(plugin, functools.partial(_Entry.of, plugin, chosen))
                entry = _Entry.of(plugin, chosen)
            except Exception as error:  # of the plugin: its row says why
                entry = _Entry([_text(_reason(error), "red")])
            if not entry.admitted:
                continue
            if entry.missing and not chosen.uninstalled:
                hidden.append(name)
                continue
            if entry.broken:
                notes.append(f"{name}: {entry.broken} algorithms do not work here (nfbench show solver {name})")
            table.add_row(_text(name), *entry.cells)
        console.print(table)
        if hidden:
            notes.insert(0, f"Not installed: {', '.join(hidden)} (nfbench list {kind}s --all)")
        for note in notes:
            console.print(_text(note))
    for file, why in registry.broken.items():
        console.print(_text(f"{file.name} could not be imported: {why}", "red"))


@dataclasses.dataclass(frozen=True)
class _Entry:
    """What the catalogue shows of one plugin.

    cells: its row, without the name.
    admitted: whether the filter admits it.
    missing: which libraries it needs that are not installed; None if there are none.
    broken: number of the algorithms of a library that do not work here.
    """

    cells: list[Text]
    admitted: bool = True
    missing: str | None = None
    broken: int = 0

    @classmethod
    def of(cls, plugin: Plugin, chosen: Filter) -> _Entry:
        """Read what is shown from the class of a plugin. Raises what the class raises."""
        found = plugin.resolve()
        missing = plugin.missing()
        cells = [_text(cell) for cell in _row(plugin.kind, found, missing)]
        if not issubclass(found, Solver):
            return cls(cells, missing=missing)
        admitted = chosen.admits(found.info)
        return cls(cells, admitted, missing, len(found.unusable()) if admitted and not missing else 0)


def print_plugin(registry: Registry, kind: str, name: str, console: Console) -> None:
    """Print a plugin's docstring, and each option with type and default. Raises PluginError if it is unknown."""
    try:
        plugin = registry.find(kind, name)
    except PluginError as error:
        broken = [f"plugin {file.name} could not be imported: {why}" for file, why in registry.broken.items()]
        raise PluginError("; ".join([str(error), *broken])) from error
    _try_first(plugin, lambda: _print_plugin(plugin, Console(file=io.StringIO())))
    _print_plugin(plugin, console)


def _print_plugin(plugin: Plugin, console: Console) -> None:
    kind, name, cls = plugin.kind, plugin.name, plugin.resolve()
    console.print(Text.assemble((printable(f"{kind} {name}"), "bold"), f" ({printable(plugin.origin)})\n"))
    try:
        for line in description(cls).split("\n"):
            console.print(_text(line))
        missing = plugin.missing()
        if issubclass(cls, Solver):
            _print_solver(cls, bool(missing), console)
        if missing:
            console.print(_text(f"\n{name} {missing}", "yellow"), soft_wrap=True)
        _print_all_options(cls, console)
    except PluginError:
        raise
    except Exception as error:
        raise PluginError(f"{kind} {name} cannot be described: {explain(error)}") from error


def _try_first(plugin: Plugin, describe: Callable[[], object]) -> None:
    """Describe a plugin of a file in a child process first. Raises PluginError if that does not end as it should."""
    if not plugin.foreign:
        return

    def described() -> str:
        try:
            describe()
        except MemoryError:
            raise
        except Exception:  # which is reported by this process, too
            return ""
        return ""

    advice = "slow code, and code that may end the process, belongs in minimize, draw or solve"
    if reason := rehearse(described, "described", advice):
        raise PluginError(f"{plugin.kind} {plugin.name} of {plugin.origin} cannot be described: {reason}")


def _print_solver(cls: type[Solver], missing: bool, console: Console) -> None:
    """Print the solver's properties, and the algorithms of a library that do not work here."""
    for field in dataclasses.fields(cls.info):
        value = getattr(cls.info, field.name)
        if value not in ("", None, ()):
            value = ", ".join(value) if isinstance(value, tuple) else value
            console.print(_text(f"  {field.name}: {value}"))
    reasons: dict[str, list[str]] = {}
    for algorithm, reason in (cls.unusable() if not missing else {}).items():
        reasons.setdefault(reason, []).append(algorithm)
    if reasons:
        console.print(_text("\nAlgorithms that do not work here:", "yellow"))
    for reason, algorithms in reasons.items():
        console.print(_text(f"  {reason}:\n    {', '.join(algorithms)}"))


def _print_all_options(cls: type[Options], console: Console) -> None:
    """Print the options of a class and those of the tables that its options accept."""
    _print_options("options", cls, console)
    for option, hint in typing.get_type_hints(cls, include_extras=True).items():
        for mark in _marks(hint):
            if isinstance(mark, OneOf):
                for kind, choice in mark.classes.items():
                    _print_options(f'{option} = {{ kind = "{kind}", … }}', choice, console)
        if _is_table(hint):
            _print_options(f"{option} = {{ … }}", hint, console)


def _print_options(title: str, cls: type[Options], console: Console) -> None:
    """Print a table of the options of one class."""
    table = _table(title, ("name", "type", "default"))
    hints = typing.get_type_hints(cls, include_extras=True)
    for option in dataclasses.fields(cls):
        table.add_row(_text(option.name), _text(_type(hints[option.name])), _text(_default(option)))
    if table.row_count:
        console.print(table)


def _table(title: str, heads: Iterable[str]) -> Table:
    table = Table(title=_text(title), title_justify="left", title_style="bold")
    for head in heads:
        table.add_column(head, overflow="fold")
    return table


def _text(text: object, style: str = "") -> Text:
    """Return text from a plugin to be shown literally: without markup, emoji codes and control characters."""
    return Text("\n".join(printable(line) for line in str(text).split("\n")), style)


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, PluginError) else f"cannot be described: {explain(error)}"


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
            info.reference,
        ]
    first_line = description(cls).partition("\n")[0]
    about = f"{first_line} (not installed)" if missing else first_line
    return [("yes" if cls.needs_solver else "no") if kind == "formulation" else cls.error, about]


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
