"""Reads a manifest into a study, or reports all of its errors at once."""

from __future__ import annotations

import stat
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from nfbench.core import ManifestError, OptionError, Options, PluginError, Scenario, build, relative_to
from nfbench.plugins import Registry

from .axis_labels import label_problems
from .claims import claim_of, claim_problems
from .methods import budget_limits, study_methods
from .plan import Study, scene_seed
from .plausibility import plugin_warnings
from .proofs import provable
from .reading import folder_of
from .reading import read_manifest as _read
from .records import Method, PluginSpec, swept_column
from .resolve import ErrorCollector, Resolver
from .schema import Manifest, Proofs, Summary, Table, Targets
from .sweep import AT_FIRST, Sweep, limits_given_twice, sweep_points, with_first_limits

__all__ = ["load_methods", "load_scenarios", "load_study", "scene_numbers"]

T = TypeVar("T", bound=Options)


def load_study(path: str | Path, plugins: Iterable[str | Path] = ()) -> Study:
    """Read and validate a manifest; ``plugins`` are plugin files in addition to those that it names.

    Raises ManifestError, which lists every error as ``path: message``.
    """
    path = Path(path)
    table, text = _read(path)
    errors = ErrorCollector()
    with relative_to(folder_of(path)):
        study = _study(table, text, folder_of(path), tuple(plugins), errors)
    if errors.texts or study is None:
        raise ManifestError(str(path), errors.texts)
    return replace(study, folder=folder_of(path))


def load_scenarios(path: str | Path, plugins: Iterable[str | Path] = ()) -> list[tuple[dict[str, Any], Scenario]]:
    """Return the swept values and the scenario of each point of a study; the rest of the manifest is ignored.

    Reading a study must not execute code that comes with it: the plugin files that the manifest names are not imported,
    only ``plugins``, which the user gives. Raises ManifestError if a scenario is invalid or needs a plugin file that is
    not given, and PluginError if its plugin cannot be imported.
    """
    path = Path(path)
    table, _ = _read(path)
    errors = ErrorCollector()
    with relative_to(folder_of(path)):
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


def load_methods(path: str | Path, plugins: Iterable[str | Path] = ()) -> list[Method]:
    """Return the methods of a study, with the limits of the first point of its sweep.

    As in ``load_scenarios``, the plugin files that the manifest names are not imported. Raises ManifestError if the
    manifest is invalid or needs a plugin file that is not given.
    """
    path = Path(path)
    table, _ = _read(path)
    errors = ErrorCollector()
    with relative_to(folder_of(path)):
        manifest = _top_level(table, errors)
        resolver = Resolver(_registry(plugins, errors), errors)
        methods = study_methods(with_first_limits(manifest), resolver, None)
    if errors.texts:
        hint = f"pass the plugin files that it names with --plugin: {', '.join(manifest.plugins)}"
        raise ManifestError(str(path), [*errors.texts, *([hint] * bool(manifest.plugins))])
    return methods


def scene_numbers(path: str | Path) -> dict[int, int]:
    """Return the numbers of the scenes of a study by their seeds. Raises ManifestError if it cannot be read."""
    table, _ = _read(Path(path))
    manifest = _top_level(table, ErrorCollector())
    return {scene_seed(manifest.seed, number): number for number in range(manifest.scenes)}


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
    limits_given_twice(manifest, errors)
    first = with_first_limits(manifest)
    budget_limits(first, {}, "budget", errors)
    methods = study_methods(first, resolver, sweep.scenario)
    summary = _table(Summary, manifest.summary, "summary", errors)
    _table(Targets, manifest.targets, "targets", errors)
    proofs = _table(Proofs, manifest.reference, "reference", errors)
    for key, text in label_problems(manifest.labels, manifest.sweep):
        errors.add(f"labels.{key}", text)
    for i, table in enumerate(manifest.claim):
        try:
            claim_of(table)
        except OptionError as error:
            errors.add_all(f"claim[{i}]", error)
    if not errors.texts:  # a message about the other tables must not wait for thousands of points
        sweep.build()
    if errors.texts or sweep.scenario is None:
        return None
    try:
        return _planned(manifest, text, sweep, methods, summary, proofs, resolver)
    except OptionError as error:
        _add_named(error, table, errors)
        return None


def _planned(
    manifest: Manifest,
    text: str,
    sweep: Sweep,
    methods: list[Method],
    summary: Summary,
    proofs: Proofs,
    resolver: Resolver,
) -> Study:
    registry, scenario = resolver.registry, sweep.scenario
    assert scenario is not None
    proven, without_proof = provable(methods, resolver) if proofs.certificate else ((), ())
    study = Study(
        name=manifest.name,
        title=manifest.title,
        expect=manifest.expect,
        seed=manifest.seed,
        scenes=manifest.scenes,
        points=tuple(sweep.points),
        methods=tuple(methods),
        error=scenario.ranked_by(),
        outlier_m=summary.outlier_m,
        plugins=tuple(str(file) for file in registry.files),
        manifest=text,
        warnings=(
            *(f"plugin {file.name} is left out: {reason}" for file, reason in registry.broken.items()),
            *resolver.warnings,
            *(f"{label} has no proof of its optimum, so its gaps are not certified" for label in without_proof),
        ),
        runs_per_scene=manifest.runs_per_scene,
        targets=_targets(manifest, methods),
        claims=manifest.claim,
        proven=proven,
        most_scenes=sweep.most_scenes,
    )
    _check_claims(study, resolver.errors)
    return replace(study, warnings=(*study.warnings, *plugin_warnings(sweep, methods, resolver)))


def _targets(manifest: Manifest, methods: list[Method]) -> tuple[tuple[str, float], ...]:
    """The targets in the order of the manifest; else the one at which all runs stop, if it is of such a kind."""
    listed = tuple((kind, float(value)) for kind, values in manifest.targets.items() for value in values)
    stops = [(method.budget or {}).get("target") for method in methods if method.solver]
    if not listed and stops and isinstance(stops[0], dict) and all(stop == stops[0] for stop in stops):
        return tuple((kind, float(value)) for kind, value in stops[0].items())
    return listed


def _check_claims(study: Study, errors: ErrorCollector) -> None:
    """Record what the claims name that the study does not have."""
    labels, swept = [method.label for method in study.methods], list(map(swept_column, study.swept))
    for i, table in enumerate(study.claims):
        for path, text in claim_problems(claim_of(table), labels, swept):
            errors.add(f"claim[{i}].{path}", text)


def _top_level(table: Table, errors: ErrorCollector) -> Manifest:
    """Read the top-level keys. Invalid ones are reported and replaced by stand-ins, so that the rest is checked too."""
    given = table
    if "repetitions" in table:
        if "scenes" in table:
            errors.add("repetitions", "is the old name of scenes; give only one of the two")
        table = {"scenes": table["repetitions"], **{key: value for key, value in table.items() if key != "repetitions"}}
    for key in ("formulation", "solver", "method", "claim"):
        if isinstance(table.get(key), dict):
            errors.add(key, f"expected a list of tables, got one table; write [[{key}]] instead of [{key}]")
            table = {**table, key: [table[key]]}
    try:
        return build(Manifest, table)
    except OptionError as error:
        _add_named(error, given, errors)
        invalid = {path.split(".")[0].split("[")[0] for path, _ in error.problems}
        stand_ins: Table = {"name": "x", "scenario": {}, "scenes": 1, "seed": 0}
        known = {f.name for f in fields(Manifest)}
        return build(Manifest, {**stand_ins, **{k: v for k, v in table.items() if k in known - invalid}})


def _add_named(error: OptionError, given: Table, errors: ErrorCollector) -> None:
    """Record the errors, with the old name of a key where the manifest uses it."""
    for path, text in error.problems:
        errors.add("repetitions" if path == "scenes" and "repetitions" in given else path, text)


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


def _table(cls: type[T], table: Table, path: str, errors: ErrorCollector) -> T:
    try:
        return build(cls, table)
    except OptionError as error:
        errors.add_all(path, error)
        return cls()
