"""The checks of problems and scenarios: what each must do, and how to mend it where it does not."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import pickle
import random
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ..errors import Incompatible, PluginError
from ..formulation import Formulation
from ..minimize import Minimum, explain, minimize
from ..options import build, canonical
from ..problem import Problem
from ..registry import Registry
from ..scenario import Instance, Scenario
from ..solver import Solver, SolverInfo
from .checks import CheckResult
from .subject import Failed, need

__all__ = ["check_problem", "check_scenario", "problem_checks", "scenario_check_names", "scenario_checks", "solved_by"]

POINTS = 64
SAME = 1e-9  # relative: what a batch may round otherwise than a point
SLOPE = 1e-4  # relative: of a gradient, against central differences


@dataclasses.dataclass(frozen=True)
class _Sampler(Solver):
    """Some random points: enough for a formulation to go on with."""

    info = SolverInfo(batched=True, converges=False)

    def minimize(self, problem: Any, rng: np.random.Generator) -> None:
        problem.evaluate(problem.from_unit(rng.random((POINTS, problem.dimension))))


# --- a problem -----------------------------------------------------------------------------------------------------


def problem_checks(problem: Problem) -> Iterator[CheckResult]:
    """Run the checks of one problem, yielding each result as it comes."""
    for name, check in _PROBLEM.items():
        yield _result(name, check, problem)


def check_problem(problem: Problem) -> None:
    """Raise AssertionError, listing every failed check, unless the problem passes them all."""
    _all_passed(type(problem).__name__, problem_checks(problem))


def _box(problem: Problem) -> None:
    for name in ("lower", "upper"):
        bound = getattr(problem, name, None)
        need(
            isinstance(bound, ndarray) and bound.ndim == 1 and bound.size and np.isfinite(bound).all(),
            f"{name} to be a vector of finite numbers",
            repr(bound),
            f"Set self.{name} = np.array([...], dtype=float) in __init__, one number an unknown.",
        )
    lower, upper = problem.lower, problem.upper
    need(
        lower.shape == upper.shape and (lower < upper).all(),
        "lower < upper, of one length",
        f"{lower} and {upper}",
        "Swap them, or take out an unknown that cannot vary.",
    )


def _values(problem: Problem) -> str:
    X = _points(problem)
    values = np.asarray(problem.evaluate(X.copy()))
    need(
        values.shape == (len(X),),
        f"one value a row: shape ({len(X)},) for X of shape {X.shape}",
        f"shape {values.shape}",
        "Sum over the unknowns only, e.g. with axis=1.",
    )
    wrong = np.isnan(values) | (values == -math.inf)
    need(
        not wrong.any(),
        "a number everywhere in the box, its edges and corners too",
        f"{values[wrong][0] if wrong.any() else ''} at x = {X[wrong][0].tolist() if wrong.any() else ''}",
        "Guard the division, logarithm or root there, or shrink the box; +inf may mark what is not feasible.",
    )
    finite = np.isfinite(values)
    need(
        finite.sum() > 1,
        "finite values in the box",
        f"{finite.sum()} of {len(X)}",
        "Shrink the box to where the problem is defined.",
    )
    need(
        np.ptp(values[finite]) > 0.0,
        "values that differ",
        f"{values[finite][0]} at each of {finite.sum()} points",
        "See whether evaluate uses X at all.",
    )
    return "" if finite.all() else f"{(~finite).sum()} of {len(X)} points gave +inf"


def _batch(problem: Problem) -> None:
    X = _points(problem)
    values = np.asarray(problem.evaluate(X.copy()), dtype=float)
    for i in range(0, len(X), 7):
        for how, alone in (
            ("evaluate(X[i:i+1])[0]", problem.evaluate(X[i : i + 1])[0]),
            ("value(x)", problem.value(X[i])),
        ):
            need(
                _close(float(alone), float(values[i]), SAME),
                f"{how} to be the value of the same point in a batch, {values[i]!r}",
                repr(float(alone)),
                "Treat each row of X by itself: no sum, maximum or state across rows.",
            )


def _repeats(problem: Problem) -> None:
    X = _points(problem)
    first, second = (np.array(problem.evaluate(X.copy())) for _ in range(2))
    need(
        np.array_equal(first, second, equal_nan=True),
        "the same values when asked again",
        "others",
        "Draw what is random once, when the instance is drawn, and change nothing in evaluate.",
    )


def _input_unchanged(problem: Problem) -> None:
    X = _points(problem)
    X.flags.writeable = False
    before = X.copy()
    try:
        problem.evaluate(X)
    except ValueError as error:
        raise Failed(
            f"expected X to be read only, got {explain(error)}. Copy before changing: X = X.copy(), or X = X * 2."
        ) from error
    need(np.array_equal(before, X), "X unchanged", "other numbers", "Copy before changing: X = X.copy().")


def _gradient(problem: Problem) -> str:
    if not problem.has_gradient:
        return "no gradient: solvers that need one are skipped"
    width = problem.upper - problem.lower
    rng = np.random.default_rng(3)
    for _ in range(8):
        x = problem.lower + width * rng.uniform(0.05, 0.95, len(width))
        value, gradient = problem.value_and_gradient(x.copy())
        need(
            np.shape(gradient) == width.shape,
            f"a gradient of shape {width.shape}",
            f"shape {np.shape(gradient)}",
            "Return (value, gradient), the gradient with one number an unknown.",
        )
        need(
            _close(float(value), float(problem.value(x)), SAME),
            f"value_and_gradient to give the value {problem.value(x)!r}",
            repr(float(value)),
            "Let both compute the same function.",
        )
        h = 1e-6 * width
        steps = np.diag(h)
        difference = (np.asarray(problem.evaluate(x + steps)) - np.asarray(problem.evaluate(x - steps))) / (2.0 * h)
        error = np.abs((np.asarray(gradient) - difference) * width).max()
        scale = max(np.abs(difference * width).max(), 1e-3 * abs(float(value)), 1e-12)
        need(
            error <= SLOPE * scale,
            f"the gradient {difference.tolist()} of central differences at x = {x.tolist()}",
            f"{np.asarray(gradient).tolist()}",
            "Derive it anew; mind the sign, factors of 2 and the units of each unknown.",
        )
    return ""


_PROBLEM: dict[str, Callable[[Any], str | None]] = {
    "box": _box,
    "values": _values,
    "batch": _batch,
    "repeats": _repeats,
    "input-unchanged": _input_unchanged,
    "gradient": _gradient,
}


# --- a scenario, its instances, and the problems that formulations make of them ---------------------------------------


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
        check = _SCENARIO.get(name) or _each_problem(_PROBLEM[name])
        yield _result(name, check, scene)


def check_scenario(scenario: Scenario, formulations: Iterable[Formulation]) -> None:
    """Raise AssertionError, listing every failed check, unless scenario and problems pass them all."""
    _all_passed(type(scenario).__name__, scenario_checks(scenario, formulations))


def scenario_check_names() -> list[str]:
    """The names of all checks of a scenario, in the order they run."""
    return [*_SCENARIO, *_PROBLEM]


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
    return [np.asarray(problem.evaluate(_points(problem))) for problem in scene.problems(seed)]


def _points(problem: Problem) -> Float[ndarray, "p n"]:
    """Random points of the box, with its centre, two corners and two points on its faces."""
    U = np.random.default_rng(5).random((POINTS, problem.dimension))
    U[0], U[1], U[2], U[3, 0], U[4, -1] = 0.0, 1.0, 0.5, 0.0, 1.0
    X = problem.lower + U * (problem.upper - problem.lower)
    return np.clip(X, problem.lower, problem.upper)


def _close(a: float, b: float, tolerance: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b)) or abs(a - b) <= tolerance * max(abs(a), abs(b))


def _result(name: str, check: Callable[[Any], str | None], subject: object) -> CheckResult:
    states = random.getstate(), np.random.get_state()  # noqa: NPY002
    try:
        return CheckResult(name, True, check(subject) or "")
    except Failed as failure:
        return CheckResult(name, False, str(failure))
    except Exception as error:
        return CheckResult(name, False, f"expected the check to run through, got {explain(error)}.")
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


def _all_passed(name: str, results: Iterable[CheckResult]) -> None:
    failed = [result for result in results if not result.passed]
    if failed:
        lines = (f"  {result.name}: {result.message}" for result in failed)
        raise AssertionError("\n".join([f"{name} fails {len(failed)} check(s):", *lines]))
