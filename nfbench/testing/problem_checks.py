"""The checks of a problem: what it must do, and how to fix it when it does not."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench.core import Problem, explain

from .checks import CheckResult
from .subject import Failed, need

__all__ = ["POINTS", "PROBLEM_CHECKS", "all_passed", "check_problem", "outcome", "problem_checks", "sample_points"]

POINTS = 64
SAME = 1e-9  # relative rounding difference allowed between a single point and the same point in a batch
SLOPE = 1e-4  # relative difference allowed between the gradient and central differences


def problem_checks(problem: Problem) -> Iterator[CheckResult]:
    """Run all checks of one problem and yield each result as soon as it is available."""
    for name, check in PROBLEM_CHECKS.items():
        yield outcome(name, check, problem)


def check_problem(problem: Problem) -> None:
    """Raise AssertionError with a list of the failed checks unless the problem passes every check."""
    all_passed(type(problem).__name__, problem_checks(problem))


def _box(problem: Problem) -> None:
    for name in ("lower", "upper"):
        bound = getattr(problem, name, None)
        need(
            isinstance(bound, ndarray) and bound.ndim == 1 and bound.size and np.isfinite(bound).all(),
            f"{name} to be a vector of finite numbers",
            repr(bound),
            f"Set self.{name} = np.array([...], dtype=float) in __init__, with one number per unknown.",
        )
    lower, upper = problem.lower, problem.upper
    need(
        lower.shape == upper.shape and (lower < upper).all(),
        "lower < upper, both of the same length",
        f"lower = {lower} and upper = {upper}",
        "Swap the bounds, or remove an unknown that cannot vary.",
    )


def _values(problem: Problem) -> str:
    X = sample_points(problem)
    values = np.asarray(problem.evaluate(X.copy()))
    need(
        values.shape == (len(X),),
        f"evaluate to return one value per row: shape ({len(X)},) for X of shape {X.shape}",
        f"shape {values.shape}",
        "Sum over the unknowns only, e.g. with axis=1.",
    )
    wrong = np.isnan(values) | (values == -math.inf)
    need(
        not wrong.any(),
        "a number everywhere in the box, including its faces and corners",
        f"{values[wrong][0] if wrong.any() else ''} at x = {X[wrong][0].tolist() if wrong.any() else ''}",
        "Guard the division, logarithm or root at that point, or shrink the box; return +inf for infeasible points.",
    )
    finite = np.isfinite(values)
    need(
        finite.sum() > 1,
        "finite values in the box",
        f"{finite.sum()} of {len(X)}",
        "Shrink the box to the region where the problem is defined.",
    )
    need(
        np.ptp(values[finite]) > 0.0,
        "values that differ between points",
        f"{values[finite][0]} at each of {finite.sum()} points",
        "Check that evaluate uses X.",
    )
    return "" if finite.all() else f"the value is +inf at {(~finite).sum()} of {len(X)} points"


def _batch(problem: Problem) -> None:
    X = sample_points(problem)
    values = np.asarray(problem.evaluate(X.copy()), dtype=float)
    for i in range(0, len(X), 7):
        for call, single in (
            ("evaluate(X[i:i+1])[0]", problem.evaluate(X[i : i + 1])[0]),
            ("value(x)", problem.value(X[i])),
        ):
            need(
                _close(float(single), float(values[i]), SAME),
                f"{call} to equal the value of the same point in a batch, {values[i]!r}",
                repr(float(single)),
                "Treat each row of X independently: use no sum, maximum or state across rows.",
            )


def _repeats(problem: Problem) -> None:
    X = sample_points(problem)
    first, second = (np.array(problem.evaluate(X.copy())) for _ in range(2))
    need(
        np.array_equal(first, second, equal_nan=True),
        "the same values when the same points are evaluated again",
        "different values",
        "Draw random quantities once, when the instance is drawn, and change no state in evaluate.",
    )


def _input_unchanged(problem: Problem) -> None:
    X = sample_points(problem)
    X.flags.writeable = False
    before = X.copy()
    try:
        problem.evaluate(X)
    except ValueError as error:
        raise Failed(
            f"expected evaluate to leave X unchanged, got {explain(error)}. Copy X before you change it: X = X.copy(), "
            "or X = X * 2."
        ) from error
    need(np.array_equal(before, X), "X to be unchanged", "other numbers", "Copy X before you change it: X = X.copy().")


def _gradient(problem: Problem) -> str:
    if not problem.has_gradient:
        return "the problem has no gradient: solvers that need one are skipped"
    width = problem.upper - problem.lower
    rng = np.random.default_rng(3)
    for _ in range(8):
        x = problem.lower + width * rng.uniform(0.05, 0.95, len(width))
        value, gradient = problem.value_and_gradient(x.copy())
        need(
            np.shape(gradient) == width.shape,
            f"a gradient of shape {width.shape}",
            f"shape {np.shape(gradient)}",
            "Return (value, gradient), where the gradient has one number per unknown.",
        )
        need(
            _close(float(value), float(problem.value(x)), SAME),
            f"value_and_gradient to return the value {problem.value(x)!r}",
            repr(float(value)),
            "Compute the same function in evaluate and value_and_gradient.",
        )
        h = 1e-6 * width
        steps = np.diag(h)
        difference = (np.asarray(problem.evaluate(x + steps)) - np.asarray(problem.evaluate(x - steps))) / (2.0 * h)
        error = np.abs((np.asarray(gradient) - difference) * width).max()
        scale = max(np.abs(difference * width).max(), 1e-3 * abs(float(value)), 1e-12)
        need(
            error <= SLOPE * scale,
            f"the gradient to equal central differences, {difference.tolist()}, at x = {x.tolist()}",
            f"{np.asarray(gradient).tolist()}",
            "Derive the gradient again; check its sign, factors of 2 and the unit of each unknown.",
        )
    return ""


PROBLEM_CHECKS: dict[str, Callable[[Any], str | None]] = {
    "box": _box,
    "values": _values,
    "batch": _batch,
    "repeats": _repeats,
    "input-unchanged": _input_unchanged,
    "gradient": _gradient,
}


def sample_points(problem: Problem) -> Float[ndarray, "p n"]:
    """Return random points of the box, its centre, two corners and two points on its faces; shape (p, n)."""
    U = np.random.default_rng(5).random((POINTS, problem.dimension))
    U[0], U[1], U[2], U[3, 0], U[4, -1] = 0.0, 1.0, 0.5, 0.0, 1.0
    X = problem.lower + U * (problem.upper - problem.lower)
    return np.clip(X, problem.lower, problem.upper)


def _close(a: float, b: float, tolerance: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b)) or abs(a - b) <= tolerance * max(abs(a), abs(b))


def outcome(name: str, check: Callable[[Any], str | None], subject: object) -> CheckResult:
    """Run one check and return its result; the global random states are restored."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002
    try:
        return CheckResult(name, True, check(subject) or "")
    except Failed as failure:
        return CheckResult(name, False, str(failure))
    except Exception as error:
        return CheckResult(name, False, f"expected the check to run to its end, got {explain(error)}.")
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


def all_passed(name: str, results: Iterable[CheckResult]) -> None:
    """Raise AssertionError with a list of the failed checks unless all checks passed."""
    failed = [result for result in results if not result.passed]
    if failed:
        lines = (f"  {result.name}: {result.message}" for result in failed)
        raise AssertionError("\n".join([f"{name} fails {len(failed)} check(s):", *lines]))
