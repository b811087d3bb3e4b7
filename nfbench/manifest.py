"""Reads a manifest into a study, or says everything that is wrong with it at once."""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import StringConstraints

from .budget import Budget
from .choices import Chooser, Problems
from .errors import ManifestError, OptionError, PluginError
from .formulation import Formulation
from .options import Ge, Gt, Options, build, canonical, relative_to
from .registry import Registry
from .scenario import Scenario
from .study import Choice, Method, Point, Study, digest

__all__ = ["load_scenarios", "load_study"]

Table = dict[str, Any]


@dataclass(frozen=True)
class Manifest(Options):
    """The top level of a manifest; its tables are checked by what they describe."""

    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
    scenario: Table
    repetitions: Annotated[int, Ge(1)]
    seed: Annotated[int, Ge(0)]
    title: str = ""
    expect: str = ""
    plugins: tuple[str, ...] = ()
    sweep: Table = field(default_factory=dict)
    formulation: tuple[Table, ...] = ()
    solver: tuple[Table, ...] = ()
    method: tuple[Table, ...] = ()
    budget: Table = field(default_factory=dict)
    summary: Table = field(default_factory=dict)


@dataclass(frozen=True)
class Limits(Options):
    """``[budget]``: what a solver may spend on each problem handed to it, and what stops a run for good.

    run_timeout_s: a run that takes longer is killed [s]. run_memory_mb: what a run may allocate [MiB].
    """

    evaluations: Annotated[int, Ge(1)] | None = None
    seconds: Annotated[float, Gt(0.0)] | None = None
    target: float | None = None
    run_timeout_s: Annotated[float, Gt(0.0)] | None = None
    run_memory_mb: Annotated[int, Ge(1)] | None = None

    def validate(self) -> None:
        self.budget()

    def budget(self) -> Table | None:
        """The solver's budget as plain data; None where it has none."""
        if self.evaluations is self.seconds is self.target is None:
            return None
        return cast(Table, canonical(Budget(self.evaluations, self.seconds, self.target)))


@dataclass(frozen=True)
class Summary(Options):
    """``[summary]``: how rows are summed up; it changes no run.

    outlier_m: a source estimated further off than this counts as an outlier [m].
    """

    outlier_m: Annotated[float, Gt(0.0)] = 1.0


@dataclass(frozen=True)
class MethodTable(Options):
    """``[[method]]``: one formulation–solver pair with its own budget (default: ``[budget]``) and label."""

    formulation: str | Table
    solver: str | Table | None = None
    budget: Table = field(default_factory=dict)
    label: str | None = None


def load_study(path: str | Path, plugins: Iterable[str | Path] = ()) -> Study:
    """Read and validate a manifest; ``plugins`` are further plugin files.

    Raises ManifestError, which lists every problem as ``path: message``.
    """
    path = Path(path)
    table, text = _read(path)
    problems = Problems()
    with relative_to(path.parent):
        study = _study(table, text, path.parent, tuple(plugins), problems)
    if problems.texts or study is None:
        raise ManifestError(str(path), problems.texts)
    return study


def load_scenarios(path: str | Path, plugins: Iterable[str | Path] = ()) -> list[tuple[Table, Scenario]]:
    """The swept values of each point of a study, and the scenario there; what else the manifest says is not looked at.

    Of the plugin files that it names, those that are not there are left out: it may be a copy, far from them. Raises
    ManifestError where a scenario cannot be made.
    """
    path = Path(path)
    table, _ = _read(path)
    problems = Problems()
    with relative_to(path.parent):
        manifest = _top_level(table, problems)
        named = [path.parent / file for file in manifest.plugins]
        chooser = Chooser(_registry([*filter(Path.exists, named), *plugins], problems), problems)
        points, _ = _points(manifest, chooser, problems)
        if problems.texts:
            raise ManifestError(str(path), problems.texts)
        return [(p.swept, _scenario(p.scenario, chooser.registry)) for p in points]


def _scenario(choice: Choice, registry: Registry) -> Scenario:
    if choice.broken:
        raise PluginError(choice.broken)
    return cast(Scenario, registry.make("scenario", choice.kind, choice.options))


def _read(path: Path) -> tuple[Table, str]:
    """A manifest's tables, and its text."""
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text), text
    except (OSError, UnicodeDecodeError) as error:
        raise ManifestError(str(path), [f"cannot be read: {getattr(error, 'strerror', None) or error}"]) from error
    except tomllib.TOMLDecodeError as error:
        raise ManifestError(str(path), [f"is not valid TOML: {error}"]) from error


def _study(table: Table, text: str, folder: Path, extra: tuple[str | Path, ...], problems: Problems) -> Study | None:
    manifest = _top_level(table, problems)
    registry = _registry([*(folder / file for file in manifest.plugins), *extra], problems)
    chooser = Chooser(registry, problems)
    points, scenario = _points(manifest, chooser, problems)
    _table(Limits, manifest.budget, "budget", problems)
    methods = _methods(manifest, chooser, scenario, problems)
    summary = cast(Summary, _table(Summary, manifest.summary, "summary", problems))
    if problems.texts or scenario is None:
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
            *(f"plugin {file.name} is left out: {why}" for file, why in registry.broken.items()),
            *chooser.warnings,
        ),
    )


def _top_level(table: Table, problems: Problems) -> Manifest:
    """The manifest's keys; what is wrong is noted and stood in for, so that the rest can be checked too."""
    for key in ("formulation", "solver", "method"):
        if isinstance(table.get(key), dict):
            problems.add(key, f"expected a list of tables, got one table; write [[{key}]] for [{key}]")
            table = {**table, key: [table[key]]}
    try:
        return build(Manifest, table)
    except OptionError as error:
        problems.of("", error)
        wrong = {path.split(".")[0].split("[")[0] for path, _ in error.problems}
        stand_ins: Table = {"name": "x", "scenario": {}, "repetitions": 1, "seed": 0}
        known = {f.name for f in fields(Manifest)}
        return build(Manifest, {**stand_ins, **{k: v for k, v in table.items() if k in known - wrong}})


def _registry(files: Iterable[str | Path], problems: Problems) -> Registry:
    try:
        return Registry(files)
    except PluginError as error:
        problems.add("plugins", str(error))
        return Registry()


def _table(cls: type[Options], table: Mapping[str, Any], path: str, problems: Problems) -> Options:
    try:
        return build(cls, table)
    except OptionError as error:
        problems.of(path, error)
        return cls()


# --- scenario points ---------------------------------------------------------------------------------------------


def _points(manifest: Manifest, chooser: Chooser, problems: Problems) -> tuple[list[Point], Scenario | None]:
    """Every combination of the swept values, and one of the scenarios to check formulations against."""
    swept = _swept(manifest.sweep, problems)
    if not manifest.scenario:
        if not any(text.startswith("scenario") for text in problems.texts):
            problems.add("scenario.kind", f"is required; known: {', '.join(chooser.registry.names('scenario'))}")
        return [], None
    points: list[Point] = []
    scenario: Scenario | None = None
    seen: dict[str, str] = {}
    for indexed in itertools.product(*(list(enumerate(values)) for values in swept.values())):
        setting = {key: value for key, (_, value) in zip(swept, indexed, strict=True)}
        at = {f"scenario.{key}": f"sweep.{key}[{i}]" for key, (i, _) in zip(swept, indexed, strict=True)}
        here = Problems()
        made = chooser.choose("scenario", _with(manifest.scenario, setting), "scenario", here)
        for text in here.texts:
            problems.note(_renamed(text, at))
        if made is None:
            continue
        choice, scenario = made[0], cast(Scenario | None, made[1])
        where = ", ".join(at.values())
        first = seen.setdefault(digest(choice.identity), where)
        if first != where:
            problems.add(where, f"the same scenario as at {first}")
        points.append(Point(choice, {key: _at(choice.options, key, setting[key]) for key in swept}))
    if scenario is None and not problems.texts:
        problems.add("scenario", points[0].scenario.broken or "cannot be made")
    return points, scenario


def _renamed(text: str, paths: Mapping[str, str]) -> str:
    """A problem's line with a swept key's path in the scenario told as its place in the sweep."""
    for path, place in paths.items():
        if text.startswith(path) and text[len(path)] in ":.[":
            return place + text[len(path) :]
    return text


def _swept(sweep: Table, problems: Problems, prefix: str = "") -> dict[str, list[Any]]:
    """``[sweep]`` with nested tables flattened to dotted keys."""
    swept: dict[str, list[Any]] = {}
    for key, values in sweep.items():
        path = f"{prefix}{key}"
        if isinstance(values, dict):
            swept |= _swept(values, problems, f"{path}.")
        elif isinstance(values, list) and values:
            swept[path] = values
        else:
            problems.add(f"sweep.{path}", f"expected a list of one or more values, got {values!r}")
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
    """The canonical value of a dotted key, or the one given where it does not stay (a file that was read)."""
    value: Any = options
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return given if value is None else value


# --- methods -----------------------------------------------------------------------------------------------------


def _methods(manifest: Manifest, chooser: Chooser, scenario: Scenario | None, problems: Problems) -> list[Method]:
    formulations = [
        (f"formulation[{i}]", chooser.choose("formulation", _without(table, "budget"), f"formulation[{i}]"))
        for i, table in enumerate(manifest.formulation)
    ]
    own_limits = [
        _limits(manifest, table.get("budget", {}), f"formulation[{i}].budget", problems)
        for i, table in enumerate(manifest.formulation)
    ]
    solvers = [
        (f"solver[{i}]", chooser.choose("solver", table, f"solver[{i}]"))
        for i, table in enumerate(manifest.solver)
        if "group" not in table
    ]
    _no_twins(formulations, problems)
    _no_twins(solvers, problems)
    named = {digest(solver[0].identity) for _, solver in solvers if solver}
    for i, table in enumerate(manifest.solver):
        if "group" in table:  # less what is named itself, or is in a group before
            for member in chooser.group(table, f"solver[{i}]"):
                if (identity := digest(member[0].identity)) not in named:
                    named.add(identity)
                    solvers.append((f"solver[{i}]", member))
    pairs: list[_Pair] = []
    for (path, formulation), limits in zip(formulations, own_limits, strict=True):
        if formulation is None:
            continue
        if _needs_solver(formulation):
            if not manifest.solver:
                problems.add(path, f"{formulation[0].kind} needs a solver; add a [[solver]]")
            pairs += [_Pair(path, formulation, solver, limits) for _, solver in solvers if solver]
        else:
            pairs.append(_Pair(path, formulation, None, limits))
    for i, table in enumerate(manifest.method):
        pairs += _own_pairs(f"method[{i}]", table, manifest, chooser, problems)
    if not manifest.formulation and not manifest.method:
        problems.add("formulation", "expected at least one [[formulation]] or [[method]], got none")
    elif manifest.solver and not manifest.formulation:
        problems.add("solver", "a [[solver]] is combined with each [[formulation]], and there is none")
    for pair in pairs:
        pair.check(scenario, problems)
    return _labelled(pairs, chooser, problems)


@dataclass
class _Pair:
    """A method before its labels are known."""

    path: str
    formulation: tuple[Choice, Options | None]
    solver: tuple[Choice, Options | None] | None
    limits: Limits
    label: str | None = None

    def check(self, scenario: Scenario | None, problems: Problems) -> None:
        made = cast(Formulation | None, self.formulation[1])
        if scenario and made and not issubclass(scenario.instance, made.accepts):
            text = f"{self.formulation[0].kind} solves {made.accepts.__name__}, but the scenario draws "
            problems.add(f"{self.path}.kind", f"{text}{scenario.instance.__name__}")
        told = any("budget" in text.partition(":")[0] for text in problems.texts)
        if self.solver and self.limits.budget() is None and not told:
            problems.add("budget", "is required: give evaluations or seconds")


def _own_pairs(path: str, table: Table, manifest: Manifest, chooser: Chooser, problems: Problems) -> list[_Pair]:
    """A ``[[method]]`` entry; its formulation and solver are names or tables. One pair, or one for each of a group."""
    try:
        method = build(MethodTable, table)
    except OptionError as error:
        problems.of(path, error)
        return []
    limits = _limits(manifest, method.budget, f"{path}.budget", problems)
    formulation = chooser.choose("formulation", _named(method.formulation), f"{path}.formulation")
    solvers: list[tuple[Choice, Options | None] | None] = [None]
    if isinstance(method.solver, dict) and "group" in method.solver:
        solvers = [*chooser.group(method.solver, f"{path}.solver")]
        if method.label:
            problems.add(f"{path}.label", f"expected none, as its solver is a group, got {method.label!r}")
    elif method.solver:
        solvers = [chooser.choose("solver", _named(method.solver), f"{path}.solver")]
    if formulation is None or (method.solver and None in solvers):
        return []
    if _needs_solver(formulation) != bool(method.solver):
        needs = "needs a solver, got none" if not method.solver else "needs no solver, got one"
        problems.add(f"{path}.solver", f"{formulation[0].kind} {needs}")
    return [_Pair(path, formulation, solver, limits, method.label) for solver in solvers]


def _limits(manifest: Manifest, own: Any, path: str, problems: Problems) -> Limits:
    """``[budget]``, with what a ``[[formulation]]`` or ``[[method]]`` sets for itself."""
    if not isinstance(own, dict):
        problems.add(path, f"expected a table, got {own!r}")
        own = {}
    return cast(Limits, _table(Limits, {**manifest.budget, **own}, path if own else "budget", problems))


def _without(table: Table, key: str) -> Table:
    return {name: value for name, value in table.items() if name != key}


def _named(entry: str | Table) -> Table:
    return {"kind": entry} if isinstance(entry, str) else entry


def _needs_solver(made: tuple[Choice, Options | None]) -> bool:
    formulation = cast(Formulation | None, made[1])
    return formulation is None or formulation.needs_solver


def _no_twins(made: list[tuple[str, tuple[Choice, Options | None] | None]], problems: Problems) -> None:
    seen: dict[str, str] = {}
    for path, choice in made:
        if choice:
            first = seen.setdefault(digest(choice[0].identity), path)
            if first != path:
                problems.add(path, f"is the same as {first}")


def _labelled(pairs: list[_Pair], chooser: Chooser, problems: Problems) -> list[Method]:
    """Methods with labels that tell each from the others."""
    methods: list[Method] = []
    seen: dict[str, str] = {}
    labels: dict[str, str] = {}
    for pair in pairs:
        formulation = chooser.labelled("formulation", pair.formulation[0])
        solver = chooser.labelled("solver", pair.solver[0]) if pair.solver else None
        budget = pair.limits.budget() if solver else None
        first = seen.setdefault(digest([formulation.identity, solver and solver.identity, budget]), pair.path)
        if first != pair.path:
            problems.add(pair.path, f"is the same formulation, solver and budget as {first}")
            continue
        label = pair.label or (f"{formulation.label} + {solver.label}" if solver else formulation.label)
        if label in labels and not pair.label and budget:
            label += f" @{budget['evaluations'] or str(budget['seconds']) + 's'}"
        if labels.setdefault(label, pair.path) != pair.path:
            problems.add(f"{pair.path}.label", f"{label!r} is taken by {labels[label]}; give each method its own label")
        limits = pair.limits
        methods.append(Method(formulation, solver, budget, label, limits.run_timeout_s, limits.run_memory_mb))
    return methods
