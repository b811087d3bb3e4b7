"""The methods of a study: all combinations of formulations and solvers, and the pairs listed as ``[[method]]``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from nfbench.core import (
    Budget,
    Formulation,
    OptionError,
    Scenario,
    Solver,
    budget_problem,
    budget_warning,
    build,
    start_problem,
)

from .labels import label_problem
from .plan import digest
from .records import Method
from .resolve import ErrorCollector, Resolved, Resolver
from .schema import Limits, Manifest, MethodTable, Table

__all__ = ["study_methods"]

MAX_METHODS = 10_000


def study_methods(manifest: Manifest, resolver: Resolver, scenario: Scenario | None) -> list[Method]:
    """Return every ``[[formulation]]`` with every ``[[solver]]``, then every ``[[method]]``, with distinct labels."""
    errors = resolver.errors
    pairs = _product(manifest, resolver)
    for i, table in enumerate(manifest.method):
        pairs += _named_pairs(f"method[{i}]", table, manifest, resolver)
    if not manifest.formulation and not manifest.method and not errors.has("formulation", "method"):
        errors.add("formulation", "expected at least one [[formulation]] or [[method]], got none")
    elif manifest.solver and not manifest.formulation and not errors.has("formulation"):
        errors.add("solver", "expected at least one [[formulation]] to combine each [[solver]] with, got none")
    needs_budget = not any("budget" in text.partition(":")[0] for text in errors.texts)
    for pair in pairs:
        pair.check(scenario, errors, needs_budget)
    if not errors.texts:
        resolver.warnings += dict.fromkeys(filter(None, (pair.warning() for pair in pairs)))
    return _labelled(pairs, resolver)


@dataclass
class _Pair:
    """A method whose label is not known yet."""

    path: str
    formulation: Resolved[Formulation]
    solver: Resolved[Solver] | None
    limits: Limits
    label: str | None = None

    def check(self, scenario: Scenario | None, errors: ErrorCollector, needs_budget: bool) -> None:
        """Record an error if the formulation does not accept the scenario's instances or a solver has no budget."""
        formulation = self.formulation.made
        if scenario and formulation and not issubclass(scenario.instance, formulation.accepts):
            text = f"{self.formulation.spec.kind} solves {formulation.accepts.__name__}, but the scenario draws "
            errors.add(f"{self.path}.kind", f"{text}{scenario.instance.__name__}")
        if self.solver and needs_budget and self.limits.budget() is None:
            errors.add("budget", "is required: give evaluations or seconds")
        if self.solver and self.solver.made and needs_budget:
            for problem in self._unfit(self.solver.made):
                errors.add(f"{self.path}.budget", f"{self.solver.spec.label}: {problem}")

    def _unfit(self, solver: Solver) -> Iterator[str]:
        """Yield why the solver cannot run with the budget."""
        limits = self.limits
        if limits.evaluations is limits.seconds is None:
            return
        if problem := budget_problem(solver, Budget(limits.evaluations, limits.seconds, limits.target)):
            yield problem
        if limits.start is not None and (problem := start_problem(solver)):
            yield f"{problem}: leave it out, or start = {limits.start}"

    def warning(self) -> str | None:
        """A sentence if the solver plans for a number of evaluations that the budget does not give."""
        limits, made = self.limits, self.solver.made if self.solver else None
        if made is None or limits.seconds is None:
            return None
        return budget_warning(made, Budget(limits.evaluations, limits.seconds, limits.target))


def _product(manifest: Manifest, resolver: Resolver) -> list[_Pair]:
    """Combine each ``[[formulation]]`` with each ``[[solver]]``; formulations that need no solver stay alone."""
    errors = resolver.errors
    formulations = [
        (f"formulation[{i}]", resolver.resolve("formulation", _without(table, "budget"), f"formulation[{i}]"))
        for i, table in enumerate(manifest.formulation)
    ]
    limits = [
        budget_limits(manifest, table.get("budget", {}), f"formulation[{i}].budget", errors)
        for i, table in enumerate(manifest.formulation)
    ]
    _refuse_duplicates(formulations, errors)
    solvers = _solvers(manifest, resolver)
    count = len(manifest.formulation) * len(solvers)
    if count > MAX_METHODS:
        text = f"{len(manifest.formulation):,} [[formulation]] × {len(solvers):,} solvers = {count:,} methods"
        errors.add("formulation", f"expected at most {MAX_METHODS:,} methods, got {text}")
        return []
    pairs: list[_Pair] = []
    for (path, formulation), own_limits in zip(formulations, limits, strict=True):
        if formulation is None:
            continue
        if _needs_solver(formulation):
            if not manifest.solver and not errors.has("solver"):
                errors.add(path, f"{formulation.spec.kind} needs a solver; add a [[solver]]")
            pairs += [_Pair(path, formulation, solver, own_limits) for solver in solvers]
        else:
            pairs.append(_Pair(path, formulation, None, own_limits))
    return pairs


def _solvers(manifest: Manifest, resolver: Resolver) -> list[Resolved[Solver]]:
    """Return the solvers given by kind, then those of the groups, without duplicates."""
    named = [
        (f"solver[{i}]", resolver.resolve("solver", table, f"solver[{i}]"))
        for i, table in enumerate(manifest.solver)
        if "group" not in table
    ]
    _refuse_duplicates(named, resolver.errors)
    solvers = [solver for _, solver in named if solver]
    known = {solver.identity for solver in solvers}
    for i, table in enumerate(manifest.solver):
        for member in resolver.resolve_group(table, f"solver[{i}]") if "group" in table else []:
            if member.identity not in known:
                known.add(member.identity)
                solvers.append(member)
    return solvers


def _named_pairs(path: str, table: Table, manifest: Manifest, resolver: Resolver) -> list[_Pair]:
    """Resolve a ``[[method]]`` entry to one pair, or to one pair for each solver if its solver is a group."""
    errors = resolver.errors
    try:
        method = build(MethodTable, table)
    except OptionError as error:
        errors.add_all(path, error)
        return []
    if method.label is not None and (problem := label_problem(method.label)):
        errors.add(f"{path}.label", problem)
    limits = budget_limits(manifest, method.budget, f"{path}.budget", errors)
    formulation = resolver.resolve("formulation", _as_table(method.formulation), f"{path}.formulation")
    solvers: list[Resolved[Solver] | None] = [None]
    if isinstance(method.solver, dict) and "group" in method.solver:
        solvers = [*resolver.resolve_group(method.solver, f"{path}.solver")]
        if method.label:
            errors.add(f"{path}.label", f"expected no label, as the solver is a group, got {method.label!r}")
    elif method.solver:
        solvers = [resolver.resolve("solver", _as_table(method.solver), f"{path}.solver")]
    if formulation is None or (method.solver and None in solvers):
        return []
    if _needs_solver(formulation) != bool(method.solver):
        needs = "needs a solver, but got none" if not method.solver else "needs no solver, but got one"
        errors.add(f"{path}.solver", f"{formulation.spec.kind} {needs}")
    return [_Pair(path, formulation, solver, limits, method.label) for solver in solvers]


def budget_limits(manifest: Manifest, own: Any, path: str, errors: ErrorCollector) -> Limits:
    """Return the limits of ``[budget]``, updated with those of one ``[[formulation]]`` or ``[[method]]``."""
    if not isinstance(own, dict):
        errors.add(path, f"expected a table, got {own!r}")
        own = {}
    try:
        return build(Limits, {**manifest.budget, **own})
    except OptionError as error:
        errors.add_all(path if own else "budget", error)
        return Limits()


def _without(table: Table, key: str) -> Table:
    return {name: value for name, value in table.items() if name != key}


def _as_table(entry: str | Table) -> Mapping[str, Any]:
    return {"kind": entry} if isinstance(entry, str) else entry


def _needs_solver(formulation: Resolved[Formulation]) -> bool:
    return formulation.made is None or formulation.made.needs_solver


def _refuse_duplicates(
    entries: Iterable[tuple[str, Resolved[Formulation] | Resolved[Solver] | None]], errors: ErrorCollector
) -> None:
    seen: dict[str, str] = {}
    for path, resolved in entries:
        if resolved:
            first = seen.setdefault(resolved.identity, path)
            if first != path:
                errors.add(path, f"is the same as {first}")


def _plain_label(pair: _Pair, resolver: Resolver) -> str:
    """Return the label of a method without its budget."""
    if pair.label:
        return pair.label
    parts = [resolver.labelled("formulation", pair.formulation.spec).label]
    if pair.solver:
        parts.append(resolver.labelled("solver", pair.solver.spec).label)
    return " + ".join(parts)


def _paths_with_budget(pairs: list[_Pair], labels: list[str]) -> set[str]:
    """Return the paths of methods whose labels name the budget: those with a label that an earlier path has.

    All labels of a group name it then, also those of solvers that run with this budget only.
    """
    owners: dict[str, str] = {}
    named = [(pair, owners.setdefault(label, pair.path)) for pair, label in zip(pairs, labels, strict=True)]
    return {pair.path for pair, owner in named if owner != pair.path and not pair.label}


def _labelled(pairs: list[_Pair], resolver: Resolver) -> list[Method]:
    """Return the methods with distinct labels."""
    errors = resolver.errors
    methods: list[Method] = []
    seen: dict[str, str] = {}
    labels: dict[str, str] = {}
    plain = [_plain_label(pair, resolver) for pair in pairs]
    with_budget = _paths_with_budget(pairs, plain)
    for pair, label in zip(pairs, plain, strict=True):
        formulation = resolver.labelled("formulation", pair.formulation.spec)
        solver = resolver.labelled("solver", pair.solver.spec) if pair.solver else None
        budget = pair.limits.budget() if solver else None
        first = seen.setdefault(digest([formulation.identity, solver and solver.identity, budget]), pair.path)
        if first != pair.path:
            errors.add(pair.path, f"is the same formulation, solver and budget as {first}")
            continue
        if budget and not pair.label and (label in labels or pair.path in with_budget):
            label += f" @{budget['evaluations'] or str(budget['seconds']) + 's'}"
        if labels.setdefault(label, pair.path) != pair.path:
            errors.add(
                f"{pair.path}.label", f"{label!r} is also the label of {labels[label]}; give each method its own"
            )
        limits = pair.limits
        made = pair.solver.made if pair.solver else None
        is_stochastic = made.info.stochastic if made else pair.solver is not None
        timeout_s, memory_mb = limits.run_timeout_s, limits.run_memory_mb
        methods.append(Method(formulation, solver, budget, label, timeout_s, memory_mb, is_stochastic))
    return methods
