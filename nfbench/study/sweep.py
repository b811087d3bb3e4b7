"""The points of a sweep: every combination of the swept values, each with its scenario."""

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
    """Every combination of the swept values, and one of the scenarios to check formulations against."""
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
        places = {f"scenario.{key}": f"sweep.{key}[{i}]" for key, (i, _) in zip(swept, indexed, strict=True)}
        here = ErrorCollector()
        resolved = resolver.resolve("scenario", _with(manifest.scenario, setting), "scenario", here)
        for text in here.texts:
            errors.add_line(_renamed(text, places))
        if resolved is None:
            continue
        spec, scenario = resolved.spec, resolved.made
        where = ", ".join(places.values())
        first = seen.setdefault(resolved.identity, where)
        if first != where:
            errors.add(where, f"the same scenario as at {first}")
        points.append(Point(spec, {key: _at(spec.options, key, setting[key]) for key in swept}))
    if scenario is None and not errors.texts:
        errors.add("scenario", points[0].scenario.broken or "cannot be made")
    return points, scenario


def _renamed(text: str, places: Mapping[str, str]) -> str:
    """An error at a swept key of the scenario, with its place in the sweep as the path."""
    for path, place in places.items():
        if text.startswith(path) and text[len(path)] in ":.[":
            return place + text[len(path) :]
    return text


def _swept(sweep: Table, errors: ErrorCollector, prefix: str = "") -> dict[str, list[Any]]:
    """``[sweep]`` with nested tables flattened to dotted keys."""
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
    """The scenario table with each dotted key set."""
    table = copy.deepcopy(table)
    for path, value in setting.items():
        *outer, last = path.split(".")
        inner = table
        for key in outer:
            inner = inner.setdefault(key, {})
            if not isinstance(inner, dict):
                return {**table, path: value}  # reported as an unknown option of that name
        inner[last] = value
    return table


def _at(options: Table, path: str, given: Any) -> Any:
    """The canonical value of a dotted key, or the given one where the options do not keep it (a file that was read)."""
    value: Any = options
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return given if value is None else value
