"""A study, which is the product of scenario points, methods, scenes and runs, and the generator of its runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from nfbench.core import NfbenchError, OptionError

from .records import Method, Point, RunSpec

__all__ = ["MAX_RUNS", "Study", "digest", "scene_seed", "seed_from"]

SEEDS = 2  # version of how seeds depend on a study: of 1, the scenes also depended on the swept values
MAX_RUNS = 10**9  # a plan of 300 GB; what is larger must be split into several studies


@dataclass(frozen=True)
class Study:
    """A validated manifest. Raises OptionError if it has more than 10^9 runs.

    name: name of the study and of its results folder.
    title: title shown in tables, reports and figures.
    expect: what the author expects the study to show.
    seed: seed from which the seeds of all instances and solvers are derived.
    scenes: number of scenes at each point. Scene number s is drawn with the same seed at every point.
    points: points of the sweep.
    methods: methods that the study compares.
    error: name of the score by which methods are ranked.
    outlier_m: position error above which the estimate of a source counts as an outlier [m].
    plugins: paths of the plugin files that the study needs.
    manifest: text of the manifest file.
    warnings: problems that do not prevent the study from running, such as plugin files that fail to import.
    runs_per_scene: number of runs of each stochastic method on each scene; the others run once.
    targets: (kind, value) of each target, in the order of the manifest; empty for the defaults.
    claims: tables of the claims that the study tests, as in the manifest.
    proven: labels of the formulations whose optimum in each scene is to be proven.
    folder: folder that relative paths in the manifest refer to.
    most_scenes: number of different scenes that the scenario has, and why; None if there is no limit.
    """

    name: str
    title: str
    expect: str
    seed: int
    scenes: int
    points: tuple[Point, ...]
    methods: tuple[Method, ...]
    error: str
    outlier_m: float
    plugins: tuple[str, ...] = ()
    manifest: str = field(default="", repr=False)
    warnings: tuple[str, ...] = ()
    runs_per_scene: int = 1
    targets: tuple[tuple[str, float], ...] = ()
    claims: tuple[dict[str, Any], ...] = ()
    proven: tuple[str, ...] = ()
    folder: Path = field(default=Path(), repr=False)
    most_scenes: tuple[int, str] | None = None

    def __post_init__(self) -> None:
        runs = self.scenes * self._runs_of_scene
        if runs > MAX_RUNS:
            text = f"{self.scenes:,} scenes × {len(self.points):,} points × {len(self.methods):,} methods"
            text += f" × {self.runs_per_scene:,} runs per scene" if self.runs_per_scene > 1 else ""
            problem = f"expected at most {MAX_RUNS:,} runs, got {text} = {runs:,}; split the study into several"
            raise OptionError(type(self).__name__, [("scenes", problem)])

    def __len__(self) -> int:
        return self.scenes * self._runs_of_scene

    def check_scenes(self, number: int) -> None:
        """Raise NfbenchError if the scenario does not have so many different scenes."""
        if self.most_scenes and number > self.most_scenes[0]:
            most, reason = self.most_scenes
            raise NfbenchError(f"expected at most {most:,} scenes together, {reason}, got {number:,}")

    @cached_property
    def swept(self) -> list[str]:
        """The swept keys, in the order of the manifest."""
        return list(self.points[0].swept)

    @cached_property
    def _repeated(self) -> list[int]:
        """Positions of the methods that run several times per scene."""
        return [i for i, method in enumerate(self.methods) if method.is_stochastic]

    @cached_property
    def _runs_of_scene(self) -> int:
        again = (self.runs_per_scene - 1) * len(self._repeated)
        return len(self.points) * (len(self.methods) + again)

    @cached_property
    def fingerprint(self) -> str:
        """A hash that is equal for two studies if they plan the same runs with the same labels."""
        points = [[point.scenario.label, point.scenario.version, key, point.swept] for point, key in self._points]
        methods = [
            [
                *(method.label, method.formulation.label, method.solver and method.solver.label),
                *(_method_digest(method), _versions(method), method.is_stochastic),
            ]
            for method in self.methods
        ]
        return digest([SEEDS, self.seed, self.scenes, self.runs_per_scene, points, methods])

    @cached_property
    def scenarios(self) -> str:
        """A hash that is equal for two studies if they draw the same scenes from the same seed."""
        return digest([[key, point.scenario.version] for point, key in self._points])

    def specs(self) -> Iterator[RunSpec]:
        """Yield every run. Scenes are the outermost loop, so an unfinished study treats all methods equally."""
        return map(self.spec, range(len(self)))

    def spec(self, ordinal: int) -> RunSpec:
        """Return the run at position ``ordinal`` of ``specs``."""
        scene, rest = divmod(ordinal, self._runs_of_scene)
        in_first_run = len(self.points) * len(self.methods)
        if rest < in_first_run:
            run, (place, number) = 0, divmod(rest, len(self.methods))
        else:  # only stochastic methods run again
            again, rest = divmod(rest - in_first_run, len(self.points) * len(self._repeated))
            place, number = divmod(rest, len(self._repeated))
            run, number = again + 1, self._repeated[number]
        (point, point_digest), (method, method_digest) = self._points[place], self._methods(place)[number]
        parts = (self.seed, point_digest, method_digest, scene, *([run] if run else []))
        return RunSpec(
            run_id=digest([SEEDS, *parts, [point.scenario.version, *_versions(method)]])[:20],
            study=self.name,
            point=point,
            method=method,
            repetition=scene * self.runs_per_scene + run,
            instance_seed=scene_seed(self.seed, scene),
            solver_seed=seed_from("solver", *parts),
            scene=scene,
        )

    @property
    def references(self) -> int:
        """Number of optima to prove: one per scene, point of the sweep without its budget, and formulation."""
        return self.scenes * len(self._proofs)

    def reference(self, ordinal: int) -> RunSpec:
        """Return what proves the optimum at position ``ordinal``; scenes are the outermost loop, as in ``spec``."""
        scene, number = divmod(ordinal, len(self._proofs))
        point, method = self._proofs[number]
        parts = (self.seed, _point_digest(point), _method_digest(method), scene)
        return RunSpec(
            run_id=digest([SEEDS, "reference", *parts, [point.scenario.version, *_versions(method)]])[:20],
            study=self.name,
            point=point,
            method=method,
            repetition=scene * self.runs_per_scene,
            instance_seed=scene_seed(self.seed, scene),
            solver_seed=0,
            asks="reference",
            scene=scene,
        )

    @cached_property
    def _proofs(self) -> list[tuple[Point, Method]]:
        """The points of the sweep without their budgets, each with every formulation whose optimum is to be proven."""
        swept = [{key: v for key, v in point.swept.items() if not key.startswith("budget.")} for point in self.points]
        pairs = zip(self.points, swept, strict=True)
        points = {_canonical(settings): Point(point.scenario, settings) for point, settings in pairs}
        methods = [_proof_of(label, self.methods) for label in self.proven]
        return [(point, method) for point in points.values() for method in methods]

    @cached_property
    def _points(self) -> list[tuple[Point, str]]:
        return [(point, _point_digest(point)) for point in self.points]

    def _methods(self, place: int) -> list[tuple[Method, str]]:
        """The methods at a point, with the budget that is swept there."""
        swept = self.points[place].budget
        key = json.dumps(swept, sort_keys=True) if swept else ""
        if key not in self._methods_by_budget:
            methods = [method.with_budget(swept) for method in self.methods]
            self._methods_by_budget[key] = [(method, _method_digest(method)) for method in methods]
        return self._methods_by_budget[key]

    @cached_property
    def _methods_by_budget(self) -> dict[str, list[tuple[Method, str]]]:
        return {}


_canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":")).encode


def digest(data: Any) -> str:
    """Return the hexadecimal SHA-256 of plain data in canonical JSON: sorted keys, shortest round-trip floats."""
    return hashlib.sha256(_canonical(data).encode()).hexdigest()


def seed_from(*parts: Any) -> int:
    """Return a 63-bit seed that depends on all parts and on nothing else."""
    return int(digest(list(parts))[:16], 16) >> 1


@lru_cache(maxsize=1024)
def scene_seed(seed: int, scene: int) -> int:
    return seed_from("scene", seed, scene)


def _point_digest(point: Point) -> str:
    identity = point.scenario.identity
    return digest([identity, point.budget]) if point.budget else digest(identity)


def _method_digest(method: Method) -> str:
    solver = method.solver.identity if method.solver else None
    limits = {key: value for key, value in (method.budget or {}).items() if value is not None}
    return digest([method.formulation.identity, solver, limits])


def _versions(method: Method) -> list[str]:
    return [choice.version for choice in (method.formulation, method.solver) if choice]


def _proof_of(label: str, methods: Sequence[Method]) -> Method:
    """Return the proof of a formulation's optimum as a method without a solver.

    Its limits are the largest of those of the methods that use the formulation, as it is as necessary as any of them.
    """
    using = [method for method in methods if method.solver and method.formulation.label == label]
    times, sizes = [method.run_timeout_s for method in using], [method.run_memory_mb for method in using]
    return Method(
        using[0].formulation,
        None,
        None,
        f"optimum of {label}",
        None if None in times else max(time for time in times if time is not None),
        None if None in sizes else max(size for size in sizes if size is not None),
        is_stochastic=False,
    )
