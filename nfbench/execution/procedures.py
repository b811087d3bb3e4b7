"""The method with which sources are localized: by name with options, or as a study recommends it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nfbench.analysis import sentence
from nfbench.core import Budget, Formulation, NfbenchError, Scenario, Solver, budget_problem, canonical
from nfbench.plugins import Registry
from nfbench.results import Results
from nfbench.study import load_methods, load_scenarios

__all__ = ["Procedure", "procedure", "recommended"]

EVALUATIONS = 20_000  # of a solver whose budget is not given


@dataclass(frozen=True)
class Procedure:
    """A formulation and, where it needs one, a solver with its budget.

    start: number of points of a common start for the solver; None: the solver starts by itself.
    label: name of the method in a study; empty if it is not from a study.
    name: names under which formulation and solver are registered, such as "neef + de"; empty if they are not known.
    study: folder of the study that recommends it; empty if there is none.
    swept: swept values over which the study recommends it; "all" for all values.
    scenarios: scenarios of the study.
    """

    formulation: Formulation
    solver: Solver | None = None
    budget: Budget | None = None
    start: int | None = None
    label: str = ""
    name: str = ""
    study: str = ""
    swept: Mapping[str, Any] = field(default_factory=dict)
    scenarios: tuple[Scenario, ...] = ()

    def described(self, seed: int) -> dict[str, Any]:
        """Return formulation, solver, their options, budget and seed as plain data, and the study if there is one."""
        name, _, solver = (part.strip() for part in self.name.partition("+"))
        table: dict[str, Any] = {
            "formulation": name or type(self.formulation).__name__,
            "options": _options(self.formulation),
        }
        if self.solver is not None and self.budget is not None:
            table |= {"solver": solver or type(self.solver).__name__, "solver_options": _options(self.solver)}
            limits = {"evaluations": self.budget.evaluations, "seconds": self.budget.seconds, "start": self.start}
            table["budget"] = {name: value for name, value in limits.items() if value is not None}
        table["seed"] = seed
        if self.study:
            table |= {"study": self.study, "label": self.label, "swept": dict(self.swept)}
        return table

    def unlike(self, scenario: Scenario) -> list[str]:
        """Return a warning if the study that recommends the method has measured something else than a scenario."""
        found: list[list[str]] = sorted((scenario.differences(each) for each in self.scenarios), key=len)
        if not found or not found[0]:
            return []
        text = f"the study {self.study} may not hold for this recording: {', and '.join(found[0])}"
        return [f"{text}; simulate this array at this wavelength, or choose the method (--method)"]


def procedure(
    method: str,
    options: Mapping[str, Any] | None = None,
    solver_options: Mapping[str, Any] | None = None,
    *,
    evaluations: int | None = None,
    seconds: float | None = None,
    plugins: Iterable[str | Path] = (),
) -> Procedure:
    """Return the method with a name such as "grid-refine" or "neef + de", and its options and budget.

    Raises NfbenchError if the formulation and the solver do not fit together.
    """
    name, plus, solver_name = (part.strip() for part in method.partition("+"))
    registry = Registry(plugins)
    formulation = registry.make("formulation", name, dict(options or {}))
    if not formulation.needs_solver:
        if plus or solver_options or evaluations is not None or seconds is not None:
            text = f"{name} needs no solver, so it takes no solver, options of a solver, evaluations or seconds"
            raise NfbenchError(f"method: {text}, got {method!r}")
        return Procedure(formulation, name=name)
    if not solver_name:
        raise NfbenchError(f'method: {name} needs a solver, got none; for example, "{name} + de"')
    solver = registry.make("solver", solver_name, dict(solver_options or {}))
    if evaluations is None and seconds is None:
        evaluations = EVALUATIONS
    budget = Budget(evaluations=evaluations, seconds=seconds)
    if problem := budget_problem(solver, budget):
        raise NfbenchError(f"method: {problem}")
    return Procedure(formulation, solver, budget, name=f"{name} + {solver_name}")


def recommended(folder: str | Path, plugins: Iterable[str | Path] = ()) -> Procedure:
    """Return the method that a study recommends over all its swept points, as the report names it.

    Raises StoreError or NfbenchError if the folder holds no study, or if the study recommends no method.
    """
    results = Results(Path(folder))
    blocks = results.evidence().ranking.blocks
    best = [block.methods[block.order[0]] for block in blocks[-1:] if block.order]
    if blocks and not best and len(blocks[-1].methods) == 1:
        best = list(blocks[-1].methods)
    if not best:
        reason = f": {sentence(blocks[-1])} Run" if blocks else "; run"
        raise NfbenchError(f"{folder}: the study recommends no method yet{reason} more scenes, or give the method")
    methods = {method.label: method for method in load_methods(results.folder / "manifest.toml", plugins)}
    if (chosen := methods.get(best[0])) is None:
        raise NfbenchError(f"{folder}: the study recommends {best[0]}, which is not in its manifest.toml")
    registry = Registry(plugins)
    if broken := chosen.formulation.broken or (chosen.solver.broken if chosen.solver else None):
        raise NfbenchError(f"{folder}: the study recommends {best[0]}, which is not available: {broken}")
    formulation = registry.make("formulation", chosen.formulation.kind, chosen.formulation.options)
    manifest = results.folder / "manifest.toml"
    about: dict[str, Any] = {"label": best[0], "study": str(folder), "swept": blocks[-1].swept}
    about["scenarios"] = _scenarios(manifest, plugins)
    if chosen.solver is None:
        return Procedure(formulation, name=chosen.formulation.kind, **about)
    solver = registry.make("solver", chosen.solver.kind, chosen.solver.options)
    limits = {name: value for name, value in (chosen.budget or {}).items() if name in ("evaluations", "seconds")}
    about |= {"start": (chosen.budget or {}).get("start"), "name": f"{chosen.formulation.kind} + {chosen.solver.kind}"}
    return Procedure(formulation, solver, Budget(**limits), **about)


def _scenarios(manifest: Path, plugins: Iterable[str | Path]) -> tuple[Scenario, ...]:
    """Return the scenarios of a study; none if they cannot be read, as where their files are missing."""
    try:
        return tuple(scenario for _, scenario in load_scenarios(manifest, plugins))
    except NfbenchError:
        return ()


def _options(made: Formulation | Solver) -> dict[str, Any]:
    """Return the options that differ from their defaults."""
    table: dict[str, Any] = canonical(made, defaults=False)
    return {name: value for name, value in table.items() if name != "kind"}
