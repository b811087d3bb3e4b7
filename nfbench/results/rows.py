"""Runs as rows of the tables, and rows as runs."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from typing import Any

from nfbench.core import Trace
from nfbench.study import RunRecord, RunSpec

from .values import packed

__all__ = ["TracedRun", "plan_row", "proof_row", "reference_row", "result_row"]


@dataclass(frozen=True)
class TracedRun:
    """A finished run with one trace for each problem that it minimized; no traces if it minimized none.

    damage: what is wrong with the traces in the file, which are left out then; empty if nothing is.
    """

    run_id: str
    formulation: str
    solver: str
    method: str
    repetition: int
    status: str
    swept: dict[str, Any]
    traces: tuple[Trace, ...]
    damage: str = ""


def plan_row(ordinal: int, spec: RunSpec) -> tuple[Any, ...]:
    """The row of ``plan`` of a run at this position."""
    method = spec.method
    return (
        ordinal, spec.run_id, spec.point.scenario.label, method.formulation.label,
        method.solver.label if method.solver else "", method.label, spec.repetition, json.dumps(spec.point.swept),
        spec.instance_seed, spec.solver_seed,
    )  # fmt: skip


def result_row(record: RunRecord) -> tuple[Any, ...]:
    """The row of ``results`` of a run that is finished now."""
    scores = {name: repr(score) for name, score in record.scores.items()}  # as text, because JSON has no inf
    return (
        record.run_id, str(record.status), record.message, record.objective, record.evaluations, record.runtime_s,
        record.cpu_s, json.dumps(scores), json.dumps(record.estimate), packed(record.traces), record.host,
        record.worker, time.time(),
    )  # fmt: skip


def proof_row(ordinal: int, scene: int, spec: RunSpec) -> tuple[Any, ...]:
    """The row of ``reference_plan`` of a proof at this position."""
    return (
        ordinal, spec.run_id, spec.point.scenario.label, spec.method.formulation.label, scene,
        json.dumps(spec.point.swept), spec.instance_seed,
    )  # fmt: skip


def reference_row(record: RunRecord) -> tuple[Any, ...]:
    """The row of ``reference_optima`` of a proof that is finished now; one that failed proves nothing."""
    columns = {name: repr(value) for name, value in record.scores.items() if name not in ("gap", "certified", "step")}
    gap, certified = record.scores.get("gap", math.inf), int(record.scores.get("certified", 0.0))
    return (
        record.run_id, str(record.status), record.message, record.objective, gap, certified,
        int(record.scores.get("step", 0.0)), json.dumps(columns), json.dumps(record.estimate), record.runtime_s,
        record.cpu_s, record.host, record.worker, time.time(),
    )  # fmt: skip
