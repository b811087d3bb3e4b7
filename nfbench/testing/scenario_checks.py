"""The checks of a scenario, of its instances, and of the problems that formulations make of them."""

from __future__ import annotations

import dataclasses
import inspect
import json
import pickle
import random
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy import ndarray

from nfbench.core import (
    Formulation,
    Incompatible,
    Instance,
    Minimum,
    PluginError,
    Problem,
    Scenario,
    Solver,
    SolverInfo,
    build,
    canonical,
    explain,
    minimize,
)
from nfbench.plugins import Registry

from .checks import CheckResult
from .problem_checks import POINTS, PROBLEM_CHECKS, all_passed, outcome, sample_points
from .subject import Failed, need

__all__ = ["check_scenario", "scenario_check_names", "scenario_checks", "solved_by"]


@dataclasses.dataclass(frozen=True)
class _Sampler(Solver):
    """Some random points: enough for a formulation to go on with."""

    info = SolverInfo(batched=True, converges=False)

    def minimize(self, problem: Any, rng: np.random.Generator) -> None:
        problem.evaluate(problem.from_unit(rng.random((POINTS, problem.dimension))))


@dataclasses.dataclass(frozen=True)
class _Scene:
    """The scenario under test and the formulations that solve it."""

    scenario: Scenario
    formulations: tuple[Formulation, ...]

    def draw(self, seed: int = 1) -> Instance:
        return self.scenario.draw(np.random.default_rng(seed))

    def solve(self, formulation: Formulation, instance: Instance) -> tuple[ndarray, list[Problem]]:
        """The formulation's estimate with a solver that only samples, and the problems it had solved."""
        problems: list[Problem] = []

        def sample(problem: Problem) -> Minimum:
            problems.append(problem)
            return minimize(problem, _Sampler(), POINTS, len(problems))

        return np.asarray(formulation.solve(instance, sample)), problems

    def problems(self, seed: int = 1) -> list[Problem]:
        """Every problem that the formulations make of one instance."""
        instance, found = self.draw(seed), []
        for formulation in self.formulations:
            try:
                found += self.solve(formulation, instance)[1]
            except Incompatible:
                continue
        return found


def scenario_checks(
    scenario: Scenario, formulations: Iterable[Formulation] = (), only: Iterable[str] | None = None
) -> Iterator[CheckResult]:
    """Run the checks (those named in ``only``, or all) on a scenario and on the problems that formulations make of it.

    The global random states of NumPy and Python are left as they were found.
    """
    scene = _Scene(scenario, tuple(formulations))
    scenario.warm_up()
    for name in scenario_check_names() if only is None else only:
        check = _SCENARIO.get(name) or _each_problem(PROBLEM_CHECKS[name])
        yield outcome(name, check, scene)


def check_scenario(scenario: Scenario, formulations: Iterable[Formulation]) -> None:
    """Raise AssertionError, listing every failed check, unless scenario and problems pass them all."""
    all_passed(type(scenario).__name__, scenario_checks(scenario, formulations))


def scenario_check_names() -> list[str]:
    """The names of all checks of a scenario, in the order they run."""
    return [*_SCENARIO, *PROBLEM_CHECKS]


def solved_by(registry: Registry, scenario: Scenario) -> list[Formulation]:
    """The registered formulations, with default options, that accept what the scenario draws."""
    found = []
    for name in registry.names("formulation"):
        try:
            made = registry.make("formulation", name, {})
        except (PluginError, ValueError):  # fails to import, or has an option without default
            continue
        if isinstance(made, Formulation) and issubclass(scenario.instance, made.accepts):
            found.append(made)
    return found


def _described(scene: _Scene) -> None:
    cls = type(scene.scenario)
    doc = cls.__dict__.get("__doc__") or ""
    missing = [f.name for f in dataclasses.fields(cls) if f.init and not re.search(rf"\b{f.name}\b", doc)]
    need(
        doc and not doc.startswith(f"{cls.__name__}(") and not missing,
        "a docstring that explains every option",
        f"nothing on {', '.join(missing)}" if missing else "no docstring",
        "Name each option in the class docstring with its meaning and unit.",
    )
    need(
        inspect.isclass(getattr(cls, "instance", None)) and issubclass(cls.instance, Instance),
        f"{cls.__name__}.instance to be the class that draw returns",
        repr(getattr(cls, "instance", None)),
        "Add `instance: ClassVar[type[Instance]] = ...` to the class.",
    )


def _options(scene: _Scene) -> None:
    plain = canonical(scene.scenario)
    mend = "Let every option be a number, a text, a truth value, a list or a table of these."
    try:
        text = json.dumps(plain)
    except (TypeError, ValueError) as error:
        raise Failed(f"expected options that can be written as JSON, got {explain(error)}. {mend}") from error
    options = {key: value for key, value in json.loads(text).items() if key != "kind"}
    again = build(type(scene.scenario), options)
    need(again == scene.scenario, f"the same scenario from its options {text}", repr(again), mend)
    need(
        pickle.loads(pickle.dumps(scene.scenario)) == scene.scenario,
        "the same scenario after pickling",
        "another",
        mend,
    )


def _draw(scene: _Scene) -> None:
    instance = scene.draw()
    need(
        isinstance(instance, scene.scenario.instance),
        f"draw to return a {scene.scenario.instance.__name__}, as `instance` says",
        f"a {type(instance).__name__}",
        "Let `instance` name the class that draw returns.",
    )


def _formulations(scene: _Scene) -> str:
    solvable = [type(formulation).__name__ for formulation in scene.formulations]
    need(
        solvable,
        f"a formulation that accepts a {scene.scenario.instance.__name__}",
        "none",
        "Derive the instance from nfbench.ProblemInstance, which `direct` solves, or write a Formulation for it.",
    )
    return f"solved by {', '.join(solvable)}"


def _same_seed(scene: _Scene) -> None:
    seen = []
    for disturbance in (1, 2):  # what the global generators hold must not matter
        random.seed(disturbance)
        np.random.seed(disturbance)  # noqa: NPY002
        seen.append(_fingerprint(scene, 1))
    need(
        all(np.array_equal(a, b, equal_nan=True) for a, b in zip(*seen, strict=True)),
        "the same problems from the same seed",
        "values that differ",
        "Draw from the generator handed to draw alone, and from no state of the class or the module.",
    )


def _other_seed(scene: _Scene) -> str:
    first, second = _fingerprint(scene, 1), _fingerprint(scene, 2)
    same = len(first) == len(second) and all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True)
    )
    return "another seed draws the same instance: all repetitions will be alike" if first and same else ""


def _global_random_untouched(scene: _Scene) -> None:
    random.seed(12)
    np.random.seed(12)  # noqa: NPY002
    before = pickle.dumps((random.getstate(), np.random.get_state()))  # noqa: NPY002
    scene.draw()
    need(
        before == pickle.dumps((random.getstate(), np.random.get_state())),  # noqa: NPY002
        "the global random state to be left alone",
        "another state after draw",
        "Draw from the generator handed to draw: rng.normal() in place of np.random.normal().",
    )


def _score(scene: _Scene) -> str:
    instance, error = scene.draw(), scene.scenario.error
    scored = []
    for formulation in scene.formulations:
        try:
            estimate, _ = scene.solve(formulation, instance)
        except Incompatible:
            continue
        scores = instance.score(estimate)
        name = type(formulation).__name__
        need(
            isinstance(scores, dict) and error in scores,
            f"score to return a dict with {error!r}, by which methods are ranked",
            repr(scores),
            "Add it to the dict, or let the scenario's `error` name the score that is there.",
        )
        need(
            all(isinstance(key, str) and np.ndim(value) == 0 for key, value in scores.items()),
            "scores that are single numbers by column name",
            repr(scores),
            "Convert each with float().",
        )
        need(
            not estimate.size or float(scores[error]) >= 0.0,
            f"{error} of the estimate of {name} to be a number of at least 0",
            repr(scores[error]),
            "Let it be an error: 0 at the truth, larger the farther off.",
        )
        scored.append(name)
    try:
        instance.score(np.zeros((3, 1, 4, 1, 5)))
    except ValueError:
        return f"of the estimates of {', '.join(scored)}" if scored else ""
    raise Failed(
        "expected a ValueError for an estimate of a wrong shape, got scores. Raise ValueError with the shape expected "
        "and the shape that came."
    )


def _truth(scene: _Scene) -> str:
    instance, error = scene.draw(), scene.scenario.error
    truth = instance.truth()
    if truth is None:
        return "the instance tells no truth(): nothing checked"
    scored = float(instance.score(np.asarray(truth))[error])
    need(
        abs(scored) <= 1e-9,
        f"{error} of the truth to be 0",
        repr(scored),
        "Let score and truth use the same units and order.",
    )
    return ""


_SCENARIO: dict[str, Callable[[Any], str | None]] = {
    "described": _described,
    "options": _options,
    "draw": _draw,
    "formulations": _formulations,
    "same-seed": _same_seed,
    "other-seed": _other_seed,
    "global-random-untouched": _global_random_untouched,
    "score": _score,
    "truth": _truth,
}


def _each_problem(check: Callable[[Problem], str | None]) -> Callable[[_Scene], str]:
    def run(scene: _Scene) -> str:
        notes = []
        for problem in scene.problems():
            try:
                notes.append(check(problem) or "")
            except Failed as failure:
                raise Failed(f"{type(problem).__name__}: {failure}") from failure
        return "; ".join(dict.fromkeys(filter(None, notes)))

    return run


def _fingerprint(scene: _Scene, seed: int) -> list[ndarray]:
    """The values of every problem at the same points."""
    return [np.asarray(problem.evaluate(sample_points(problem))) for problem in scene.problems(seed)]
