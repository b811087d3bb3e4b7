"""The checks: what every solver must do, and how to mend it where it does not."""

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

from .probe import Probe
from .replay import replay, replay_elsewhere, same
from .subject import DIMENSIONS, Broken, Failed, Outcome, Subject, ended_ok, need

BUDGETS = (1, 7, 50, 500)
SEARCH = 20_000  # evaluations per unknown in which the minimum of the bowl must be found
PRECISION = {True: 1e-6, False: 1e-2}  # of the bowl's range of values, for solvers that converge and others


@dataclasses.dataclass(frozen=True)
class CheckResult:
    """The outcome of one check. message: why it failed and how to mend it, or a note on what was not applicable."""

    name: str
    passed: bool
    message: str = ""


def solver_checks(solver: Solver, only: Iterable[str] | None = None) -> Iterator[CheckResult]:
    """Run the checks (those named in ``only``, or all), yielding each result as it comes.

    The global random states of NumPy and Python are left as they were found.
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
            result = CheckResult(name, False, f"expected the check to run through, got {explain(error)}.")
        finally:
            _set_global_random(states)
        yield result


def check_solver(solver: Solver, *, only: Iterable[str] | None = None) -> None:
    """Raise AssertionError, listing every failed check, unless the solver passes them all."""
    failed = [result for result in solver_checks(solver, only) if not result.passed]
    if failed:
        lines = (f"  {result.name}: {result.message}" for result in failed)
        raise AssertionError("\n".join([f"{type(solver).__name__} fails {len(failed)} check(s):", *lines]))


def check_names() -> list[str]:
    """The names of all checks, in the order they run."""
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
        f"nothing on {', '.join(missing)}" if missing else "no docstring",
        "Name each option in the class docstring with its meaning and unit.",
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
            f"the meter and the problem to count the same, at most {budget}",
            f"{counted} by the meter and {probe.evaluations} by the problem",
            "Evaluate through problem(x) and problem.evaluate(X) alone.",
        )


@_check
def _budget_in_seconds(subject: Subject) -> None:
    ended_ok(
        subject.run(subject.probe(), Budget(seconds=0.2)), "with a budget of 0.2 s, where problem.remaining is huge"
    )


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
            f"BudgetExhausted, raised at evaluation {at}, to leave minimize at once",
            f"{probe.stops - 1} further requests, and minimize {'returned' if ended else 'raised it only then'}",
            "Catch no BaseException, and nothing bare; if the library does, remember the exception and raise it again.",
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
            "Let the problem's exceptions pass.",
        )


@_check
def _bounds(subject: Subject) -> None:
    for shape in ("falling", "rising"):
        minimum = subject.run(subject.probe(shape=shape), 1000).minimum
        need(
            minimum.status is not Status.INVALID,
            "every point within the box, even where the minimum is in its corner",
            minimum.message,
            "Keep the points inside: clip, mirror or draw again; problem.from_unit(U) is safe against rounding.",
        )
        ended_ok(Outcome(minimum, [], ""), f"on a plane {shape} along every axis")


@_check
def _same_seed(subject: Subject) -> None:
    replays = []
    for disturbance in (1, 2):  # what the global generators hold must not matter
        random.seed(disturbance)
        np.random.seed(disturbance)  # noqa: NPY002
        replays.append(replay(subject, subject.dimension))
    mend = "Draw from the generator handed to minimize alone, and keep no state on the solver."
    same(replays[0], replays[1], "in this process", mend)


@_check
def _new_process(subject: Subject) -> None:
    same(
        replay(subject, subject.dimension),
        replay_elsewhere(subject),
        "in this and in a new process",
        "Let nothing depend on what ran before, on hash() or the order of a set, or on a library's global seed.",
    )


@_check
def _other_seed(subject: Subject) -> None:
    probes = [subject.probe(), subject.probe()]
    for seed, probe in enumerate(probes):
        ended_ok(subject.run(probe, 500, seed), "on the bowl")
    same = probes[0].digest == probes[1].digest
    if subject.solver.info.stochastic:
        need(
            not same,
            "other points with another seed, info.stochastic being true",
            "the same points",
            "Draw from the generator handed to minimize, or declare SolverInfo(stochastic=False).",
        )
    else:
        need(
            same,
            "the same points whatever the seed, info.stochastic being false",
            "other points",
            "Declare SolverInfo(stochastic=True), or remove the randomness.",
        )


@_check
def _global_random_untouched(subject: Subject) -> None:
    random.seed(12)
    np.random.seed(12)  # noqa: NPY002
    before = _global_random()
    subject.run(subject.probe(), 500)
    after = _global_random()
    for name, was, now in zip(("random", "np.random"), before, after, strict=True):
        need(
            pickle.dumps(was) == pickle.dumps(now),
            f"the global state of {name} to be left alone",
            "another state after the run",
            "Draw from the generator handed to minimize; seed a library's own generator with int(rng.integers(2**31)).",
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
    mend = "Copy an array before changing it; keep what changes during a run out of the solver's fields."
    need(not error, "a run that reads the problem's arrays and changes none", error, mend)
    for name in ("lower", "upper"):
        for owner, bound in (("meter's", getattr(meter, name)), ("problem's", getattr(probe, name))):
            kept = np.array_equal(bound, getattr(fresh, name))
            need(kept, f"the {owner} {name} to stay as it was", str(bound), mend)
    need(np.array_equal(probe.centre, fresh.centre), "the problem's data unchanged", str(probe.centre), mend)
    need(repr(canonical(subject.solver)) == options, f"options {options}", repr(canonical(subject.solver)), mend)


@_check
def _nan_plateau(subject: Subject) -> None:
    outcome = subject.run(subject.probe(shape="plateau"), 500)
    ended_ok(outcome, "where the problem is NaN (+inf for the solver) in 55 % of the box")
    need(
        np.isfinite(outcome.minimum.value),
        "a finite best value",
        repr(outcome.minimum.value),
        "Survive +inf as a value: search on elsewhere.",
    )


@_check
def _constant(subject: Subject) -> None:
    outcome = subject.run(subject.probe(shape="flat"), 500)
    ended_ok(outcome, "on a constant function")
    need(outcome.minimum.value == 1.0, "the value 1", repr(outcome.minimum.value), "Return no value but the meter's.")


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
    _search(subject, probe, "in a box 1e-3 wide along one axis and 1e6 along the next")


@_check
def _quiet(subject: Subject) -> None:
    for shape in ("bowl", "plateau", "flat", "falling"):
        outcome = subject.run(subject.probe(shape=shape), 500)
        leaked = outcome.warnings[0] if outcome.warnings else outcome.printed.strip()[:200]
        need(
            not leaked,
            f"no warning and no output on the {shape} problem",
            leaked,
            "Turn the library's messages off, or its warnings with np.errstate or warnings.catch_warnings.",
        )


@_check
def _released(subject: Subject) -> None:
    kept = []
    for _ in range(3):
        probe = subject.probe()
        kept.append(weakref.ref(probe))
        subject.run(probe, 500)
        del probe
    gc.collect()
    alive = sum(reference() is not None for reference in kept)
    need(
        alive <= 1,  # the last one may stay, in a library's cache
        "problems to be freed when their runs are over",
        f"{alive} of {len(kept)} that something still holds, so that a long study fills the memory",
        "Keep nothing on the solver or its module. A library's object may hide its reference to your function from the "
        "garbage collector: delete it before minimize ends, also by BudgetExhausted.",
    )


def _search(subject: Subject, probe: Probe, where: str) -> None:
    """The bowl's minimum must be found to the precision that ``info`` promises."""
    info = subject.solver.info
    if not (info.global_search or info.converges):
        raise Incompatible("info promises neither a global search nor convergence")
    precision = PRECISION[info.converges]
    budget = Budget(evaluations=SEARCH * probe.dimension, target=precision * probe.range)
    outcome = subject.run(probe, budget)
    ended_ok(outcome, f"on the bowl {where}")
    minimum = outcome.minimum
    need(
        minimum.value <= precision * probe.range,
        f"the bowl's minimum {where} to {precision:g} of its range within {budget.evaluations} evaluations",
        f"{minimum.value / probe.range:.2g} of its range after {minimum.evaluations}",
        "Mend the search, measure steps and tolerances in widths of the box, or declare SolverInfo(converges=False).",
    )


def _global_random() -> tuple[Any, Any]:
    return random.getstate(), np.random.get_state()  # noqa: NPY002


def _set_global_random(states: tuple[Any, Any]) -> None:
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
