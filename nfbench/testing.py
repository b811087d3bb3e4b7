"""The conformance suite of solvers: what every solver must do, as checks whose failures say how to mend them.

In a plugin's tests::

    from nfbench.testing import check_solver

    def test_conformance():
        check_solver(MySolver(population=20))
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib
import importlib.util
import inspect
import io
import os
import pickle
import random
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .budget import Budget, Status
from .errors import BudgetExhausted, Incompatible
from .meter import MeteredProblem
from .minimize import Minimum, explain, minimize
from .options import canonical
from .problem import Problem
from .solver import Solver, SolverInfo

__all__ = ["CheckResult", "Probe", "check_names", "check_solver", "solver_checks"]

DIMENSIONS = (2, 5, 1, 10, 40)
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
    subject = _Subject(solver)
    states = _global_random()
    for name in names:
        try:
            result = CheckResult(name, True, _CHECKS[name](subject) or "")
        except _Failed as failure:
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


class Probe(Problem):
    """A small test problem that counts its evaluations and remembers in a digest every point it saw.

    With u = (x - lower)/(upper - lower) in [0, 1]: "bowl" is the mean of (u_j - centre_j)², its minimum 0 inside the
    box; "plateau" the bowl, but NaN where u_1 > 0.45; "flat" is 1; "falling" and "rising" are the sum of u, falling or
    rising, with their minimum in a corner. From evaluation ``stop_at`` on, ``stop`` is raised instead.
    """

    def __init__(
        self,
        lower: Float[ndarray, " n"],
        upper: Float[ndarray, " n"],
        shape: str = "bowl",
        gradient: bool = False,
        stop: type[BaseException] | None = None,
        stop_at: int = 0,
    ) -> None:
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        self.has_gradient = gradient  # type: ignore[misc]  # each probe decides for itself
        self.centre = 0.3 + 0.4 * ((1.0 + np.arange(len(self.lower))) * 0.6180339887498949 % 1.0)
        self.shape = shape
        self.stop, self.stop_at = stop, stop_at
        self.stops = 0
        self.evaluations = 0
        self._seen = hashlib.sha256()

    @property
    def range(self) -> float:
        """The bowl's largest value in the box; its smallest is 0."""
        return float(np.mean(np.maximum(self.centre, 1.0 - self.centre) ** 2))

    @property
    def digest(self) -> str:
        """A fingerprint of all points evaluated, in order."""
        return self._seen.hexdigest()

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        if self.stop is not None and self.evaluations + len(X) >= self.stop_at:
            self.stops += 1
            raise self.stop(f"at evaluation {self.stop_at}")
        self.evaluations += len(X)
        self._seen.update(np.ascontiguousarray(X).tobytes())
        u = (X - self.lower) / (self.upper - self.lower)
        if self.shape == "flat":
            return np.ones(len(u))
        if self.shape in ("falling", "rising"):
            return np.asarray(u.sum(axis=1) * (1.0 if self.shape == "rising" else -1.0))
        values = np.mean((u - self.centre) ** 2, axis=1)
        if self.shape == "plateau":
            values[u[:, 0] > 0.45] = np.nan
        return np.asarray(values)

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        width = self.upper - self.lower
        value = float(self.evaluate(x[None, :])[0])
        if self.shape == "flat":
            return value, np.zeros_like(x)
        if self.shape in ("falling", "rising"):
            return value, (1.0 if self.shape == "rising" else -1.0) / width
        return value, 2.0 * ((x - self.lower) / width - self.centre) / (width * len(x)) + 0.0 * value


class _Failed(Exception):
    """A check failed; the message is for the solver's author."""


class _Broken(ValueError):
    """What a probe raises as an error of its own."""


def _need(condition: object, expected: str, got: str, mend: str) -> None:
    if not condition:
        raise _Failed(f"expected {expected}, got {got}. {mend}")


@dataclasses.dataclass(frozen=True)
class _Subject:
    """The solver under test."""

    solver: Solver

    @functools.cached_property
    def dimension(self) -> int:
        """The first dimension the solver does not decline; Incompatible with its reason where it declines all."""
        for n in DIMENSIONS:
            outcome = self.run(self.probe(n), 1).minimum
            if outcome.status is not Status.SKIPPED:
                return n
        raise Incompatible(f"declines every dimension tried, {DIMENSIONS}: {outcome.message}")

    def probe(self, n: int | None = None, shape: str = "bowl", **more: Any) -> Probe:
        """A probe in n dimensions within bounds that no binary fraction hits."""
        n = self.dimension if n is None else n
        lower, upper = np.resize([-1 / 3, 0.1, -7.7], n), np.resize([0.7, 3.3, 0.1], n)
        return Probe(lower, upper, shape, **{"gradient": self.solver.info.needs_gradient, **more})

    def run(self, probe: Probe, budget: Budget | int, seed: int = 1) -> _Outcome:
        """Minimize the probe as a study does, with what it leaks caught."""
        printed = io.StringIO()
        with (
            warnings.catch_warnings(record=True) as caught,
            contextlib.redirect_stdout(printed),
            contextlib.redirect_stderr(printed),
        ):
            warnings.simplefilter("always")
            minimum = minimize(probe, self.solver, budget, seed)
        return _Outcome(minimum, [f"{w.category.__name__}: {w.message}" for w in caught], printed.getvalue())


@dataclasses.dataclass(frozen=True)
class _Outcome:
    minimum: Minimum
    warnings: list[str]
    printed: str


_CHECKS: dict[str, Callable[[_Subject], str | None]] = {}


def _check(function: Callable[[_Subject], str | None]) -> Callable[[_Subject], str | None]:
    _CHECKS[function.__name__.strip("_").replace("_", "-")] = function
    return function


def _ended_ok(outcome: _Outcome, where: str) -> None:
    minimum = outcome.minimum
    if minimum.status is Status.SKIPPED:
        raise Incompatible(minimum.message)
    _need(minimum.status is Status.OK, f"status ok {where}", f"{minimum.status}: {minimum.message}", _MEND_STATUS)


_MEND_STATUS = (
    "Run nfbench.minimize(problem, solver, budget) on that case and mend what the message names; a case that the "
    "algorithm cannot handle raises Incompatible with the reason."
)


@_check
def _described(subject: _Subject) -> None:
    cls = type(subject.solver)
    _need(
        isinstance(cls.__dict__.get("info"), SolverInfo),
        f"{cls.__name__}.info to be a SolverInfo",
        repr(cls.__dict__.get("info")),
        "Add `info: ClassVar[SolverInfo] = SolverInfo(reference=...)` to the class.",
    )
    doc = cls.__dict__.get("__doc__") or ""
    missing = [f.name for f in dataclasses.fields(cls) if f.init and not re.search(rf"\b{f.name}\b", doc)]
    _need(
        doc and not doc.startswith(f"{cls.__name__}(") and not missing,
        "a docstring that explains every option",
        f"nothing on {', '.join(missing)}" if missing else "no docstring",
        "Name each option in the class docstring with its meaning and unit.",
    )


@_check
def _budget(subject: _Subject) -> None:
    for budget in BUDGETS:
        probe = subject.probe()
        outcome = subject.run(probe, budget)
        _ended_ok(outcome, f"with a budget of {budget} evaluations")
        counted = outcome.minimum.evaluations
        _need(
            counted == probe.evaluations <= budget,
            f"the meter and the problem to count the same, at most {budget}",
            f"{counted} by the meter and {probe.evaluations} by the problem",
            "Evaluate through problem(x) and problem.evaluate(X) alone.",
        )


@_check
def _budget_in_seconds(subject: _Subject) -> None:
    _ended_ok(
        subject.run(subject.probe(), Budget(seconds=0.2)), "with a budget of 0.2 s, where problem.remaining is huge"
    )


@_check
def _stops_when_told(subject: _Subject) -> None:
    for at in (1, 20, 300):
        probe = subject.probe(stop=BudgetExhausted, stop_at=at)
        ended = True
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            try:
                subject.solver.minimize(MeteredProblem(probe, Budget(evaluations=1000)), np.random.default_rng(1))
            except BudgetExhausted:
                ended = False
        _need(
            not probe.stops or (probe.stops == 1 and not ended),
            f"BudgetExhausted, raised at evaluation {at}, to leave minimize at once",
            f"{probe.stops - 1} further requests, and minimize {'returned' if ended else 'raised it only then'}",
            "Catch no BaseException, and nothing bare; if the library does, remember the exception and raise it again.",
        )


@_check
def _errors_pass(subject: _Subject) -> None:
    for at in (1, 20, 300):
        probe = subject.probe(stop=_Broken, stop_at=at)
        minimum = subject.run(probe, 1000).minimum
        if minimum.status is Status.SKIPPED:
            raise Incompatible(minimum.message)
        _need(
            not probe.stops or minimum.status is Status.FAILED,
            f"a problem that raises at evaluation {at} to end the run as failed",
            f"status {minimum.status}",
            "Let the problem's exceptions pass.",
        )


@_check
def _bounds(subject: _Subject) -> None:
    for shape in ("falling", "rising"):
        minimum = subject.run(subject.probe(shape=shape), 1000).minimum
        _need(
            minimum.status is not Status.INVALID,
            "every point within the box, even where the minimum is in its corner",
            minimum.message,
            "Keep the points inside: clip, mirror or draw again; problem.from_unit(U) is safe against rounding.",
        )
        _ended_ok(_Outcome(minimum, [], ""), f"on a plane {shape} along every axis")


@_check
def _same_seed(subject: _Subject) -> None:
    replays = []
    for disturbance in (1, 2):  # what the global generators hold must not matter
        random.seed(disturbance)
        np.random.seed(disturbance)  # noqa: NPY002
        replays.append(_replay(subject, subject.dimension))
    mend = "Draw from the generator handed to minimize alone, and keep no state on the solver."
    _same(replays[0], replays[1], "in this process", mend)


@_check
def _new_process(subject: _Subject) -> None:
    _same(
        _replay(subject, subject.dimension),
        _replay_elsewhere(subject),
        "in this and in a new process",
        "Let nothing depend on what ran before, on hash() or the order of a set, or on a library's global seed.",
    )


@_check
def _other_seed(subject: _Subject) -> None:
    probes = [subject.probe(), subject.probe()]
    for seed, probe in enumerate(probes):
        _ended_ok(subject.run(probe, 500, seed), "on the bowl")
    same = probes[0].digest == probes[1].digest
    if subject.solver.info.stochastic:
        _need(
            not same,
            "other points with another seed, info.stochastic being true",
            "the same points",
            "Draw from the generator handed to minimize, or declare SolverInfo(stochastic=False).",
        )
    else:
        _need(
            same,
            "the same points whatever the seed, info.stochastic being false",
            "other points",
            "Declare SolverInfo(stochastic=True), or remove the randomness.",
        )


@_check
def _global_random_untouched(subject: _Subject) -> None:
    random.seed(12)
    np.random.seed(12)  # noqa: NPY002
    before = _global_random()
    subject.run(subject.probe(), 500)
    after = _global_random()
    for name, was, now in zip(("random", "np.random"), before, after, strict=True):
        _need(
            pickle.dumps(was) == pickle.dumps(now),
            f"the global state of {name} to be left alone",
            "another state after the run",
            "Draw from the generator handed to minimize; seed a library's own generator with int(rng.integers(2**31)).",
        )


@_check
def _inputs_unchanged(subject: _Subject) -> None:
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
    _need(not error, "a run that reads the problem's arrays and changes none", error, mend)
    for name in ("lower", "upper"):
        for owner, bound in (("meter's", getattr(meter, name)), ("problem's", getattr(probe, name))):
            kept = np.array_equal(bound, getattr(fresh, name))
            _need(kept, f"the {owner} {name} to stay as it was", str(bound), mend)
    _need(np.array_equal(probe.centre, fresh.centre), "the problem's data unchanged", str(probe.centre), mend)
    _need(repr(canonical(subject.solver)) == options, f"options {options}", repr(canonical(subject.solver)), mend)


@_check
def _nan_plateau(subject: _Subject) -> None:
    outcome = subject.run(subject.probe(shape="plateau"), 500)
    _ended_ok(outcome, "where the problem is NaN (+inf for the solver) in 55 % of the box")
    _need(
        np.isfinite(outcome.minimum.value),
        "a finite best value",
        repr(outcome.minimum.value),
        "Survive +inf as a value: search on elsewhere.",
    )


@_check
def _constant(subject: _Subject) -> None:
    outcome = subject.run(subject.probe(shape="flat"), 500)
    _ended_ok(outcome, "on a constant function")
    _need(outcome.minimum.value == 1.0, "the value 1", repr(outcome.minimum.value), "Return no value but the meter's.")


@_check
def _dimensions(subject: _Subject) -> str:
    declined = []
    for n in DIMENSIONS:
        outcome = subject.run(subject.probe(n), 200)
        if outcome.minimum.status is Status.SKIPPED:
            declined.append(f"{n} ({outcome.minimum.message})")
        else:
            _ended_ok(outcome, f"in {n} dimensions")
    return f"declines dimension {'; '.join(declined)}" if declined else ""


@_check
def _finds_minimum(subject: _Subject) -> None:
    for n in (2, 5):
        _search(subject, subject.probe(n), f"in {n} dimensions")


@_check
def _any_box(subject: _Subject) -> None:
    n = subject.dimension
    lower, width = np.resize([1e3, -5e5], n), np.resize([1e-3, 1e6], n)
    probe = Probe(lower, lower + width, gradient=subject.solver.info.needs_gradient)
    _search(subject, probe, "in a box 1e-3 wide along one axis and 1e6 along the next")


@_check
def _quiet(subject: _Subject) -> None:
    for shape in ("bowl", "plateau", "flat", "falling"):
        outcome = subject.run(subject.probe(shape=shape), 500)
        leaked = outcome.warnings[0] if outcome.warnings else outcome.printed.strip()[:200]
        _need(
            not leaked,
            f"no warning and no output on the {shape} problem",
            leaked,
            "Turn the library's messages off, or its warnings with np.errstate or warnings.catch_warnings.",
        )


def _search(subject: _Subject, probe: Probe, where: str) -> None:
    """The bowl's minimum must be found to the precision that ``info`` promises."""
    info = subject.solver.info
    if not (info.global_search or info.converges):
        raise Incompatible("info promises neither a global search nor convergence")
    precision = PRECISION[info.converges]
    budget = Budget(evaluations=SEARCH * probe.dimension, target=precision * probe.range)
    outcome = subject.run(probe, budget)
    _ended_ok(outcome, f"on the bowl {where}")
    minimum = outcome.minimum
    _need(
        minimum.value <= precision * probe.range,
        f"the bowl's minimum {where} to {precision:g} of its range within {budget.evaluations} evaluations",
        f"{minimum.value / probe.range:.2g} of its range after {minimum.evaluations}",
        "Mend the search, measure steps and tolerances in widths of the box, or declare SolverInfo(converges=False).",
    )


Replay = tuple[str, list[ndarray]]


def _replay(subject: _Subject, n: int) -> Replay:
    """What a run must repeat: the digest of all its points, and its trace without the seconds."""
    probe = subject.probe(n)
    outcome = subject.run(probe, 500, seed=7)
    _ended_ok(outcome, "on the bowl")
    trace = outcome.minimum.trace
    return probe.digest, [trace.evaluations, trace.values, trace.points]


def _same(first: Replay, second: Replay, where: str, mend: str) -> None:
    for name, a, b in zip(("evaluations", "values", "points"), first[1], second[1], strict=True):
        rows = min(len(a), len(b))
        differ = np.flatnonzero((a[:rows] != b[:rows]).reshape(rows, -1).any(axis=1))
        row = int(differ[0]) if len(differ) else rows
        _need(
            not len(differ) and len(a) == len(b),
            f"identical traces from one seed {where}",
            f"{name} that differ from row {row} on: {a[row : row + 1].tolist()} and {b[row : row + 1].tolist()}",
            mend,
        )
    _need(first[0] == second[0], f"identical points from one seed {where}", "points that differ", mend)


_CHILD = """
import pickle, sys
folder = sys.argv[1]
with open(folder + "/job", "rb") as file:
    job = pickle.load(file)
sys.path[:] = job["path"]
from nfbench.testing import _serve
_serve(job, folder)
"""


def _replay_elsewhere(subject: _Subject) -> Replay:
    """The same replay in a fresh interpreter, which finds the solver's class by its module or by its file."""
    cls = type(subject.solver)
    file = inspect.getsourcefile(cls) if "<locals>" not in cls.__qualname__ else None
    _need(
        file is not None and Path(file).is_file(),
        "a solver class that another process can import",
        f"{cls.__module__}.{cls.__qualname__}, defined in a function or in no file",
        "Define the class at the top level of a file.",
    )
    options = {f.name: getattr(subject.solver, f.name) for f in dataclasses.fields(cls) if f.init}
    job = {
        "path": sys.path,
        "class": (cls.__module__, cls.__qualname__, str(file)),
        "options": pickle.dumps(options),
        "dimension": subject.dimension,
    }
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "job").write_bytes(pickle.dumps(job))
        command = [sys.executable, "-c", _CHILD, folder]
        env = {**os.environ, "PYTHONHASHSEED": "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"}
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=env)
        answer = Path(folder) / "answer"
        _need(
            answer.is_file(),
            "the run to repeat in a new process",
            done.stderr.strip().rpartition("\n")[2] or f"exit code {done.returncode}",
            "Make the solver's file importable by itself, with all it needs imported in it.",
        )
        replay: Replay = pickle.loads(answer.read_bytes())
    return replay


def _serve(job: dict[str, Any], folder: str) -> None:
    """The other end of :func:`_replay_elsewhere`."""
    cls = _load(*job["class"])
    solver = cls(**pickle.loads(job["options"]))
    replay = _replay(_Subject(solver), job["dimension"])
    partial = Path(folder) / "partial"
    partial.write_bytes(pickle.dumps(replay))
    partial.rename(Path(folder) / "answer")


def _load(module: str, name: str, file: str) -> type[Solver]:
    """A class by the name of its module or, where that is not to be found, from its file."""
    try:
        if module == "__main__":
            raise ImportError
        found: Any = functools.reduce(getattr, name.split("."), importlib.import_module(module))
    except (ImportError, AttributeError):
        spec = importlib.util.spec_from_file_location(f"{module}_from_file", file)
        if spec is None or spec.loader is None:
            raise
        loaded = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = sys.modules[module] = loaded
        spec.loader.exec_module(loaded)
        found = functools.reduce(getattr, name.split("."), loaded)
    return found


def _global_random() -> tuple[Any, Any]:
    return random.getstate(), np.random.get_state()  # noqa: NPY002


def _set_global_random(states: tuple[Any, Any]) -> None:
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
