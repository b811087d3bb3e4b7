"""A study: scenario points × methods × repetitions, and the pure generator of its runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from .records import Method, Point, RunSpec

__all__ = ["Study", "digest", "seed_from"]


@dataclass(frozen=True)
class Study:
    """A validated manifest. ``manifest`` is its text as read; ``plugins`` the plugin files it needs."""

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

    def __len__(self) -> int:
        return self.repetitions * len(self.points) * len(self.methods)

    @cached_property
    def swept(self) -> list[str]:
        """The swept keys, in the manifest's order."""
        return list(self.points[0].swept)

    @cached_property
    def fingerprint(self) -> str:
        """Tells whether two studies plan the same runs under the same labels."""
        points = [[point.scenario.label, point.scenario.version, where, point.swept] for point, where in self._points]
        methods = [
            [method.label, method.formulation.label, method.solver and method.solver.label, how, _versions(method)]
            for method, how in self._methods
        ]
        return digest([self.seed, self.repetitions, points, methods])

    def specs(self) -> Iterator[RunSpec]:
        """Every run, repetitions outermost, so that an unfinished study has compared all methods alike."""
        return map(self.spec, range(len(self)))

    def spec(self, ordinal: int) -> RunSpec:
        """The run at this place in the order of ``specs``."""
        repetition, rest = divmod(ordinal, len(self.points) * len(self.methods))
        (point, where), (method, how) = self._points[rest // len(self.methods)], self._methods[rest % len(self.methods)]
        parts = (self.seed, where, how, repetition)
        return RunSpec(
            run_id=digest([*parts, [point.scenario.version, *_versions(method)]])[:20],
            study=self.name,
            point=point,
            method=method,
            repetition=repetition,
            instance_seed=seed_from("instance", self.seed, where, repetition),
            solver_seed=seed_from("solver", *parts),
        )

    @cached_property
    def _points(self) -> list[tuple[Point, str]]:
        return [(point, digest(point.scenario.identity)) for point in self.points]

    @cached_property
    def _methods(self) -> list[tuple[Method, str]]:
        return [(method, _method_digest(method)) for method in self.methods]


def digest(data: Any) -> str:
    """SHA-256 of plain data in canonical JSON (sorted keys, shortest round-trip floats), in hexadecimal."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def seed_from(*parts: Any) -> int:
    """A seed of 63 bits that depends on every part and on nothing else."""
    return int(digest(list(parts))[:16], 16) >> 1


def _method_digest(method: Method) -> str:
    solver = method.solver.identity if method.solver else None
    return digest([method.formulation.identity, solver, method.budget])


def _versions(method: Method) -> list[str]:
    return [choice.version for choice in (method.formulation, method.solver) if choice]
