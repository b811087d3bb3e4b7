"""The tables of a manifest as options: every key with its type, its limits and its default."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

from pydantic import StringConstraints

from nfbench.core import Budget, Ge, Gt, Options, canonical

__all__ = ["Limits", "Manifest", "MethodTable", "Summary", "Table"]

Table: TypeAlias = dict[str, Any]


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
        table: Table = canonical(Budget(self.evaluations, self.seconds, self.target))
        return table


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
