"""A study, which is the product of scenario points, methods and repetitions, and the generator of its runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from nfbench.core import OptionError

from .records import Method, Point, RunSpec

__all__ = ["MAX_RUNS", "Study", "digest", "seed_from"]

MAX_RUNS = 10**9  # a plan of 300 GB; what is larger must be split into several studies


@dataclass(frozen=True)
class Study:
    """A validated manifest. Raises OptionError if it has more than 10^9 runs.

    name: name of the study and of its results folder.
    title: title shown in tables, reports and figures.
    expect: what the author expects the study to show.
    seed: seed from which the seeds of all instances and solvers are derived.
    repetitions: number of repetitions of each method at each point.
    points: points of the sweep.
    methods: methods that the study compares.
    error: name of the score by which methods are ranked.
    outlier_m: position error above which the estimate of a source counts as an outlier [m].
    plugins: paths of the plugin files that the study needs.
    manifest: text of the manifest file.
    warnings: problems that do not prevent the study from running, such as plugin files that fail to import.
    """

    name: str
    title: str
    expect: str
    seed: int
    repetitions: int
    points: tuple[Point, ...]
    methods: tuple[Method, ...]
    error: str
    outlier_m: float
    plugins: tuple[str, ...] = ()
    manifest: str = field(default="", repr=False)
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        points, methods = len(self.points), len(self.methods)
        runs = self.repetitions * points * methods
        if runs > MAX_RUNS:
            text = f"{self.repetitions:,} repetitions × {points:,} points × {methods:,} methods = {runs:,}"
            problem = f"expected at most {MAX_RUNS:,} runs, got {text}; split the study into several"
            raise OptionError(type(self).__name__, [("repetitions", problem)])

    def __len__(self) -> int:
        return self.repetitions * len(self.points) * len(self.methods)

    @cached_property
    def swept(self) -> list[str]:
        """The swept keys, in the order of the manifest."""
        return list(self.points[0].swept)

    @cached_property
    def fingerprint(self) -> str:
        """A hash that is equal for two studies if they plan the same runs with the same labels."""
        points = [[point.scenario.label, point.scenario.version, key, point.swept] for point, key in self._points]
        methods = [
            [method.label, method.formulation.label, method.solver and method.solver.label, key, _versions(method)]
            for method, key in self._methods
        ]
        return digest([self.seed, self.repetitions, points, methods])

    def specs(self) -> Iterator[RunSpec]:
        """Yield every run. Repetitions are the outermost loop, so an unfinished study treats all methods equally."""
        return map(self.spec, range(len(self)))

    def spec(self, ordinal: int) -> RunSpec:
        """Return the run at position ``ordinal`` of ``specs``."""
        repetition, rest = divmod(ordinal, len(self.points) * len(self.methods))
        point, point_digest = self._points[rest // len(self.methods)]
        method, method_digest = self._methods[rest % len(self.methods)]
        parts = (self.seed, point_digest, method_digest, repetition)
        return RunSpec(
            run_id=digest([*parts, [point.scenario.version, *_versions(method)]])[:20],
            study=self.name,
            point=point,
            method=method,
            repetition=repetition,
            instance_seed=seed_from("instance", self.seed, point_digest, repetition),
            solver_seed=seed_from("solver", *parts),
        )

    @cached_property
    def _points(self) -> list[tuple[Point, str]]:
        return [(point, digest(point.scenario.identity)) for point in self.points]

    @cached_property
    def _methods(self) -> list[tuple[Method, str]]:
        return [(method, _method_digest(method)) for method in self.methods]


def digest(data: Any) -> str:
    """Return the hexadecimal SHA-256 of plain data in canonical JSON: sorted keys, shortest round-trip floats."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def seed_from(*parts: Any) -> int:
    """Return a 63-bit seed that depends on all parts and on nothing else."""
    return int(digest(list(parts))[:16], 16) >> 1


def _method_digest(method: Method) -> str:
    solver = method.solver.identity if method.solver else None
    return digest([method.formulation.identity, solver, method.budget])


def _versions(method: Method) -> list[str]:
    return [choice.version for choice in (method.formulation, method.solver) if choice]
