"""Resolves the tables of a manifest, each of which names a plugin and its options, and gives them distinct labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeVar, overload

from nfbench.core import Formulation, MissingExtra, OptionError, Options, PluginError, Scenario, Solver, canonical
from nfbench.plugins import Registry, members, versions

from .labels import label_problem, safe_label
from .plan import digest
from .records import PluginSpec

__all__ = ["ErrorCollector", "Resolved", "Resolver"]

LONGEST = 2000  # characters of one error

T_co = TypeVar("T_co", bound=Options, covariant=True)


class ErrorCollector:
    """Collects the errors of a manifest as lines ``path: message``, without duplicates."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._known: set[str] = set()

    def add(self, path: str, text: str) -> None:
        """Record one error at ``path``."""
        self.add_line(f"{path}: {text}")

    def add_line(self, line: str) -> None:
        """Record an error that already has the form ``path: message``."""
        line = line[:LONGEST]
        if line not in self._known:
            self._known.add(line)
            self.texts.append(line)

    def has(self, *paths: str) -> bool:
        """Whether there is an error at or below one of these top-level paths."""
        return any(text.startswith(tuple(f"{path}{mark}" for path in paths for mark in ":.[")) for text in self.texts)

    def add_all(self, path: str, error: OptionError) -> None:
        """Record every problem of an OptionError, with its path below ``path``."""
        for sub, text in error.problems:
            self.add(".".join(part for part in (path, sub) if part) or "manifest", text)


@dataclass(frozen=True)
class Resolved(Generic[T_co]):
    """A resolved table of the manifest.

    spec: specification that becomes part of the plan.
    made: plugin object; None if the plugin cannot be imported. In that case the runs are planned, but fail.
    """

    spec: PluginSpec
    made: T_co | None

    @property
    def identity(self) -> str:
        """A hash of the plugin and its options, independent of the label."""
        return digest(self.spec.identity)


class Resolver:
    """Resolves tables with the plugins of one registry and keeps the labels distinct."""

    def __init__(self, registry: Registry, errors: ErrorCollector) -> None:
        self.registry = registry
        self.errors = errors
        self.warnings: list[str] = []
        self._pool: dict[str, dict[str, PluginSpec]] = {"scenario": {}, "formulation": {}, "solver": {}}
        self._final: dict[str, dict[str, str]] = {}
        self._made: dict[str, Options] = {}

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
        """Resolve a table of this kind. If the table is invalid, record the errors and return None."""
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
            reason = "; ".join(f"plugin {file.name}: {text}" for file, text in self.registry.broken.items())
            return self._unavailable(kind, name, label, options, digest(reason), f"{error} ({reason})")
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
        all_options, chosen = _without_kind(canonical(made)), _without_kind(canonical(made, defaults=False))
        version = "+".join(dict.fromkeys([plugin.version, *versions(made)]))
        spec = self._keep(kind, PluginSpec(name, label, all_options, chosen, version))
        if kind != "scenario":  # of which there may be thousands
            self._made[digest([kind, spec.identity])] = made
        return Resolved(spec, made)

    def made(self, kind: Literal["formulation", "solver"], spec: PluginSpec) -> Options | None:
        """Return the plugin object of a specification that ``resolve`` returned; None if it cannot be imported."""
        return self._made.get(digest([kind, spec.identity]))

    def resolve_group(self, table: Mapping[str, Any], path: str) -> list[Resolved[Solver]]:
        """Resolve a table ``{group = …, exclude = […], include = […]}`` to solvers.

        If the table is invalid, record the errors and return an empty list.
        """
        if "kind" in table:
            self.errors.add(path, f"expected a kind or a group, got both: {table['kind']!r} and {table['group']!r}")
            return []
        try:
            tables, left_out = members(self.registry, dict(table))
        except OptionError as error:
            self.errors.add_all(path, error)
            return []
        self.warnings = list(dict.fromkeys([*self.warnings, *left_out]))
        solvers = [self.resolve("solver", table, f"{path}.{origin}") for origin, table in tables.items()]
        return list({solver.identity: solver for solver in solvers if solver}.values())

    def labelled(self, kind: str, spec: PluginSpec) -> PluginSpec:
        """Return the specification with its final label. All tables of this kind must have been resolved before.

        The label is the one given in the manifest, or else the kind, with the options that distinguish it if needed.
        """
        if kind not in self._final:
            self._final[kind] = self._final_labels(kind)
        return replace(spec, label=self._final[kind][digest(spec.identity)])

    def _final_labels(self, kind: str) -> dict[str, str]:
        """Return the label of every specification of this kind, by the digest of its identity."""
        pool = self._pool[kind]
        varying = self._varying(kind)
        labels: dict[str, str] = {}
        taken: set[str] = set()
        for key, spec in pool.items():
            shown = ", ".join(
                f"{name}={_plain(value)}" for name, value in spec.options.items() if name in varying.get(spec.kind, ())
            )
            label = spec.label or safe_label(f"{spec.kind}({shown})" if shown else spec.kind, kind)
            if label in taken:
                self.errors.add(kind, f"two {kind}s are labelled {label!r}; give each its own label")
            taken.add(label)
            labels[key] = label
        return labels

    def _varying(self, kind: str) -> dict[str, set[str]]:
        """Return, by plugin, the options in which those without a label differ."""
        groups: dict[str, list[PluginSpec]] = {}
        for spec in self._pool[kind].values():
            if not spec.label:
                groups.setdefault(spec.kind, []).append(spec)
        return {
            name: {
                key
                for spec in specs
                for key in {**specs[0].options, **spec.options}
                if spec.options.get(key) != specs[0].options.get(key)
            }
            for name, specs in groups.items()
        }

    def _name_and_label(
        self, kind: str, table: Mapping[str, Any], path: str, errors: ErrorCollector
    ) -> tuple[str, str] | None:
        name, label = table.get("kind"), table.get("label", "")
        if not isinstance(label, str) or ("label" in table and not label):
            errors.add(f"{path}.label", f"expected a non-empty string, got {table['label']!r}")
            return None
        if label and (problem := label_problem(label)):
            errors.add(f"{path}.label", problem)
            return None
        if not isinstance(name, str):
            known = ", ".join(self.registry.names(kind))
            problem = f"expected a string, got {name!r}" if "kind" in table else "is required"
            errors.add(f"{path}.kind", f"{problem}; known: {known}")
            return None
        return name, label or (safe_label(name, kind) if kind == "scenario" else "")

    def _unavailable(
        self, kind: str, name: str, label: str, options: Mapping[str, Any], version: str, reason: str
    ) -> Resolved[Any]:
        """Resolve a plugin that cannot be imported. Its runs are planned and fail with the reason."""
        given = canonical(options)
        return Resolved(self._keep(kind, PluginSpec(name, label, given, given, version, reason)), None)

    def _keep(self, kind: str, spec: PluginSpec) -> PluginSpec:
        """Store the specification. A label given once applies wherever the same plugin and options are used."""
        known = self._pool[kind].setdefault(digest(spec.identity), spec)
        if spec.label and not known.label:
            self._pool[kind][digest(spec.identity)] = spec
        elif spec.label != known.label and spec.label:
            self.errors.add(
                kind, f"expected one label for the same {spec.kind}, got {known.label!r} and {spec.label!r}"
            )
        return spec


def _without_kind(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != "kind"}


def _plain(value: Any) -> str:
    """Format a value for a label; keys of a table whose value is None are omitted."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}={_plain(item)}' for name, item in value.items() if item is not None)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_plain, value))}]"
    return str(value)
