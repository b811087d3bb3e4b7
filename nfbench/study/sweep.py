"""The points of a sweep: all combinations of the swept values, each with its scenario."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from nfbench.core import OptionError, Scenario, build

from .plan import digest
from .records import Point
from .resolve import ErrorCollector, Resolver
from .schema import Limits, Manifest, Table
from .swept_names import SweptNames

__all__ = ["AT_FIRST", "Sweep", "limits_given_twice", "sweep_points", "with_first_limits"]

MAX_KEYS = 100
MAX_POINTS = 10_000
MAX_COPIED = 5_000_000  # values of the scenario's table, times the number of points
SCENARIO, BUDGET = "scenario.", "budget."  # what a swept key may start with; without it, it is of the scenario
SWEPT_LIMITS = ("evaluations", "seconds", "target")
AT_FIRST = 200  # points that are built before the other tables are checked
ENOUGH = 100  # errors after which no further point is built


def with_first_limits(manifest: Manifest) -> Manifest:
    """Return the manifest with the first swept value of each limit in ``[budget]``, to check the methods with."""
    swept = _swept(manifest.sweep, ErrorCollector())
    first = {key.removeprefix(BUDGET): values[0] for key, values in swept.items() if key.startswith(BUDGET)}
    return replace(manifest, budget={**manifest.budget, **first})


def limits_given_twice(manifest: Manifest, errors: ErrorCollector) -> None:
    """Record an error for each limit that is swept and also given by a formulation or method, which would ignore it."""
    swept = {key.removeprefix(BUDGET) for key in _swept(manifest.sweep, ErrorCollector()) if key.startswith(BUDGET)}
    for name, tables in (("formulation", manifest.formulation), ("method", manifest.method)):
        for i, table in enumerate(tables):
            own = table.get("budget")
            for key in sorted(swept & set(own)) if isinstance(own, dict) else ():
                errors.add(f"{name}[{i}].budget.{key}", f"is swept by sweep.{BUDGET}{key}; give only one of the two")


def sweep_points(manifest: Manifest, resolver: Resolver) -> tuple[list[Point], Scenario | None]:
    """Return a point for every combination of the swept values, and one scenario to check formulations against."""
    sweep = Sweep(manifest, resolver)
    sweep.build()
    return sweep.points, sweep.scenario


@dataclass
class Sweep:
    """The points of a manifest, which are built in the order of the sweep.

    points: points that have been built.
    scenarios: scenarios of these points; None where the plugin cannot be imported.
    """

    manifest: Manifest
    resolver: Resolver
    points: list[Point] = field(default_factory=list)
    scenarios: list[Scenario | None] = field(default_factory=list)

    def __post_init__(self) -> None:
        errors = self.resolver.errors
        self._seen: dict[str, str] = {}
        self._swept = _swept(self.manifest.sweep, errors)
        self._names = {key: SweptNames(key, values) for key, values in self._swept.items()}
        for key, names in self._names.items():
            for place, text in names.problems():
                errors.add(f"sweep.{key}{place}", text)
        self._count = math.prod(map(len, self._swept.values()))
        self._left = self._settings() if self._may_be_built() else iter(())
        self._done = 0

    @property
    def scenario(self) -> Scenario | None:
        """One scenario to check formulations against; None if there is none."""
        return self.scenarios[-1] if self.scenarios else None

    def build(self, at_most: int | None = None) -> None:
        """Build the next points: as many as this, or all that are left. Errors are recorded."""
        errors, before = self.resolver.errors, len(self.resolver.errors.texts)
        for setting, paths in itertools.islice(self._left, at_most):
            self._build(setting, paths)
            self._done += 1
            if len(errors.texts) - before >= ENOUGH and self._done < self._count:
                errors.add("sweep", f"the other {self._count - self._done:,} of {self._count:,} points are not checked")
                self._left = iter(())
                break
        if self.points and self.scenario is None and not errors.texts:
            errors.add("scenario", self.points[0].scenario.broken or "cannot be constructed")
        measures = {scenario.ranked_by(): None for scenario in self.scenarios if scenario is not None}
        if len(measures) > 1 and not errors.texts:
            errors.add("sweep", f"expected points with one measure of the error, got {', '.join(measures)}")
        most = self.most_scenes
        if most and self.manifest.scenes > most[0]:
            errors.add("scenes", f"expected at most {most[0]:,}, {most[1]}, got {self.manifest.scenes:,}")

    @property
    def most_scenes(self) -> tuple[int, str] | None:
        """The smallest number of different scenes at any point, and its reason; None if there is no limit."""
        limits = [scenario.most_scenes() for scenario in self.scenarios if scenario is not None]
        return min((limit for limit in limits if limit is not None), default=None)

    def _may_be_built(self) -> bool:
        """Whether the scenario is given and there are not too many points; if not, record the error."""
        errors, table = self.resolver.errors, self.manifest.scenario
        if not table:
            if not errors.has("scenario"):
                known = ", ".join(self.resolver.registry.names("scenario"))
                errors.add("scenario.kind", f"is required; known: {known}")
            return False
        if len(self._swept) > MAX_KEYS:
            errors.add("sweep", f"expected at most {MAX_KEYS} keys, got {len(self._swept):,}")
            return False
        if self._count > MAX_POINTS:
            sizes = [f"{len(values):,}" for values in self._swept.values()]
            product = f"{' × '.join(sizes[:8])}{' × …' if sizes[8:] else ''} = " if sizes[1:] else ""
            errors.add("sweep", f"expected at most {MAX_POINTS:,} points, got {product}{_number(self._count)}")
            return False
        if self._count * _size(table) > MAX_COPIED:
            text = f"{self._count:,} points × {_size(table):,} values in [scenario]"
            errors.add("sweep", f"expected at most {MAX_COPIED:,} values in all points, got {text}")
            return False
        return True

    def _settings(self) -> Iterator[tuple[Table, dict[str, str]]]:
        """Yield, for each point, the swept values by key, and where in the sweep each of them is by its path."""
        swept = self._swept
        for indexed in itertools.product(*(list(enumerate(values)) for values in swept.values())):
            values = {key: value for key, (_, value) in zip(swept, indexed, strict=True)}
            paths = {_path(key): f"sweep.{key}[{i}]" for key, (i, _) in zip(swept, indexed, strict=True)}
            yield values, paths

    def _build(self, setting: Table, paths: dict[str, str]) -> None:
        errors, point_errors = self.resolver.errors, ErrorCollector()
        budget = {key.removeprefix(BUDGET): value for key, value in setting.items() if key.startswith(BUDGET)}
        table = _with(self.manifest.scenario, {key: setting[key] for key in setting if not key.startswith(BUDGET)})
        limits = self._limits(budget, paths)
        scenario_paths = {path: place for path, place in paths.items() if path.startswith(SCENARIO)}
        resolved = self.resolver.resolve("scenario", table, "scenario", point_errors)
        for text in point_errors.texts:
            errors.add_line(_renamed(text, scenario_paths, self.manifest.scenario))
        if resolved is None or limits is None:
            return
        origin = ", ".join(paths.values())
        first = self._seen.setdefault(digest([resolved.identity, limits]), origin)
        if first != origin:
            errors.add(origin, f"gives the same scenario as {first}")
        spec = resolved.spec
        self.scenarios.append(resolved.made)
        values = {
            key: limits.get(key.removeprefix(BUDGET), setting[key])
            if key.startswith(BUDGET)
            else self._names[key].name(setting[key], _at(spec.options, key, setting[key]))
            for key in self._swept
        }
        self.points.append(Point(spec, values, limits))

    def _limits(self, budget: Table, paths: dict[str, str]) -> Table | None:
        """The swept limits in canonical form; None if they are not valid, which is recorded."""
        errors, problems = self.resolver.errors, []
        if not budget:
            return {}
        if unknown := [key for key in budget if key not in SWEPT_LIMITS]:
            problems = [(key, f"cannot be swept; [budget] keys that can: {', '.join(SWEPT_LIMITS)}") for key in unknown]
        else:
            try:
                found = build(Limits, {**self.manifest.budget, **budget}).budget() or {}
                return {key: found[key] for key in budget}
            except OptionError as error:
                problems = error.problems
        for key, text in problems:
            errors.add_line(f"{paths.get(f'budget.{key}', f'budget.{key}')}: {text}")
        return None


def _renamed(text: str, paths: Mapping[str, str], given: Table) -> str:
    """Replace the path of an error in a swept key of the scenario by the path of its value in the sweep.

    So is the path of a table that only the sweep names, e.g. of ``antenna`` in ``antenna.elements``.
    """
    for path, swept_path in paths.items():
        if text.startswith(path) and text[len(path)] in ":.[":
            return swept_path + text[len(path) :]
    for path, swept_path in paths.items():
        _, *keys = path.split(".")
        for depth in range(1, len(keys)):
            outer = ".".join(keys[:depth])
            if text.startswith((f"scenario.{outer}:", f"scenario.{outer}.")) and not _has(given, keys[:depth]):
                return f"{swept_path}: {text.removeprefix('scenario.')}"
    return text


def _has(table: Any, keys: list[str]) -> bool:
    for key in keys:
        if not isinstance(table, dict) or key not in table:
            return False
        table = table[key]
    return True


def _path(key: str) -> str:
    """The path in the manifest of a swept key."""
    return key if key.startswith(BUDGET) else f"{SCENARIO}{key}"


def _swept(sweep: Table, errors: ErrorCollector) -> dict[str, list[Any]]:
    """Return the swept values by key: of an option of the scenario its path in [scenario], else ``budget.<key>``."""
    swept: dict[str, list[Any]] = {}
    for path, values in _flat(sweep, errors).items():
        key = path.removeprefix(SCENARIO)
        if key in swept:
            errors.add(f"sweep.{path}", f"is given twice, as {key} and as {SCENARIO}{key}")
        swept[key] = values
    return swept


def _flat(sweep: Table, errors: ErrorCollector, prefix: str = "") -> dict[str, list[Any]]:
    """Return ``[sweep]`` with nested tables flattened to dotted keys."""
    swept: dict[str, list[Any]] = {}
    for key, values in sweep.items():
        path = f"{prefix}{key}"
        if isinstance(values, dict):
            found = _flat(values, errors, f"{path}.")
        elif isinstance(values, list) and values:
            found = {path: values}
        else:
            errors.add(f"sweep.{path}", f"expected a list of one or more values, got {values!r}")
            continue
        for twice in found.keys() & swept.keys():
            errors.add(f"sweep.{twice}", "is given twice, as a dotted key and in a table")
        swept |= found
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


def _size(value: Any) -> int:
    """The number of values in a table or list, at any depth."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + sum(map(_size, items))


def _number(count: int) -> str:
    return f"{count:,}" if count < 10**15 else f"about 10^{math.log10(count):.0f}"
