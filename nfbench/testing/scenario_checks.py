"""The checks of a scenario, of its instances, and of the problems that formulations build from them."""

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
    Solution,
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
    """Evaluates a few random points, which is enough for a formulation to continue."""

    info = SolverInfo(batched=True, converges=False)

    def minimize(self, problem: Any, rng: np.random.Generator) -> None:
        problem.evaluate(problem.from_unit(rng.random((POINTS, problem.dimension))))


@dataclasses.dataclass(frozen=True)
class _Scene:
    """The scenario under test and the formulations that can solve it."""

    scenario: Scenario
    formulations: tuple[Formulation, ...]

    def draw(self, seed: int = 1) -> Instance:
        return self.scenario.draw(np.random.default_rng(seed))

    def solve(self, formulation: Formulation, instance: Instance) -> tuple[ndarray, list[Problem]]:
        """Return the formulation's estimate with a solver that only samples, and the problems that it minimized."""
        problems: list[Problem] = []

        def sample(problem: Problem) -> Minimum:
            problems.append(problem)
            return minimize(problem, _Sampler(), POINTS, len(problems))

        found = formulation.solve(instance, sample)
        return np.asarray(found.estimate if isinstance(found, Solution) else found), problems

    def problems(self, seed: int = 1) -> list[Problem]:
        """Return every problem that the formulations build from one instance."""
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
    """Run the checks named in ``only`` (default: all) on a scenario and on the problems that its formulations build.

    Each result is yielded as soon as it is available. The global random states of NumPy and Python are restored after
    each check.
    """
    scene = _Scene(scenario, tuple(formulations))
    names = scenario_check_names() if only is None else list(only)
    try:
        scenario.warm_up()
    except Exception as error:
        yield from (CheckResult(name, False, f"expected warm_up to succeed, got {explain(error)}.") for name in names)
        return
    for name in names:
        check = _SCENARIO.get(name) or _each_problem(PROBLEM_CHECKS[name])
        yield outcome(name, check, scene)


def check_scenario(scenario: Scenario, formulations: Iterable[Formulation]) -> None:
    """Raise AssertionError with a list of the failed checks unless the scenario and its problems pass every check."""
    all_passed(type(scenario).__name__, scenario_checks(scenario, formulations))


def scenario_check_names() -> list[str]:
    """Return the names of all checks of a scenario, in the order in which they run."""
    return [*_SCENARIO, *PROBLEM_CHECKS]


def solved_by(registry: Registry, scenario: Scenario) -> list[Formulation]:
    """Return the registered formulations, with default options, that accept the instances of the scenario."""
    found = []
    for name in registry.names("formulation"):
        try:
            made = registry.make("formulation", name, {})
        except (PluginError, ValueError):  # it cannot be imported, or has an option without a default
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
        f"no entry for {', '.join(missing)}" if missing else "no docstring",
        "Describe each option in the class docstring as `name: meaning and unit`.",
    )
    _declared_instance(scene)


def _options(scene: _Scene) -> None:
    plain = canonical(scene.scenario)
    remedy = "Use only numbers, strings, booleans, and lists and tables of these as options."
    try:
        text = json.dumps(plain)
    except (TypeError, ValueError) as error:
        raise Failed(f"expected options that can be written as JSON, got {explain(error)}. {remedy}") from error
    options = {key: value for key, value in json.loads(text).items() if key != "kind"}
    rebuilt = build(type(scene.scenario), options)
    need(rebuilt == scene.scenario, f"the same scenario when built from its options {text}", repr(rebuilt), remedy)
    need(
        pickle.loads(pickle.dumps(scene.scenario)) == scene.scenario,
        "the same scenario after pickling and unpickling",
        "a different one",
        remedy,
    )


def _declared_instance(scene: _Scene) -> type[Instance]:
    """Return the class of the instances; fail if the scenario does not declare it."""
    cls = getattr(type(scene.scenario), "instance", None)
    need(
        inspect.isclass(cls) and issubclass(cls, Instance),
        f"{type(scene.scenario).__name__}.instance to be the class that draw returns",
        repr(cls),
        "Add `instance: ClassVar[type[Instance]] = ...` to the class.",
    )
    assert cls is not None
    return cls


def _draw(scene: _Scene) -> None:
    declared, instance = _declared_instance(scene), scene.draw()
    need(
        isinstance(instance, declared),
        f"draw to return a {declared.__name__}, as declared by `instance`",
        f"a {type(instance).__name__}",
        "Set `instance` to the class that draw returns.",
    )


def _formulations(scene: _Scene) -> str:
    names = [type(formulation).__name__ for formulation in scene.formulations]
    need(
        names,
        f"a formulation that accepts a {_declared_instance(scene).__name__}",
        "none",
        "Derive the instance from nfbench.ProblemInstance, which the formulation `direct` solves, or write a "
        "Formulation for it.",
    )
    return f"solved by {', '.join(names)}"


def _same_seed(scene: _Scene) -> None:
    fingerprints = []
    for global_seed in (1, 2):  # the state of the global generators must not matter
        random.seed(global_seed)
        np.random.seed(global_seed)  # noqa: NPY002
        fingerprints.append(_fingerprint(scene, 1))
    need(
        all(np.array_equal(a, b, equal_nan=True) for a, b in zip(*fingerprints, strict=True)),
        "the same problems from the same seed",
        "values that differ",
        "Draw random numbers only from the generator passed to draw, and use no state of the class or the module.",
    )


def _other_seed(scene: _Scene) -> str:
    first, second = _fingerprint(scene, 1), _fingerprint(scene, 2)
    identical = len(first) == len(second) and all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True)
    )
    return "a different seed draws the same instance, so all scenes will be identical" if first and identical else ""


def _global_random_untouched(scene: _Scene) -> None:
    random.seed(12)
    np.random.seed(12)  # noqa: NPY002
    before = pickle.dumps((random.getstate(), np.random.get_state()))  # noqa: NPY002
    scene.draw()
    need(
        before == pickle.dumps((random.getstate(), np.random.get_state())),  # noqa: NPY002
        "the global random state to be unchanged",
        "a different state after draw",
        "Draw random numbers from the generator passed to draw: rng.normal() instead of np.random.normal().",
    )


def _score(scene: _Scene) -> str:
    instance, error = scene.draw(), scene.scenario.ranked_by()
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
            f"score to return a dict that contains {error!r}, by which methods are ranked",
            repr(scores),
            "Add this score to the dict, or set the scenario's `error` to the name of an existing score.",
        )
        need(
            all(isinstance(key, str) and np.ndim(value) == 0 for key, value in scores.items()),
            "every score to be a single number under its column name",
            repr(scores),
            "Convert each score with float().",
        )
        need(
            not estimate.size or float(scores[error]) >= 0.0,
            f"{error} of the estimate of {name} to be a number >= 0",
            repr(scores[error]),
            "Return an error that is 0 at the truth and grows with the distance from it.",
        )
        scored.append(name)
    try:
        instance.score(np.zeros((3, 1, 4, 1, 5)))
    except ValueError:
        return f"checked with the estimates of {', '.join(scored)}" if scored else ""
    raise Failed(
        "expected score to raise ValueError for an estimate of the wrong shape, got scores. Raise ValueError with the "
        "expected shape and the actual shape."
    )


def _truth(scene: _Scene) -> str:
    instance, error = scene.draw(), scene.scenario.ranked_by()
    truth = instance.truth()
    if truth is None:
        return "not checked: the instance has no known truth"
    score = float(instance.score(np.asarray(truth))[error])
    need(
        abs(score) <= 1e-9,
        f"{error} of the truth to be 0",
        repr(score),
        "Use the same units and the same order in score and truth.",
    )
    _truth_alone(scene, error)
    return ""


def _truth_alone(scene: _Scene, error: str) -> None:
    """Check that what is drawn to score traces scores as the scene does, if the scenario draws it in its own way."""
    if type(scene.scenario).draw_truth is Scenario.draw_truth:
        return
    whole, alone = (
        draw(np.random.default_rng(1), 0) for draw in (scene.scenario.draw_scene, scene.scenario.draw_truth)
    )
    truth = np.asarray(whole.truth())
    expected, found = (each.errors(error, np.stack([truth, 0.9 * truth])) for each in (whole, alone))
    need(
        np.array_equal(found, expected, equal_nan=True),
        f"draw_truth to give the same {error} as draw_scene",
        f"{found} instead of {expected}",
        "Draw the true positions first, from the same generator in both.",
    )


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
    """Return the values of every problem at fixed points."""
    return [np.asarray(problem.evaluate(sample_points(problem))) for problem in scene.problems(seed)]
