"""Resolves the tables of a manifest: each names a plugin, gives its options, and gets a label of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeVar, overload

from nfbench.core import Formulation, MissingExtra, OptionError, Options, PluginError, Scenario, Solver, canonical
from nfbench.plugins import Registry, members, versions

from .plan import digest
from .records import PluginSpec

__all__ = ["ErrorCollector", "Resolved", "Resolver"]

T_co = TypeVar("T_co", bound=Options, covariant=True)


class ErrorCollector:
    """Collects what is wrong with a manifest as ``path: message`` lines, each line once."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def add(self, path: str, text: str) -> None:
        """Record one error at ``path``."""
        self.add_line(f"{path}: {text}")

    def add_line(self, line: str) -> None:
        """Record a line that already names its path."""
        if line not in self.texts:
            self.texts.append(line)

    def add_all(self, path: str, error: OptionError) -> None:
        """Record every problem of an OptionError below ``path``."""
        for sub, text in error.problems:
            self.add(".".join(part for part in (path, sub) if part) or "manifest", text)


@dataclass(frozen=True)
class Resolved(Generic[T_co]):
    """What a table of the manifest stands for: the specification that enters the plan, and the object it makes.

    ``made`` is None where the named plugin cannot be imported: the specification is kept, and its runs fail.
    """

    spec: PluginSpec
    made: T_co | None

    @property
    def identity(self) -> str:
        """A digest of the plugin and its options; labels do not enter it."""
        return digest(self.spec.identity)


class Resolver:
    """Resolves tables with the plugins of one registry, and keeps their labels distinct."""

    def __init__(self, registry: Registry, errors: ErrorCollector) -> None:
        self.registry = registry
        self.errors = errors
        self.warnings: list[str] = []
        self._pool: dict[str, dict[str, PluginSpec]] = {"scenario": {}, "formulation": {}, "solver": {}}

    @overload
    def resolve(
        self, kind: Literal["scenario"], table: Mapping[str, Any], path: str, errors: ErrorCollector | None = None
    ) -> Resolved[Scenario] | None: ...
    @overload
    def resolve(
        self, kind: Literal["formulation"], table: Mapping[str, Any], path: str, errors: ErrorCollector | None = None
    ) -> Resolved[Formulation] | None: ...
    @overload
    def resolve(
        self, kind: Literal["solver"], table: Mapping[str, Any], path: str, errors: ErrorCollector | None = None
    ) -> Resolved[Solver] | None: ...
    def resolve(
        self,
        kind: Literal["scenario", "formulation", "solver"],
        table: Mapping[str, Any],
        path: str,
        errors: ErrorCollector | None = None,
    ) -> Resolved[Options] | None:
        """What a table of this kind stands for; None if the table is wrong, with the errors recorded."""
        errors = errors or self.errors
        named = self._name_and_label(kind, table, path, errors)
        if named is None:
            return None
        name, label = named
        options = {key: value for key, value in table.items() if key not in ("kind", "label")}
        try:
            plugin = self.registry.find(kind, name)
        except PluginError as error:
            if not self.registry.broken or "did you mean" in str(error):
                errors.add(f"{path}.kind", str(error))
                return None
            why = "; ".join(f"plugin {file.name}: {text}" for file, text in self.registry.broken.items())
            return self._unavailable(kind, name, label, options, digest(why), f"{error} ({why})")
        try:
            made: Options = self.registry.make(kind, name, options)
        except OptionError as error:
            errors.add_all(path, error)
            return None
        except MissingExtra as error:
            errors.add(f"{path}.kind", str(error))
            return None
        except PluginError as error:
            return self._unavailable(kind, name, label, options, plugin.version, str(error))
        every, chosen = _without_kind(canonical(made)), _without_kind(canonical(made, defaults=False))
        version = "+".join(dict.fromkeys([plugin.version, *versions(made)]))
        return Resolved(self._keep(kind, PluginSpec(name, label, every, chosen, version)), made)

    def resolve_group(self, table: Mapping[str, Any], path: str) -> list[Resolved[Solver]]:
        """The solvers that ``{group = …, exclude = […]}`` stands for; none, with errors recorded, if it is wrong."""
        if "kind" in table:
            self.errors.add(path, f"expected a kind or a group, got both: {table['kind']!r} and {table['group']!r}")
            return []
        try:
            tables, left_out = members(self.registry, dict(table))
        except OptionError as error:
            self.errors.add_all(path, error)
            return []
        self.warnings = list(dict.fromkeys([*self.warnings, *left_out]))
        solvers = [self.resolve("solver", table, f"{path}.{where}") for where, table in tables.items()]
        return list({solver.identity: solver for solver in solvers if solver}.values())

    def labelled(self, kind: str, spec: PluginSpec) -> PluginSpec:
        """The specification with its final label: its own, or its kind, made unique by the options that differ."""
        pool = self._pool[kind].values()
        label = self._pool[kind][digest(spec.identity)].label or self._distinct(spec, kind)
        twins = [other for other in pool if other.label == label and other.identity != spec.identity]
        if twins:
            self.errors.add(kind, f"two of them are labelled {label!r}; give each its own label")
        return replace(spec, label=label)

    def _name_and_label(
        self, kind: str, table: Mapping[str, Any], path: str, errors: ErrorCollector
    ) -> tuple[str, str] | None:
        name, label = table.get("kind"), table.get("label", "")
        if not isinstance(label, str) or ("label" in table and not label):
            errors.add(f"{path}.label", f"expected a text, got {table['label']!r}")
            return None
        if not isinstance(name, str):
            known = ", ".join(self.registry.names(kind))
            came = f"expected a text, got {name!r}" if "kind" in table else "is required"
            errors.add(f"{path}.kind", f"{came}; known: {known}")
            return None
        return name, label or (name if kind == "scenario" else "")

    def _unavailable(
        self, kind: str, name: str, label: str, options: Mapping[str, Any], version: str, why: str
    ) -> Resolved[Any]:
        """A plugin that cannot be imported: its runs are planned and fail with the reason."""
        given = canonical(options)
        return Resolved(self._keep(kind, PluginSpec(name, label, given, given, version, why)), None)

    def _keep(self, kind: str, spec: PluginSpec) -> PluginSpec:
        """Remember the specification; a label given once holds wherever the same plugin and options are named."""
        known = self._pool[kind].setdefault(digest(spec.identity), spec)
        if spec.label and not known.label:
            self._pool[kind][digest(spec.identity)] = spec
        elif spec.label != known.label and spec.label:
            self.errors.add(kind, f"{spec.kind} is labelled both {known.label!r} and {spec.label!r}")
        return spec

    def _distinct(self, spec: PluginSpec, kind: str) -> str:
        """``de``, or ``de(population=120)`` where another ``de`` without a label differs in that."""
        others = [o for o in self._pool[kind].values() if o.kind == spec.kind and o.identity != spec.identity]
        differing = [
            key
            for key, value in spec.options.items()
            if any(other.options.get(key) != value for other in others if not other.label)
        ]
        shown = ", ".join(f"{key}={_plain(spec.options[key])}" for key in differing)
        return f"{spec.kind}({shown})" if shown else spec.kind


def _without_kind(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != "kind"}


def _plain(value: Any) -> str:
    """A value as a label shows it: of a table only what is set."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}={_plain(item)}' for name, item in value.items() if item is not None)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_plain, value))}]"
    return str(value)
