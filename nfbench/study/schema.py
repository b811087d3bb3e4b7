"""The tables of a manifest as options: every key with its type, limits and default."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

from pydantic import StringConstraints

from nfbench.core import Budget, Ge, Gt, Le, Lt, OptionError, Options, TargetOption, canonical

from .labels import label_problem

__all__ = ["Limits", "Manifest", "MethodTable", "Proofs", "Summary", "Table", "Targets"]

Table: TypeAlias = dict[str, Any]
_Positive: TypeAlias = Annotated[float, Gt(0.0), Lt(math.inf)]

LONGEST_S = 1e9  # run_timeout_s beyond this means no limit
LARGEST_MB = 2**30  # so does run_memory_mb beyond this [MiB], a pebibyte
MAX_TABLES = 1000  # of [[formulation]], of [[solver]] and of [[method]]


@dataclass(frozen=True)
class Manifest(Options):
    """The top level of a manifest. The classes that the tables describe check the contents of the tables.

    name: name of the study and of its results folder: letters, digits, hyphens and underscores, at most 64 characters.
    It must not be what a spreadsheet or pandas takes for a number, a date or a missing value.
    scenario: ``[scenario]`` table: the ``kind`` of a scenario and its options.
    scenes: number of scenes at each point of the sweep; scene number s has the same seed at every point. The old name
    ``repetitions`` is accepted.
    seed: seed from which the seeds of all instances and solvers are derived.
    title: title shown in tables, reports and figures; empty for none.
    expect: what the author expects the study to show; it is printed with the results; empty for nothing.
    plugins: plugin files, relative to the manifest's folder.
    sweep: ``[sweep]`` table: lists of values for options of the scenario, by dotted key; every combination is run.
    formulation: ``[[formulation]]`` tables: the ``kind`` of a formulation, its options, and optionally a ``budget``.
    solver: ``[[solver]]`` tables: the ``kind`` or the ``group`` of solvers, and their options. Each solver is combined
    with each formulation that needs one.
    method: ``[[method]]`` tables, which name further pairs of a formulation and a solver.
    budget: ``[budget]`` table: the limits for solvers and runs.
    summary: ``[summary]`` table: settings of the summary tables.
    runs_per_scene: number of runs of each stochastic method on each scene, at most 10^6; the other methods run once.
    targets: ``[targets]`` table: lists of the errors and gaps at which a run counts as solved; the first value is the
    one by which methods are judged. Empty for targets that fit the scenario.
    reference: ``[reference]`` table: whether the optima from which gaps are measured are proven.
    claim: ``[[claim]]`` tables: statements that the results are to confirm or contradict.
    labels: ``[labels]`` table: labels of the axes of figures, by the swept key or by ``rmse``, ``median`` or
    ``runtime``.
    """

    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
    scenario: Table
    scenes: Annotated[int, Ge(1)]
    seed: Annotated[int, Ge(0), Lt(2**63)]
    title: str = ""
    expect: str = ""
    plugins: tuple[str, ...] = ()
    sweep: Table = field(default_factory=dict)
    formulation: tuple[Table, ...] = ()
    solver: tuple[Table, ...] = ()
    method: tuple[Table, ...] = ()
    budget: Table = field(default_factory=dict)
    summary: Table = field(default_factory=dict)
    runs_per_scene: Annotated[int, Ge(1), Le(10**6)] = 1
    targets: Table = field(default_factory=dict)
    reference: Table = field(default_factory=dict)
    claim: tuple[Table, ...] = ()
    labels: dict[str, str] = field(default_factory=dict)

    def validate(self) -> None:
        tables = {"formulation": self.formulation, "solver": self.solver, "method": self.method, "claim": self.claim}
        problems = [
            (key, f"expected at most {MAX_TABLES:,} [[{key}]] tables, got {len(entries):,}")
            for key, entries in tables.items()
            if len(entries) > MAX_TABLES
        ]
        if problem := label_problem(self.name):
            problems.append(("name", problem))
        if problems:
            raise OptionError(type(self).__name__, problems)


@dataclass(frozen=True)
class Limits(Options):
    """``[budget]``: the limits on what a solver may spend on each problem, and the limits on a whole run.

    evaluations: maximum number of evaluations of the objective per problem; None for no limit.
    seconds: maximum wall-clock time per problem [s]; None for no limit.
    target: objective value, in the problem's unit, at or below which the solver is stopped, or a table with one of
    ``gap``, ``error`` and ``error_in_bounds``; None for no target.
    start: number of points, at most 10^6, of a sample of each problem that is the same for all solvers, evaluated first
    and given to the solver as its start; None: each solver starts as it does.
    run_timeout_s: time after which a run is killed [s]; None, or more than 10^9, for no limit.
    run_memory_mb: memory that a run may allocate [MiB]; None, or more than 2^30, for no limit.
    """

    evaluations: Annotated[int, Ge(1), Le(10**15)] | None = None
    seconds: Annotated[float, Gt(0.0), Le(1e9)] | None = None
    target: TargetOption = None
    start: Annotated[int, Ge(1), Le(10**6)] | None = None
    run_timeout_s: Annotated[float, Gt(0.0)] | None = None
    run_memory_mb: Annotated[int, Ge(1)] | None = None

    def validate(self) -> None:
        if self.run_timeout_s is not None and self.run_timeout_s > LONGEST_S:
            object.__setattr__(self, "run_timeout_s", None)
        if self.run_memory_mb is not None and self.run_memory_mb > LARGEST_MB:
            object.__setattr__(self, "run_memory_mb", None)
        self.budget()

    def budget(self) -> Table | None:
        """Return the solver's budget as plain data; None if no limit and no target is set."""
        if self.evaluations is self.seconds is self.target is None:
            return None
        table: Table = canonical(Budget(self.evaluations, self.seconds, self.target))
        if isinstance(target := table["target"], dict):
            table["target"] = {kind: value for kind, value in target.items() if value is not None}
        return table if self.start is None else {**table, "start": self.start}


@dataclass(frozen=True)
class Summary(Options):
    """``[summary]``: settings of the summary tables. They do not affect the runs.

    outlier_m: position error above which the estimate of a source counts as an outlier [m].
    """

    outlier_m: Annotated[float, Gt(0.0), Lt(math.inf)] = 1.0


@dataclass(frozen=True)
class Targets(Options):
    """``[targets]``: what counts as solved, most important first. The first of all values is the one by which methods
    are judged.

    error_in_bounds: errors in multiples of the Cramér–Rao bound of the scene.
    error: errors in the unit of the scenario's error measure.
    gap: differences between the best objective value and the reference optimum of the same problem.
    """

    error_in_bounds: tuple[_Positive, ...] = ()
    error: tuple[_Positive, ...] = ()
    gap: tuple[_Positive, ...] = ()


@dataclass(frozen=True)
class Proofs(Options):
    """``[reference]``: the optimum from which the gaps of a problem are measured. It does not affect the runs.

    certificate: whether the optimum of the first problem of each formulation is proven, once per scene and swept value
    of the scenario, by formulations that have a proof.
    """

    certificate: bool = False


@dataclass(frozen=True)
class MethodTable(Options):
    """``[[method]]``: one pair of a formulation and a solver, with its own budget and label.

    formulation: kind of the formulation, or a table with its kind and options.
    solver: kind of the solver, or a table with its kind or group and options; None if the formulation needs none.
    budget: limits that replace those of ``[budget]`` for this method; limits not given here are taken from there.
    label: name shown in tables; None for a label made from the formulation and the solver.
    """

    formulation: str | Table
    solver: str | Table | None = None
    budget: Table = field(default_factory=dict)
    label: str | None = None
