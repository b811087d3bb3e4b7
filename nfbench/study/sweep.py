"""The points of a sweep: all combinations of the swept values, each with its scenario."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping
from typing import Any

from nfbench.core import Scenario

from .records import Point
from .resolve import ErrorCollector, Resolver
from .schema import Manifest, Table

__all__ = ["sweep_points"]


def sweep_points(manifest: Manifest, resolver: Resolver) -> tuple[list[Point], Scenario | None]:
    """Return a point for every combination of the swept values, and one scenario to check formulations against."""
    errors = resolver.errors
    swept = _swept(manifest.sweep, errors)
    if not manifest.scenario:
        if not any(text.startswith("scenario") for text in errors.texts):
            errors.add("scenario.kind", f"is required; known: {', '.join(resolver.registry.names('scenario'))}")
        return [], None
    points: list[Point] = []
    scenario: Scenario | None = None
    seen: dict[str, str] = {}
    for indexed in itertools.product(*(list(enumerate(values)) for values in swept.values())):
        setting = {key: value for key, (_, value) in zip(swept, indexed, strict=True)}
        paths = {f"scenario.{key}": f"sweep.{key}[{i}]" for key, (i, _) in zip(swept, indexed, strict=True)}
        point_errors = ErrorCollector()
        resolved = resolver.resolve("scenario", _with(manifest.scenario, setting), "scenario", point_errors)
        for text in point_errors.texts:
            errors.add_line(_renamed(text, paths))
        if resolved is None:
            continue
        spec, scenario = resolved.spec, resolved.made
        origin = ", ".join(paths.values())
        first = seen.setdefault(resolved.identity, origin)
        if first != origin:
            errors.add(origin, f"gives the same scenario as {first}")
        points.append(Point(spec, {key: _at(spec.options, key, setting[key]) for key in swept}))
    if scenario is None and not errors.texts:
        errors.add("scenario", points[0].scenario.broken or "cannot be constructed")
    return points, scenario


def _renamed(text: str, paths: Mapping[str, str]) -> str:
    """Replace the path of an error in a swept key of the scenario by the path of its value in the sweep."""
    for path, swept_path in paths.items():
        if text.startswith(path) and text[len(path)] in ":.[":
            return swept_path + text[len(path) :]
    return text


def _swept(sweep: Table, errors: ErrorCollector, prefix: str = "") -> dict[str, list[Any]]:
    """Return ``[sweep]`` with nested tables flattened to dotted keys."""
    swept: dict[str, list[Any]] = {}
    for key, values in sweep.items():
        path = f"{prefix}{key}"
        if isinstance(values, dict):
            swept |= _swept(values, errors, f"{path}.")
        elif isinstance(values, list) and values:
            swept[path] = values
        else:
            errors.add(f"sweep.{path}", f"expected a list of one or more values, got {values!r}")
    return swept


def _with(table: Table, setting: Table) -> Table:
    """Return the scenario table with each dotted key set to its value."""
    table = copy.deepcopy(table)
    for path, value in setting.items():
        *outer, last = path.split(".")
        inner = table
        for key in outer:
            inner = inner.setdefault(key, {})
            if not isinstance(inner, dict):
                return {**table, path: value}  # will be reported as an unknown option of this name
        inner[last] = value
    return table


def _at(options: Table, path: str, given: Any) -> Any:
    """Return the canonical value of a dotted key, or the given value if the options do not contain it."""
    value: Any = options
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return given if value is None else value
