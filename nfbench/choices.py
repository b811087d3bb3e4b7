"""Turns the tables of a manifest into choices: a plugin, its canonical options, and a label that is its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from .errors import MissingExtra, OptionError, PluginError
from .groups import members
from .inner import versions
from .options import Options, canonical
from .registry import Registry
from .study import Choice, digest

__all__ = ["Chooser", "Problems"]


class Problems:
    """Collects what is wrong with a manifest, each once, as ``path: message``."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def add(self, path: str, text: str) -> None:
        self.note(f"{path}: {text}")

    def note(self, line: str) -> None:
        if line not in self.texts:
            self.texts.append(line)

    def of(self, path: str, error: OptionError) -> None:
        """Every problem of an OptionError, below ``path``."""
        for sub, text in error.problems:
            self.add(".".join(part for part in (path, sub) if part) or "manifest", text)


class Chooser:
    """Makes choices from tables and keeps their labels apart."""

    def __init__(self, registry: Registry, problems: Problems) -> None:
        self.registry = registry
        self.problems = problems
        self.warnings: list[str] = []
        self._pool: dict[str, dict[str, Choice]] = {"scenario": {}, "formulation": {}, "solver": {}}

    def choose(
        self, kind: str, table: Mapping[str, Any], path: str, problems: Problems | None = None
    ) -> tuple[Choice, Options | None] | None:
        """The choice a table stands for and the object it makes; None, with the problems noted, if it is wrong.

        The object is None where a plugin that is named fails to import: that is kept as a choice whose runs fail.
        """
        problems = problems or self.problems
        name, label = table.get("kind"), table.get("label", "")
        if not isinstance(label, str) or ("label" in table and not label):
            problems.add(f"{path}.label", f"expected a text, got {table['label']!r}")
            return None
        if not isinstance(name, str):
            known = ", ".join(self.registry.names(kind))
            came = f"expected a text, got {name!r}" if "kind" in table else "is required"
            problems.add(f"{path}.kind", f"{came}; known: {known}")
            return None
        if kind == "scenario":
            label = label or name
        options = {key: value for key, value in table.items() if key not in ("kind", "label")}
        try:
            plugin = self.registry.find(kind, name)
        except PluginError as error:
            if not self.registry.broken or "did you mean" in str(error):
                problems.add(f"{path}.kind", str(error))
                return None
            why = "; ".join(f"plugin {file.name}: {text}" for file, text in self.registry.broken.items())
            given = canonical(options)
            return self._keep(kind, Choice(name, label, given, given, digest(why), f"{error} ({why})")), None
        try:
            made = self.registry.make(kind, name, options)
        except OptionError as error:
            problems.of(path, error)
            return None
        except MissingExtra as error:
            problems.add(f"{path}.kind", str(error))
            return None
        except PluginError as error:
            given = canonical(options)
            return self._keep(kind, Choice(name, label, given, given, plugin.version, str(error))), None
        plain, chosen = _without_kind(canonical(made)), _without_kind(canonical(made, defaults=False))
        version = "+".join(dict.fromkeys([plugin.version, *versions(made)]))
        return self._keep(kind, Choice(name, label, plain, chosen, version)), made

    def group(self, table: Mapping[str, Any], path: str) -> list[tuple[Choice, Options | None]]:
        """The choices that ``{group = …, exclude = […]}`` stands for; none, with the problems noted, if it is wrong."""
        if "kind" in table:
            self.problems.add(path, f"expected a kind or a group, got both: {table['kind']!r} and {table['group']!r}")
            return []
        try:
            tables, left_out = members(self.registry, dict(table))
        except OptionError as error:
            self.problems.of(path, error)
            return []
        self.warnings = list(dict.fromkeys([*self.warnings, *left_out]))
        chosen = [self.choose("solver", table, f"{path}.{where}") for where, table in tables.items()]
        return list({digest(choice[0].identity): choice for choice in chosen if choice}.values())

    def labelled(self, kind: str, choice: Choice) -> Choice:
        """The choice with its final label: its own, or its kind, made unique by the options that differ."""
        pool = self._pool[kind].values()
        label = self._pool[kind][digest(choice.identity)].label or self._distinct(choice, kind)
        twins = [other for other in pool if other.label == label and other.identity != choice.identity]
        if twins:
            self.problems.add(kind, f"two of them are labelled {label!r}; give each its own label")
        return replace(choice, label=label)

    def _keep(self, kind: str, choice: Choice) -> Choice:
        """Remember the choice; a label given once holds wherever the same choice is named."""
        known = self._pool[kind].setdefault(digest(choice.identity), choice)
        if choice.label and not known.label:
            self._pool[kind][digest(choice.identity)] = choice
        elif choice.label != known.label and choice.label:
            self.problems.add(kind, f"{choice.kind} is labelled both {known.label!r} and {choice.label!r}")
        return choice

    def _distinct(self, choice: Choice, kind: str) -> str:
        """``de``, or ``de(population=120)`` where another ``de`` without a label differs in that."""
        others = [o for o in self._pool[kind].values() if o.kind == choice.kind and o.identity != choice.identity]
        differing = [
            key
            for key, value in choice.options.items()
            if any(other.options.get(key) != value for other in others if not other.label)
        ]
        shown = ", ".join(f"{key}={_plain(choice.options[key])}" for key in differing)
        return f"{choice.kind}({shown})" if shown else choice.kind


def _without_kind(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != "kind"}


def _plain(value: Any) -> str:
    """A value as a label shows it: of a table only what is set."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}={_plain(item)}' for name, item in value.items() if item is not None)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_plain, value))}]"
    return str(value)
