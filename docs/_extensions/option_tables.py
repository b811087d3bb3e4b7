"""The directive ``option-table``: the keys of one table of a manifest, generated from the class that checks them.

``.. option-table:: nfbench.core:Budget`` shows one class; ``.. plugin-tables:: solver`` shows every registered plugin
of a kind, and ``.. kind-tables:: nfbench.problems.near_field.scenario:NearField array`` every kind of an option.
Each key has its type, unit, default and description; a key without a description is a warning, hence a failed build.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import re
import typing
from collections.abc import Iterator
from typing import Any

from docstrings import described, docstring, escaped
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from nfbench.core import OneOf, Options, PluginOption, Solver, TargetOption, Tune, canonical
from nfbench.plugins import Registry

__all__ = ["Key", "keys", "option_classes", "setup"]

UNITS = {"_m_s": "m/s", "_m": "m", "_deg": "°", "_db": "dB", "_hz": "Hz", "_s": "s", "_mb": "MiB", "_wavelengths": "λ"}
NAMED_UNITS = {"seconds": "s"}
NONE = {":": "default:", " for": "default:", " if": "leave it out if", ", or": "leave it out, or give"}
IN_BRACKETS = {"m", "s", "°", "dB", "λ", "MiB", "rad", "°, m", "rad, m"}

_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Key:
    """One key of a manifest's table."""

    name: str
    type: str
    unit: str
    default: str
    text: str


def option_classes() -> Iterator[tuple[str, type[Options]]]:
    """(title, class) of everything whose options a manifest can set."""
    from nfbench.core import Budget, TargetTable
    from nfbench.plugins.groups import Group
    from nfbench.study import Compare
    from nfbench.study.schema import Limits, Manifest, MethodTable, Proofs, Summary, Targets

    for cls in (Manifest, Limits, Summary, Targets, Proofs, Compare, MethodTable, Group, Budget, TargetTable):
        yield cls.__name__, cls
    registry = Registry()
    for kind in ("scenario", "formulation", "solver"):
        for name in registry.names(kind):
            cls = registry.find(kind, name).resolve()
            yield f"{kind} {name}", cls
            yield from _inner(f"{kind} {name}", cls)


def _inner(title: str, cls: type[Options]) -> Iterator[tuple[str, type[Options]]]:
    """The classes that options of this class are made of."""
    for name, hint in typing.get_type_hints(cls, include_extras=True).items():
        for mark in _marks(hint):
            if isinstance(mark, OneOf):
                yield from ((f"{title}: {name} {kind}", choice) for kind, choice in mark.classes.items())
        if _is_table(hint):
            yield f"{title}: {name}", hint


def keys(cls: type[Options]) -> list[Key]:
    """The keys of a class of options; ``text`` is empty where the docstring has no description."""
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = [field for field in dataclasses.fields(cls) if field.init]
    texts = described(docstring(cls), [field.name for field in fields]).texts
    found = []
    for field in fields:
        text = texts.get(field.name, "")
        default = _default(field)
        if default == "none":  # Python's word; a manifest has none, it leaves the key out
            for word, instead in NONE.items():
                text = re.sub(rf"\b[Nn]one{word} ", f"{instead} ", text)
        found.append(Key(field.name, _type(hints[field.name]), _unit(field.name, text), default, text))
    return found


def _unit(name: str, text: str) -> str:
    """From the end of the name, else from a unit in brackets in the description."""
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return unit
    if name in NAMED_UNITS:
        return NAMED_UNITS[name]
    brackets = [inside for inside in re.findall(r"\[([^\]]+)\]", text) if inside in IN_BRACKETS]
    return brackets[0] if brackets else ""


def _marks(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint)[1:] if typing.get_origin(hint) is typing.Annotated else ()


def _is_table(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Options)


def _type(hint: Any) -> str:
    """The type in the words of a manifest: ``integer ≥ 4``, ``"clip" or "resample"``, ``list of number``."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint == TargetOption:
        return "number or table"
    if marks := _marks(hint):
        if isinstance(marks[0], OneOf):
            return f"table of kind {', '.join(marks[0].classes)}"
        limits = [limit for mark in marks if (limit := _limit(mark))]
        return " ".join([_type(arguments[0]), " and ".join(limits)]).strip()
    if _is_table(hint) or hint is PluginOption or origin is dict:
        return "table"
    if origin is tuple and Any in arguments:
        return "list"
    if origin is tuple:
        parts = [part for part in arguments if part is not ...]
        return f"list of {_type(parts[0])}" if ... in arguments else f"[{', '.join(map(_type, parts))}]"
    if origin is typing.Literal:
        return ", ".join(f'"{choice}"' for choice in arguments)
    if arguments:
        return " or ".join(_type(part) for part in arguments if part is not type(None))
    return {"int": "integer", "float": "number", "str": "text", "bool": "boolean"}.get(
        getattr(hint, "__name__", ""), str(hint)
    )


def _limit(mark: Any) -> str:
    if isinstance(mark, Tune):
        return ""
    for sign, attribute in (("≥", "ge"), (">", "gt"), ("≤", "le"), ("<", "lt")):
        value = getattr(mark, attribute, math.inf)
        if abs(value) < math.inf:
            return f"{sign} {value:g}"
    return ""


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is field.default_factory is dataclasses.MISSING:
        return "required"
    value = field.default if field.default is not dataclasses.MISSING else field.default_factory()  # type: ignore[misc]
    return "none" if value is None else _toml(canonical(value, defaults=False))


def _toml(plain: Any) -> str:
    if isinstance(plain, dict):
        given = {name: value for name, value in plain.items() if value is not None}
        return f"{{ {', '.join(f'{name} = {_toml(value)}' for name, value in given.items())} }}" if given else "{}"
    if isinstance(plain, list):
        return f"[{', '.join(map(_toml, plain))}]"
    if isinstance(plain, bool):
        return str(plain).lower()
    if isinstance(plain, str):
        return f'"{plain}"'
    return f"{plain:g}" if isinstance(plain, float) and not plain.is_integer() else str(plain)


class _Tables(SphinxDirective):
    """What the directives share: a class as a title, its prose, and a table of its keys."""

    has_content = False

    def parsed(self, lines: list[str]) -> list[nodes.Node]:
        source = StringList(lines, source=f"<{self.name} {' '.join(self.arguments)}>")
        holder = nodes.section()
        holder.document = self.state.document
        self.state.nested_parse(source, self.content_offset, holder, match_titles=True)
        return list(holder.children)

    def table(self, cls: type[Options], prose: bool) -> list[str]:
        """The lines of reStructuredText that show a class."""
        rows = keys(cls)
        for row in rows:
            if not row.text:
                _log.warning(
                    "%s.%s has no description in its docstring", cls.__name__, row.name, location=self.get_location()
                )
        lines: list[str] = []
        if prose:
            for paragraph in described(docstring(cls), [row.name for row in rows]).prose:
                lines += [escaped(" ".join(paragraph.split())), ""]
        if issubclass(cls, Solver):
            lines += [escaped(_abilities(cls)), ""]
        if not rows:
            return [*lines, "It has no options.", ""]
        lines += [".. list-table::", "   :header-rows: 1", "   :class: keys", "", "   * - key"]
        lines += [f"     - {head}" for head in ("type", "unit", "default", "meaning")]
        for row in rows:
            lines.append(f"   * - ``{row.name}``")
            default = row.default if row.default in ("required", "none") else f"``{row.default}``"
            lines += [f"     - {escaped(cell)}" for cell in (row.type, row.unit, default, row.text)]
        return [*lines, ""]


def _abilities(cls: type[Solver]) -> str:
    info = cls.info
    words = [
        "global search" if info.global_search else "local search",
        "stochastic" if info.stochastic else "deterministic",
        "evaluates batches" if info.batched else "evaluates point by point",
        "needs the gradient"
        if info.needs_gradient
        else "uses the gradient where there is one"
        if info.uses_gradient
        else "derivative-free",
    ]
    extra = f" Installed by the extra ``{info.extra}``." if info.extra else ""
    reference = f" Reference: {info.reference}." if info.reference else ""
    return f"{', '.join(words).capitalize()}.{extra}{reference}"


def _imported(place: str) -> type[Options]:
    module, _, name = place.partition(":")
    cls: type[Options] = getattr(importlib.import_module(module), name)
    return cls


class OptionTable(_Tables):
    """The keys of one class, with or without its prose."""

    required_arguments = 1
    option_spec = {"prose": lambda _: True}  # noqa: RUF012  # docutils' own interface

    def run(self) -> list[nodes.Node]:
        return self.parsed(self.table(_imported(self.arguments[0]), "prose" in self.options))


class PluginTables(_Tables):
    """Every registered plugin of nfbench of one kind, each under its name."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        registry, (kind,) = Registry(), self.arguments
        lines: list[str] = []
        for name in registry.names(kind):
            plugin = registry.find(kind, name)
            if not plugin.origin.startswith("nfbench "):
                continue
            lines += [f".. _{kind}-{name}:", "", f"``{name}``", "~" * (len(name) + 4), ""]
            lines += self.table(plugin.resolve(), True)
        return self.parsed(lines)


class KindTables(_Tables):
    """Every kind of an option that takes a table with a kind, such as the arrays of a near-field scenario."""

    required_arguments = 2

    def run(self) -> list[nodes.Node]:
        cls, option = _imported(self.arguments[0]), self.arguments[1]
        hint = typing.get_type_hints(cls, include_extras=True)[option]
        (mark,) = (mark for mark in _marks(hint) if isinstance(mark, OneOf))
        lines: list[str] = []
        for kind, choice in mark.classes.items():
            title = f'``{option} = {{ kind = "{kind}", … }}``'
            lines += [f".. _{option}-{kind}:", "", title, "~" * len(title), "", *self.table(choice, True)]
        return self.parsed(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("option-table", OptionTable)
    app.add_directive("plugin-tables", PluginTables)
    app.add_directive("kind-tables", KindTables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
