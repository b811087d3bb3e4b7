"""The checks of a solver: what every solver must do, and how to fix it when it does not."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import io
import pickle
import random
import re
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from nfbench.core import (
    Budget,
    BudgetExhausted,
    Incompatible,
    MeteredProblem,
    Solver,
    SolverInfo,
    Status,
    canonical,
    explain,
)

from .elsewhere import elsewhere
from .footprint import footprint
from .probe import Probe
from .replay import cases_of, compare_before_and_after_other_runs, replays, replays_of, same
from .subject import DIMENSIONS, Broken, Failed, Outcome, Subject, ended_ok, need

BUDGETS = (1, 7, 50, 500)
SEARCH = 20_000  # evaluations per unknown within which the minimum of the bowl must be found
PRECISION = {True: 1e-6, False: 1e-2}  # fraction of the bowl's range of values, by SolverInfo.converges


@dataclasses.dataclass(frozen=True)
class CheckResult:
    """The outcome of one check.

    name: name of the check.
    passed: whether the check passed; a check that does not apply to the solver passes.
    message: if the check failed, why it failed and how to fix it; otherwise a note, for example that the check does
        not apply, or an empty string.
    """

    name: str
    passed: bool
    message: str = ""


def solver_checks(solver: Solver, only: Iterable[str] | None = None) -> Iterator[CheckResult]:
    """Run the checks named in ``only`` (default: all checks) and yield each result as soon as it is available.

    The global random states of NumPy and Python are restored after each check. Raises ValueError if ``only`` contains
    an unknown name.
    """
    names = list(_CHECKS) if only is None else list(only)
    if unknown := set(names) - set(_CHECKS):
        raise ValueError(f"only: expected names of checks ({', '.join(_CHECKS)}), got {', '.join(sorted(unknown))}")
    subject = Subject(solver)
    states = _global_random()
    for name in names:
        try:
            result = CheckResult(name, True, _CHECKS[name](subject) or "")
        except Failed as failure:
            result = CheckResult(name, False, str(failure))
        except Incompatible as reason:
            result = CheckResult(name, True, f"not applicable: {reason}")
        except Exception as error:
            result = CheckResult(name, False, f"expected the check to run to its end, got {explain(error)}.")
        finally:
            _set_global_random(states)
        yield result


def check_solver(solver: Solver, *, only: Iterable[str] | None = None) -> None:
    """Raise AssertionError with a list of the failed checks unless the solver passes every check."""
    failed = [result for result in solver_checks(solver, only) if not result.passed]
    if failed:
        lines = (f"  {result.name}: {result.message}" for result in failed)
        raise AssertionError("\n".join([f"{type(solver).__name__} fails {len(failed)} check(s):", *lines]))


def check_names() -> list[str]:
    """Return the names of all checks, in the order in which they run."""
    return list(_CHECKS)


_CHECKS: dict[str, Callable[[Subject], str | None]] = {}


def _check(function: Callable[[Subject], str | None]) -> Callable[[Subject], str | None]:
    _CHECKS[function.__name__.strip("_").replace("_", "-")] = function
    return function


@_check
def _described(subject: Subject) -> None:
    cls = type(subject.solver)
    need(
        isinstance(cls.__dict__.get("info"), SolverInfo),
        f"{cls.__name__}.info to be a SolverInfo",
        repr(cls.__dict__.get("info")),
        "Add `info: ClassVar[SolverInfo] = SolverInfo(reference=...)` to the class.",
    )
    doc = cls.__dict__.get("__doc__") or ""
    missing = [f.name for f in dataclasses.fields(cls) if f.init and not re.search(rf"\b{f.name}\b", doc)]
    need(
        doc and not doc.startswith(f"{cls.__name__}(") and not missing,
        "a docstring that explains every option",
        f"no entry for {', '.join(missing)}" if missing else "no docstring",
        "Describe each option in the class docstring as `name: meaning and unit`.",
    )


@_check
def _budget(subject: Subject) -> None:
    for budget in BUDGETS:
        probe = subject.probe()
        outcome = subject.run(probe, budget)
        ended_ok(outcome, f"with a budget of {budget} evaluations")
        counted = outcome.minimum.evaluations
        need(
            counted == probe.evaluations <= budget,
            f"the meter and the problem to count the same number of evaluations, at most {budget}",
            f"{counted} in the meter and {probe.evaluations} in the problem",
            "Evaluate the problem only through problem(x), problem.evaluate(X) and problem.value_and_gradient(x).",
        )


@_check
def _budget_in_seconds(subject: Subject) -> None:
    outcome = subject.run(subject.probe(), Budget(seconds=0.2))
    ended_ok(outcome, "with a budget of 0.2 s, for which problem.remaining is very large")


@_check
def _stops_when_told(subject: Subject) -> None:
    for at in (1, 20, 300):
        probe = subject.probe(stop=BudgetExhausted, stop_at=at)
        ended = True
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            try:
                subject.solver.minimize(MeteredProblem(probe, Budget(evaluations=1000)), np.random.default_rng(1))
            except BudgetExhausted:
                ended = False
        need(
            not probe.stops or (probe.stops == 1 and not ended),
            f"minimize to stop as soon as BudgetExhausted is raised at evaluation {at}",
            f"{probe.stops - 1} further evaluation requests, and minimize "
            f"{'returned normally' if ended else 'raised the exception only afterwards'}",
            "Remove every bare `except:` and `except BaseException:`; if a wrapped library catches the exception, "
            "store it in the objective function and raise it again when the library returns.",
        )


@_check
def _errors_pass(subject: Subject) -> None:
    for at in (1, 20, 300):
        probe = subject.probe(stop=Broken, stop_at=at)
        minimum = subject.run(probe, 1000).minimum
        if minimum.status is Status.SKIPPED:
            raise Incompatible(minimum.message)
        need(
            not probe.stops or minimum.status is Status.FAILED,
            f"a problem that raises at evaluation {at} to end the run as failed",
            f"status {minimum.status}",
            "Do not catch the exceptions that the problem raises.",
        )


@_check
def _bounds(subject: Subject) -> None:
    for shape in ("falling", "rising"):
        minimum = subject.run(subject.probe(shape=shape), 1000).minimum
        need(
            minimum.status is not Status.INVALID,
            "every point to lie within the bounds, even when the minimum is in a corner of the box",
            minimum.message,
            "Clip, mirror or redraw the points that leave the box; problem.from_unit(U) is safe against rounding.",
        )
        ended_ok(Outcome(minimum, [], ""), f"on a plane that is {shape} along every axis")


@_check
def _same_seed(subject: Subject) -> None:
    compare_before_and_after_other_runs(subject)


@_check
def _new_process(subject: Subject) -> None:
    here = replays(subject, cases_of(subject))
    there = elsewhere(subject, replays_of, (list(here)[::-1],))  # in the reverse order, after other runs
    for case, first in here.items():
        same(
            first,
            there[case],
            f"in this process and in a new one ({case[0]} dimensions)",
            "Make sure that the run does not depend on earlier runs, on hash() or the order of a set, or on a "
            "library's global seed.",
        )


@_check
def _leaves_no_trace(subject: Subject) -> None:
    if found := elsewhere(subject, footprint, folder_of_its_own=True):
        need(False, *found)


@_check
def _other_seed(subject: Subject) -> None:
    probes = [subject.probe(), subject.probe()]
    for seed, probe in enumerate(probes):
        ended_ok(subject.run(probe, 500, seed), "on the bowl")
    identical = probes[0].digest == probes[1].digest
    if subject.solver.info.stochastic:
        need(
            not identical,
            "different points with a different seed, because info.stochastic is true",
            "the same points",
            "Draw random numbers from the generator passed to minimize, or declare SolverInfo(stochastic=False).",
        )
    else:
        need(
            identical,
            "the same points with every seed, because info.stochastic is false",
            "different points",
            "Declare SolverInfo(stochastic=True), or remove the randomness.",
        )


@_check
def _global_random_untouched(subject: Subject) -> None:
    random.seed(12)
    np.random.seed(12)  # noqa: NPY002
    before = _global_random()
    subject.run(subject.probe(), 500)
    after = _global_random()
    for name, old, new in zip(("random", "np.random"), before, after, strict=True):
        need(
            pickle.dumps(old) == pickle.dumps(new),
            f"the global state of {name} to be unchanged",
            "a different state after the run",
            "Draw random numbers from the generator passed to minimize; seed a library's own generator with "
            "int(rng.integers(2**31)).",
        )


@_check
def _inputs_unchanged(subject: Subject) -> None:
    probe, fresh = subject.probe(), subject.probe()
    meter = MeteredProblem(probe, Budget(evaluations=500))
    options = repr(canonical(subject.solver))
    error = ""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            subject.solver.minimize(meter, np.random.default_rng(1))
        except BudgetExhausted:
            pass
        except Incompatible:
            raise
        except Exception as raised:
            error = explain(raised)
    remedy = "Copy an array before you change it, and do not store in the solver's fields what changes during a run."
    need(not error, "a run that reads the problem's arrays but changes none of them", error, remedy)
    for name in ("lower", "upper"):
        for owner, bound in (("meter's", getattr(meter, name)), ("problem's", getattr(probe, name))):
            unchanged = np.array_equal(bound, getattr(fresh, name))
            need(unchanged, f"the {owner} {name} bounds to be unchanged", str(bound), remedy)
    need(np.array_equal(probe.centre, fresh.centre), "the problem's data to be unchanged", str(probe.centre), remedy)
    after = repr(canonical(subject.solver))
    need(after == options, f"the options {options} to be unchanged", after, remedy)


@_check
def _nan_plateau(subject: Subject) -> None:
    outcome = subject.run(subject.probe(shape="plateau"), 500)
    ended_ok(outcome, "on a problem that is NaN (the solver sees +inf) in 55 % of the box")
    need(
        np.isfinite(outcome.minimum.value),
        "a finite best value",
        repr(outcome.minimum.value),
        "Accept +inf as an objective value and continue the search elsewhere.",
    )


@_check
def _constant(subject: Subject) -> None:
    outcome = subject.run(subject.probe(shape="flat"), 500)
    ended_ok(outcome, "on a constant function")
    need(
        outcome.minimum.value == 1.0,
        "the best value to be 1",
        repr(outcome.minimum.value),
        "Evaluate the problem only through the meter, which keeps the best value.",
    )


@_check
def _dimensions(subject: Subject) -> str:
    declined = []
    for n in DIMENSIONS:
        outcome = subject.run(subject.probe(n), 200)
        if outcome.minimum.status is Status.SKIPPED:
            declined.append(f"{n} ({outcome.minimum.message})")
        else:
            ended_ok(outcome, f"in {n} dimensions")
    return f"declines dimension {'; '.join(declined)}" if declined else ""


@_check
def _finds_minimum(subject: Subject) -> None:
    for n in (2, 5):
        _search(subject, subject.probe(n), f"in {n} dimensions")


@_check
def _any_box(subject: Subject) -> None:
    n = subject.dimension
    lower, width = np.resize([1e3, -5e5], n), np.resize([1e-3, 1e6], n)
    probe = Probe(lower, lower + width, gradient=subject.solver.info.needs_gradient)
    _search(subject, probe, "in a box that is 1e-3 wide along one axis and 1e6 along the next")


@_check
def _quiet(subject: Subject) -> None:
    for shape in ("bowl", "plateau", "flat", "falling"):
        outcome = subject.run(subject.probe(shape=shape), 500)
        output = outcome.warnings[0] if outcome.warnings else outcome.printed.strip()[:200]
        need(
            not output,
            f"no warning and no output on the {shape} problem",
            output,
            "Turn off the library's messages, and suppress its warnings with np.errstate or warnings.catch_warnings.",
        )


@_check
def _released(subject: Subject) -> None:
    references = []
    for _ in range(3):
        probe = subject.probe()
        references.append(weakref.ref(probe))
        subject.run(probe, 500)
        del probe
    gc.collect()
    alive = sum(reference() is not None for reference in references)
    need(
        alive <= 1,  # a library's cache may keep the last one
        "every problem to be freed after its run",
        f"{alive} of {len(references)} problems still in memory, so that a long study would run out of memory",
        "Do not store the problem on the solver or in its module. The garbage collector may not see a library object's "
        "reference to your objective function: delete the object before minimize ends, also when BudgetExhausted ends "
        "it.",
    )


def _search(subject: Subject, probe: Probe, where: str) -> None:
    """Check that the solver finds the bowl's minimum with the precision that ``info`` promises."""
    info = subject.solver.info
    if not (info.global_search or info.converges):
        raise Incompatible("SolverInfo promises neither a global search nor convergence")
    precision = PRECISION[info.converges]
    budget = Budget(evaluations=SEARCH * probe.dimension, target=precision * probe.range)
    outcome = subject.run(probe, budget)
    ended_ok(outcome, f"on the bowl {where}")
    minimum = outcome.minimum
    need(
        minimum.value <= precision * probe.range,
        f"the minimum of the bowl {where} to within {precision:g} of its range in {budget.evaluations} evaluations",
        f"{minimum.value / probe.range:.2g} of its range after {minimum.evaluations} evaluations",
        "Fix the search, measure steps and tolerances relative to the width of the box, or declare "
        "SolverInfo(converges=False).",
    )


def _global_random() -> tuple[Any, Any]:
    return random.getstate(), np.random.get_state()  # noqa: NPY002


def _set_global_random(states: tuple[Any, Any]) -> None:
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
