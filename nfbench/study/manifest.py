"""Reads a manifest into a study, or reports all of its errors at once."""

from __future__ import annotations

import stat
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from nfbench.core import ManifestError, OptionError, PluginError, Scenario, build, relative_to
from nfbench.plugins import Registry

from .methods import budget_limits, study_methods
from .plan import Study
from .plausibility import plugin_warnings
from .reading import read_manifest as _read
from .records import Method, PluginSpec
from .resolve import ErrorCollector, Resolver
from .schema import Manifest, Summary, Table
from .sweep import AT_FIRST, Sweep, sweep_points

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

    Reading a study must not execute code that comes with it: the plugin files that the manifest names are not imported,
    only ``plugins``, which the user gives. Raises ManifestError if a scenario is invalid or needs a plugin file that is
    not given, and PluginError if its plugin cannot be imported.
    """
    path = Path(path)
    table, _ = _read(path)
    errors = ErrorCollector()
    with relative_to(path.parent):
        manifest = _top_level(table, errors)
        resolver = Resolver(_registry(plugins, errors), errors)
        points, _ = sweep_points(manifest, resolver)
        if errors.texts:
            hint = (
                "the plugin files that it names are not imported on reading; pass those that you trust with --plugin: "
            )
            raise ManifestError(
                str(path), [*errors.texts, *([hint + ", ".join(manifest.plugins)] * bool(manifest.plugins))]
            )
        return [(point.swept, _scenario(point.scenario, resolver.registry)) for point in points]


def _scenario(spec: PluginSpec, registry: Registry) -> Scenario:
    if spec.broken:
        raise PluginError(spec.broken)
    return registry.make("scenario", spec.kind, spec.options)


def _study(
    table: Table, text: str, folder: Path, extra: tuple[str | Path, ...], errors: ErrorCollector
) -> Study | None:
    manifest = _top_level(table, errors)
    registry = _registry([*(folder / file for file in manifest.plugins), *extra], errors)
    resolver = Resolver(registry, errors)
    sweep = Sweep(manifest, resolver)
    sweep.build(AT_FIRST)
    budget_limits(manifest, {}, "budget", errors)
    methods = study_methods(manifest, resolver, sweep.scenario)
    summary = _summary(manifest.summary, errors)
    if not errors.texts:  # a message about the other tables must not wait for thousands of points
        sweep.build()
    if errors.texts or sweep.scenario is None:
        return None
    try:
        return _planned(manifest, text, sweep, methods, summary, resolver)
    except OptionError as error:
        errors.add_all("", error)
        return None


def _planned(
    manifest: Manifest, text: str, sweep: Sweep, methods: list[Method], summary: Summary, resolver: Resolver
) -> Study:
    registry, scenario = resolver.registry, sweep.scenario
    assert scenario is not None
    study = Study(
        name=manifest.name,
        title=manifest.title,
        expect=manifest.expect,
        seed=manifest.seed,
        repetitions=manifest.repetitions,
        points=tuple(sweep.points),
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
    return replace(study, warnings=(*study.warnings, *plugin_warnings(sweep, methods, resolver)))


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
    """Load the plugins. Files that would block reading, such as pipes and devices, are reported and left out."""
    regular = []
    for file in map(Path, files):
        if problem := _not_regular(file):
            errors.add("plugins", f"plugin file {file!s:.200}: {problem}")
        else:
            regular.append(file)
    try:
        return Registry(regular)
    except PluginError as error:
        errors.add("plugins", str(error))
        return Registry()


def _not_regular(file: Path) -> str | None:
    """Return why a path cannot be a plugin file; None if it can, or if it does not exist."""
    try:
        mode = file.stat().st_mode
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"
    return None if stat.S_ISREG(mode) else "expected a regular file, got a folder, pipe or device"


def _summary(table: Table, errors: ErrorCollector) -> Summary:
    try:
        return build(Summary, table)
    except OptionError as error:
        errors.add_all("summary", error)
        return Summary()
