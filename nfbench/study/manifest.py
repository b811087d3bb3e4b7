"""Reads a manifest into a study, or reports all of its errors at once."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from nfbench.core import ManifestError, OptionError, PluginError, Scenario, build, relative_to
from nfbench.plugins import Registry

from .methods import budget_limits, study_methods
from .plan import Study
from .records import PluginSpec
from .resolve import ErrorCollector, Resolver
from .schema import Manifest, Summary, Table
from .sweep import sweep_points

__all__ = ["load_scenarios", "load_study"]


def load_study(path: str | Path, plugins: Iterable[str | Path] = ()) -> Study:
    """Read and validate a manifest; ``plugins`` are plugin files in addition to those that it names.

    Raises ManifestError, which lists every error as ``path: message``.
    """
    path = Path(path)
    table, text = _read(path)
    errors = ErrorCollector()
    with relative_to(path.parent):
        study = _study(table, text, path.parent, tuple(plugins), errors)
    if errors.texts or study is None:
        raise ManifestError(str(path), errors.texts)
    return study


def load_scenarios(path: str | Path, plugins: Iterable[str | Path] = ()) -> list[tuple[dict[str, Any], Scenario]]:
    """Return the swept values and the scenario of each point of a study; the rest of the manifest is ignored.

    Plugin files that the manifest names but that do not exist are ignored, because the manifest may be a copy in
    another folder. Raises ManifestError if a scenario is invalid, and PluginError if its plugin cannot be imported.
    """
    path = Path(path)
    table, _ = _read(path)
    errors = ErrorCollector()
    with relative_to(path.parent):
        manifest = _top_level(table, errors)
        named = [path.parent / file for file in manifest.plugins]
        resolver = Resolver(_registry([*filter(Path.exists, named), *plugins], errors), errors)
        points, _ = sweep_points(manifest, resolver)
        if errors.texts:
            raise ManifestError(str(path), errors.texts)
        return [(point.swept, _scenario(point.scenario, resolver.registry)) for point in points]


def _scenario(spec: PluginSpec, registry: Registry) -> Scenario:
    if spec.broken:
        raise PluginError(spec.broken)
    return registry.make("scenario", spec.kind, spec.options)


def _read(path: Path) -> tuple[Table, str]:
    """Return the tables of a manifest and its text."""
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text), text
    except (OSError, UnicodeDecodeError) as error:
        raise ManifestError(str(path), [f"cannot be read: {getattr(error, 'strerror', None) or error}"]) from error
    except tomllib.TOMLDecodeError as error:
        raise ManifestError(str(path), [f"is not valid TOML: {error}"]) from error


def _study(
    table: Table, text: str, folder: Path, extra: tuple[str | Path, ...], errors: ErrorCollector
) -> Study | None:
    manifest = _top_level(table, errors)
    registry = _registry([*(folder / file for file in manifest.plugins), *extra], errors)
    resolver = Resolver(registry, errors)
    points, scenario = sweep_points(manifest, resolver)
    budget_limits(manifest, {}, "budget", errors)
    methods = study_methods(manifest, resolver, scenario)
    summary = _summary(manifest.summary, errors)
    if errors.texts or scenario is None:
        return None
    return Study(
        name=manifest.name,
        title=manifest.title,
        expect=manifest.expect,
        seed=manifest.seed,
        repetitions=manifest.repetitions,
        points=tuple(points),
        methods=tuple(methods),
        error=scenario.error,
        outlier_m=summary.outlier_m,
        plugins=tuple(str(file) for file in registry.files),
        manifest=text,
        warnings=(
            *(f"plugin {file.name} is left out: {reason}" for file, reason in registry.broken.items()),
            *resolver.warnings,
        ),
    )


def _top_level(table: Table, errors: ErrorCollector) -> Manifest:
    """Read the top-level keys. Invalid ones are reported and replaced by stand-ins, so that the rest is checked too."""
    for key in ("formulation", "solver", "method"):
        if isinstance(table.get(key), dict):
            errors.add(key, f"expected a list of tables, got one table; write [[{key}]] instead of [{key}]")
            table = {**table, key: [table[key]]}
    try:
        return build(Manifest, table)
    except OptionError as error:
        errors.add_all("", error)
        invalid = {path.split(".")[0].split("[")[0] for path, _ in error.problems}
        stand_ins: Table = {"name": "x", "scenario": {}, "repetitions": 1, "seed": 0}
        known = {f.name for f in fields(Manifest)}
        return build(Manifest, {**stand_ins, **{k: v for k, v in table.items() if k in known - invalid}})


def _registry(files: Iterable[str | Path], errors: ErrorCollector) -> Registry:
    try:
        return Registry(files)
    except PluginError as error:
        errors.add("plugins", str(error))
        return Registry()


def _summary(table: Table, errors: ErrorCollector) -> Summary:
    try:
        return build(Summary, table)
    except OptionError as error:
        errors.add_all("summary", error)
        return Summary()
