"""Solvers that each break one rule: the check of that rule must fail with the reason, and unrelated checks pass."""

import random
import sys
import textwrap
import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from leaving_solvers import KeepsDeviate, KeepsDimension, KeepsGenerator, LeavesAfterError, Threads, forget

from nfbench import BudgetExhausted, Incompatible, Solver, SolverInfo
from nfbench.testing import CheckResult, Probe, check_names, check_solver, solver_checks


def sample(problem, rng, lower=0.0, upper=1.0):
    """A random search in a shrinking box that passes every check."""
    centre, radius = np.full(problem.dimension, 0.5), 0.5
    while True:
        U = np.clip(centre + radius * rng.uniform(-1, 1, (20, problem.dimension)), 0, 1)
        U[0] = centre
        values = problem.evaluate(problem.from_unit(U))
        centre = U[np.argmin(values)]
        radius = max(radius * (0.97 if values.argmin() == 0 else 1.0), 1e-6)


@dataclass(frozen=True)
class Good(Solver):
    """Follows every rule."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, rng)


@dataclass(frozen=True)
class Outside(Solver):
    """Leaves the box when it walks down a slope."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        x = problem.from_unit(rng.random(problem.dimension))
        best = problem(x)
        while True:
            step = x + 0.5 * rng.standard_normal(len(x))
            if (value := problem(step)) < best:
                x, best = step, value


@dataclass(frozen=True)
class Deaf(Solver):
    """Catches BudgetExhausted and continues to evaluate."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        for _ in range(3):
            try:
                sample(problem, rng)
            except BaseException:
                continue


@dataclass(frozen=True)
class Polite(Solver):
    """Catches BudgetExhausted and returns."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        try:
            sample(problem, rng)
        except BudgetExhausted:
            return


@dataclass(frozen=True)
class Soothing(Solver):
    """Catches an error of the problem and returns."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        try:
            sample(problem, rng)
        except Exception:
            return


@dataclass(frozen=True)
class GlobalDraws(Solver):
    """Draws from NumPy's global generator."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        while True:
            problem.evaluate(problem.from_unit(np.random.random((20, problem.dimension))))  # noqa: NPY002


@dataclass(frozen=True)
class GlobalSeed(Solver):
    """Seeds Python's global generator, reproducibly."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        random.seed(int(rng.integers(1000)))
        while True:
            problem(problem.from_unit(np.array([random.random() for _ in range(problem.dimension)])))


@dataclass(frozen=True)
class OwnEntropy(Solver):
    """Ignores its generator and uses one that is seeded by the operating system."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, np.random.default_rng())


@dataclass(frozen=True)
class HashOrder(Solver):
    """Depends on the hash seed of the process."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, np.random.default_rng(rng.integers(10) + abs(hash("nfbench"))))


@dataclass(frozen=True)
class FixedSeed(Solver):
    """Claims to be stochastic, but draws the same numbers with every seed."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, np.random.default_rng(0))


@dataclass(frozen=True)
class SecretlyRandom(Solver):
    """Claims to be deterministic, but is not."""

    info: ClassVar[SolverInfo] = SolverInfo(stochastic=False, converges=False)

    def minimize(self, problem, rng):
        sample(problem, rng)


@dataclass(frozen=True)
class WritesBounds(Solver):
    """Shifts the problem's bounds."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        lower = problem.lower
        lower -= 1.0
        sample(problem, rng)


@dataclass(frozen=True)
class UnlocksBounds(Solver):
    """Makes the bounds writeable and shrinks the box."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        problem.lower.flags.writeable = True
        problem.lower += 1e-3 * (problem.upper - problem.lower)
        sample(problem, rng)


@dataclass(frozen=True)
class StoresStateOnItself(Solver):
    """Stores state in one of its options.

    runs: number of runs so far.
    """

    runs: int = 0

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        object.__setattr__(self, "runs", self.runs + 1)
        sample(problem, rng)


@dataclass(frozen=True)
class Idle(Solver):
    """Returns without an evaluation."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        return


@dataclass(frozen=True)
class Bypass(Solver):
    """Evaluates the problem without the meter."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        problem._problem.evaluate(problem.from_unit(rng.random((10, problem.dimension))))
        sample(problem, rng)


@dataclass(frozen=True)
class Hoarder(Solver):
    """Allocates memory for every evaluation that the budget allows."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        np.empty((problem.remaining, problem.dimension))
        sample(problem, rng)


@dataclass(frozen=True)
class Fragile(Solver):
    """Cannot compute with infinite values."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        while True:
            values = problem.evaluate(problem.from_unit(rng.random((20, problem.dimension))))
            if not np.isfinite(values).all():
                raise FloatingPointError("infinite value")


@dataclass(frozen=True)
class Flat(Solver):
    """Divides by the range of the values."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        while True:
            values = problem.evaluate(problem.from_unit(rng.random((20, problem.dimension))))
            1.0 / float(np.ptp(values[values < np.inf]))


@dataclass(frozen=True)
class PlaneOnly(Solver):
    """Fails in more than two dimensions instead of declining."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        if problem.dimension > 2:
            raise IndexError("no third axis")
        sample(problem, rng)


@dataclass(frozen=True)
class Declines(Solver):
    """Declines every dimension except two."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        if problem.dimension != 2:
            raise Incompatible(f"needs 2 unknowns, got {problem.dimension}")
        sample(problem, rng)


@dataclass(frozen=True)
class Centre(Solver):
    """Promises a global search, but evaluates a single point."""

    info: ClassVar[SolverInfo] = SolverInfo(stochastic=False, converges=False)

    def minimize(self, problem, rng):
        problem(0.5 * (problem.lower + problem.upper))


@dataclass(frozen=True)
class AbsoluteSteps(Solver):
    """Takes steps of an absolute length, which is suitable only for some boxes."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        x = problem.from_unit(rng.random(problem.dimension))
        best = problem(x)
        while True:
            step = np.clip(x + 0.05 * rng.standard_normal(len(x)), problem.lower, problem.upper)
            if (value := problem(step)) < best:
                x, best = step, value


@dataclass(frozen=True)
class Warns(Solver):
    """Warns when it starts."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        warnings.warn("step size guessed", RuntimeWarning, stacklevel=2)
        sample(problem, rng)


@dataclass(frozen=True)
class Talks(Solver):
    """Prints when it starts."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        print("starting the search")
        sample(problem, rng)


@dataclass(frozen=True)
class Undocumented(Solver):
    """Has an option that the docstring does not describe."""

    temperature: float = 1.0

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, rng)


HELD = []


@dataclass(frozen=True)
class Holds(Solver):
    """Keeps a reference to every problem that it has minimized."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        HELD.append(problem)
        sample(problem, rng)


CAUGHT = [
    (Outside, "bounds", "within the bounds, even when the minimum is in a corner of the box, got x["),
    (Deaf, "stops-when-told", "BudgetExhausted is raised at evaluation 1, got 2 further evaluation requests"),
    (Polite, "stops-when-told", "got 0 further evaluation requests, and minimize returned normally"),
    (Soothing, "errors-pass", "a problem that raises at evaluation 1 to end the run as failed, got status invalid"),
    (GlobalDraws, "same-seed", "expected identical traces with the same seed in this process"),
    (GlobalDraws, "global-random-untouched", "the global state of np.random to be unchanged"),
    (GlobalSeed, "global-random-untouched", "the global state of random to be unchanged"),
    (OwnEntropy, "same-seed", "that differ from row"),
    (KeepsGenerator, "same-seed", "with the same seed in this process, got"),
    (KeepsDeviate, "same-seed", "in 6 dimensions before and after a run in 1 dimensions of 3 evaluations, got"),
    (KeepsDimension, "new-process", "with the same seed in this process and in a new one ("),
    (LeavesAfterError, "leaves-no-trace", "np.geterr() to be unchanged after a run whose problem raises"),
    (Threads, "leaves-no-trace", "every evaluation to come from the thread that called minimize"),
    (HashOrder, "new-process", "expected identical traces with the same seed in this process and in a new one"),
    (
        FixedSeed,
        "other-seed",
        "different points with a different seed, because info.stochastic is true, got the same points",
    ),
    (
        SecretlyRandom,
        "other-seed",
        "the same points with every seed, because info.stochastic is false, got different points",
    ),
    (WritesBounds, "inputs-unchanged", "expected a run that reads the problem's arrays but changes none of them, got"),
    (UnlocksBounds, "inputs-unchanged", "the meter's lower bounds to be unchanged"),
    (StoresStateOnItself, "inputs-unchanged", "the options {'runs': 1} to be unchanged, got {'runs': 2}"),
    (Idle, "budget", "returned without evaluating a point"),
    (Bypass, "budget", "the same number of evaluations, at most 1, got 1 in the meter and 11 in the problem"),
    (Hoarder, "budget-in-seconds", "for which problem.remaining is very large, got failed"),
    (Fragile, "nan-plateau", "FloatingPointError: infinite value"),
    (Flat, "constant", "ZeroDivisionError"),
    (PlaneOnly, "dimensions", "status ok in 5 dimensions, got failed: IndexError: no third axis"),
    (Centre, "finds-minimum", "of its range in 40000 evaluations, got"),
    (AbsoluteSteps, "any-box", "measure steps and tolerances relative to the width of the box"),
    (Warns, "quiet", "RuntimeWarning: step size guessed"),
    (Talks, "quiet", "starting the search"),
    (Holds, "released", "every problem to be freed after its run, got 3 of 3 problems"),
    (Undocumented, "described", "a docstring that explains every option, got no entry for temperature"),
]


@pytest.mark.parametrize(("cls", "check", "message"), CAUGHT)
def test_the_check_fails_with_the_reason(cls, check, message):
    forget()
    (result,) = solver_checks(cls(), only=[check])
    assert not result.passed
    assert message in result.message
    assert result.message.endswith(".")


def test_every_check_fails_for_some_solver():
    assert {check for _, check, _ in CAUGHT} == set(check_names())


def test_a_good_solver_passes_every_check():
    results = list(solver_checks(Good()))
    assert results == [CheckResult(name, True, "") for name in check_names()]
    check_solver(Good())


def test_one_failure_does_not_cause_others():
    """A rule that a solver breaks makes only the check of that rule fail."""
    failed = {r.name for r in solver_checks(Warns()) if not r.passed}
    assert failed == {"quiet"}
    failed = {r.name for r in solver_checks(GlobalSeed(), only=[n for n in check_names() if n != "new-process"])}
    assert failed == {n for n in check_names() if n != "new-process"}


def test_the_assertion_lists_every_failure():
    with pytest.raises(AssertionError) as caught:
        check_solver(Idle(), only=["described", "budget", "constant"])
    lines = str(caught.value).splitlines()
    assert lines[0] == "Idle fails 2 check(s):"
    assert [line.split(":")[0].strip() for line in lines[1:]] == ["budget", "constant"]


def test_declining_a_dimension_passes_with_the_reason():
    results = {result.name: result for result in solver_checks(Declines())}
    assert all(result.passed for result in results.values())
    assert "declines dimension 5 (needs 2 unknowns, got 5)" in results["dimensions"].message
    assert "needs 2 unknowns, got 5" in results["finds-minimum"].message


def test_the_global_random_states_are_restored():
    states = random.getstate(), np.random.get_state()[1].tolist()  # noqa: NPY002
    list(solver_checks(GlobalDraws(), only=["same-seed", "global-random-untouched"]))
    assert random.getstate() == states[0]
    assert np.random.get_state()[1].tolist() == states[1]  # noqa: NPY002


def test_a_solver_from_a_plugin_file_is_loaded_in_a_new_process(tmp_path):
    import importlib.util

    file = tmp_path / "my solver.py"
    file.write_text(
        textwrap.dedent(
            '''
            from dataclasses import dataclass
            from typing import ClassVar
            from nfbench import Solver, SolverInfo

            @dataclass(frozen=True)
            class Mine(Solver):
                """Uniform points.

                batch: number of points per evaluation call.
                """

                batch: int = 5
                info: ClassVar[SolverInfo] = SolverInfo(converges=False)

                def minimize(self, problem, rng):
                    while True:
                        problem.evaluate(problem.from_unit(rng.random((self.batch, problem.dimension))))
            '''
        )
    )
    spec = importlib.util.spec_from_file_location("some_plugin_module", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
        (result,) = solver_checks(module.Mine(batch=7), only=["new-process"])
    finally:
        del sys.modules[spec.name]
    assert result == CheckResult("new-process", True, "")


def test_a_solver_that_another_process_cannot_import_fails_with_a_hint():
    @dataclass(frozen=True)
    class Local(Good):
        """Is defined in a function."""

    (result,) = solver_checks(Local(), only=["new-process"])
    assert not result.passed
    assert "Define the class at the top level of a file." in result.message


def test_an_unknown_check_is_an_error():
    with pytest.raises(ValueError, match=r"expected names of checks \(described, budget, .*got speed"):
        list(solver_checks(Good(), only=["speed"]))


@pytest.mark.parametrize("shape", ["bowl", "flat", "falling", "rising"])
def test_the_gradient_of_the_probe_agrees_with_central_differences(shape):
    probe = Probe(np.array([-1.0, 2.0]), np.array([1.0, 7.0]), shape, gradient=True)
    x = np.array([0.3, 4.0])
    value, gradient = probe.value_and_gradient(x)
    h = 1e-6 * np.eye(2)
    np.testing.assert_allclose(gradient, (probe.evaluate(x + h) - probe.evaluate(x - h)) / 2e-6, atol=1e-8)
    assert value == probe.evaluate(x[None, :])[0]


def test_the_range_of_the_probe_covers_its_values():
    probe = Probe(np.array([-1.0, 2.0]), np.array([1.0, 7.0]))
    values = probe.evaluate(np.random.default_rng(0).uniform(probe.lower, probe.upper, (20_000, 2)))
    assert values.min() < 1e-3
    assert 0.9 * probe.range < values.max() <= probe.range
    assert probe.value(probe.lower + probe.centre * (probe.upper - probe.lower)) < 1e-30
