"""Solvers that each break one rule: the check of that rule, and no unrelated one, must fail and say why."""

import random
import sys
import textwrap
import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from nfbench import BudgetExhausted, Incompatible, Solver, SolverInfo
from nfbench.testing import CheckResult, Probe, check_names, check_solver, solver_checks


def sample(problem, rng, lower=0.0, upper=1.0):
    """Shrinking random search, good enough for every check."""
    centre, radius = np.full(problem.dimension, 0.5), 0.5
    while True:
        U = np.clip(centre + radius * rng.uniform(-1, 1, (20, problem.dimension)), 0, 1)
        U[0] = centre
        values = problem.evaluate(problem.from_unit(U))
        centre = U[np.argmin(values)]
        radius = max(radius * (0.97 if values.argmin() == 0 else 1.0), 1e-6)


@dataclass(frozen=True)
class Good(Solver):
    """Keeps every rule."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, rng)


@dataclass(frozen=True)
class Outside(Solver):
    """Follows a slope out of the box."""

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
    """Swallows BudgetExhausted and asks again."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        for _ in range(3):
            try:
                sample(problem, rng)
            except BaseException:
                continue


@dataclass(frozen=True)
class Polite(Solver):
    """Swallows BudgetExhausted and returns."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        try:
            sample(problem, rng)
        except BudgetExhausted:
            return


@dataclass(frozen=True)
class Soothing(Solver):
    """Takes an error of the problem for its own end."""

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
    """Seeds both global generators, reproducibly."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        random.seed(int(rng.integers(1000)))
        while True:
            problem(problem.from_unit(np.array([random.random() for _ in range(problem.dimension)])))


@dataclass(frozen=True)
class OwnEntropy(Solver):
    """Ignores its generator for one that the operating system seeds."""

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
    """Says it is stochastic, and draws the same numbers whatever the seed."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, np.random.default_rng(0))


@dataclass(frozen=True)
class SecretlyRandom(Solver):
    """Says it is deterministic, and is not."""

    info: ClassVar[SolverInfo] = SolverInfo(stochastic=False, converges=False)

    def minimize(self, problem, rng):
        sample(problem, rng)


@dataclass(frozen=True)
class WritesBounds(Solver):
    """Shifts the bounds it was given."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        lower = problem.lower
        lower -= 1.0
        sample(problem, rng)


@dataclass(frozen=True)
class UnlocksBounds(Solver):
    """Shrinks the box to where it wants to search."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        problem.lower.flags.writeable = True
        problem.lower += 1e-3 * (problem.upper - problem.lower)
        sample(problem, rng)


@dataclass(frozen=True)
class RemembersOnItself(Solver):
    """Keeps state among its options.

    runs: how often it ran.
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
    """Evaluates behind the meter's back."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        problem._problem.evaluate(problem.from_unit(rng.random((10, problem.dimension))))
        sample(problem, rng)


@dataclass(frozen=True)
class Hoarder(Solver):
    """Plans for every evaluation the budget allows."""

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
    """Divides by the spread of the values."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        while True:
            values = problem.evaluate(problem.from_unit(rng.random((20, problem.dimension))))
            1.0 / float(np.ptp(values[values < np.inf]))


@dataclass(frozen=True)
class PlaneOnly(Solver):
    """Breaks beyond two dimensions instead of declining."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        if problem.dimension > 2:
            raise IndexError("no third axis")
        sample(problem, rng)


@dataclass(frozen=True)
class Declines(Solver):
    """Says that it works in two dimensions alone."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        if problem.dimension != 2:
            raise Incompatible(f"needs 2 unknowns, got {problem.dimension}")
        sample(problem, rng)


@dataclass(frozen=True)
class Centre(Solver):
    """Promises a global search and looks at one point."""

    info: ClassVar[SolverInfo] = SolverInfo(stochastic=False, converges=False)

    def minimize(self, problem, rng):
        problem(0.5 * (problem.lower + problem.upper))


@dataclass(frozen=True)
class AbsoluteSteps(Solver):
    """Walks in steps of an absolute length, which suits some boxes only."""

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
        print("here we go")
        sample(problem, rng)


@dataclass(frozen=True)
class Undocumented(Solver):
    """Has an option and does not say what it is."""

    temperature: float = 1.0

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        sample(problem, rng)


HELD = []


@dataclass(frozen=True)
class Holds(Solver):
    """Keeps every problem it has met."""

    info: ClassVar[SolverInfo] = SolverInfo(converges=False)

    def minimize(self, problem, rng):
        HELD.append(problem)
        sample(problem, rng)


CAUGHT = [
    (Outside, "bounds", "expected every point within the box, even where the minimum is in its corner, got x["),
    (Deaf, "stops-when-told", "raised at evaluation 1, to leave minimize at once, got 2 further requests"),
    (Polite, "stops-when-told", "got 0 further requests, and minimize returned"),
    (Soothing, "errors-pass", "a problem that raises at evaluation 300 to end the run as failed, got status ok"),
    (GlobalDraws, "same-seed", "expected identical traces from one seed in this process"),
    (GlobalDraws, "global-random-untouched", "the global state of np.random to be left alone"),
    (GlobalSeed, "global-random-untouched", "the global state of random to be left alone"),
    (OwnEntropy, "same-seed", "that differ from row"),
    (HashOrder, "new-process", "expected identical traces from one seed in this and in a new process"),
    (FixedSeed, "other-seed", "other points with another seed, info.stochastic being true, got the same points"),
    (SecretlyRandom, "other-seed", "the same points whatever the seed, info.stochastic being false, got other points"),
    (WritesBounds, "inputs-unchanged", "expected a run that reads the problem's arrays and changes none, got"),
    (UnlocksBounds, "inputs-unchanged", "the meter's lower to stay as it was"),
    (RemembersOnItself, "inputs-unchanged", "got {'runs': 2}"),
    (Idle, "budget", "returned without evaluating a point"),
    (Bypass, "budget", "to count the same, at most 1, got 1 by the meter and 11 by the problem"),
    (Hoarder, "budget-in-seconds", "where problem.remaining is huge, got failed"),
    (Fragile, "nan-plateau", "FloatingPointError: infinite value"),
    (Flat, "constant", "ZeroDivisionError"),
    (PlaneOnly, "dimensions", "status ok in 5 dimensions, got failed: IndexError: no third axis"),
    (Centre, "finds-minimum", "of its range within 40000 evaluations"),
    (AbsoluteSteps, "any-box", "measure steps and tolerances in widths of the box"),
    (Warns, "quiet", "RuntimeWarning: step size guessed"),
    (Talks, "quiet", "here we go"),
    (Holds, "released", "problems to be freed when their runs are over, got 3 of 3"),
    (Undocumented, "described", "a docstring that explains every option, got nothing on temperature"),
]


@pytest.mark.parametrize(("cls", "check", "message"), CAUGHT)
def test_the_check_fails_and_says_why(cls, check, message):
    (result,) = solver_checks(cls(), only=[check])
    assert not result.passed
    assert message in result.message
    assert result.message.endswith(".")


def test_every_check_is_proven_able_to_fail():
    assert {check for _, check, _ in CAUGHT} == set(check_names())


def test_a_good_solver_passes_them_all():
    results = list(solver_checks(Good()))
    assert results == [CheckResult(name, True, "") for name in check_names()]
    check_solver(Good())


def test_failures_stay_apart():
    """What one check finds does not make the others fail."""
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


def test_the_global_random_states_are_left_as_they_were():
    states = random.getstate(), np.random.get_state()[1].tolist()  # noqa: NPY002
    list(solver_checks(GlobalDraws(), only=["same-seed", "global-random-untouched"]))
    assert random.getstate() == states[0]
    assert np.random.get_state()[1].tolist() == states[1]  # noqa: NPY002


def test_a_solver_of_a_plugin_file_is_found_again_in_a_new_process(tmp_path):
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

                batch: points at a time.
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


def test_a_solver_that_no_other_process_can_import_is_told_so():
    @dataclass(frozen=True)
    class Local(Good):
        """Lives in a function."""

    (result,) = solver_checks(Local(), only=["new-process"])
    assert not result.passed
    assert "Define the class at the top level of a file." in result.message


def test_an_unknown_check_is_named():
    with pytest.raises(ValueError, match=r"expected names of checks \(described, budget, .*got speed"):
        list(solver_checks(Good(), only=["speed"]))


@pytest.mark.parametrize("shape", ["bowl", "flat", "falling", "rising"])
def test_the_probes_gradient_is_that_of_differences(shape):
    probe = Probe(np.array([-1.0, 2.0]), np.array([1.0, 7.0]), shape, gradient=True)
    x = np.array([0.3, 4.0])
    value, gradient = probe.value_and_gradient(x)
    h = 1e-6 * np.eye(2)
    np.testing.assert_allclose(gradient, (probe.evaluate(x + h) - probe.evaluate(x - h)) / 2e-6, atol=1e-8)
    assert value == probe.evaluate(x[None, :])[0]


def test_the_probes_range_spans_its_values():
    probe = Probe(np.array([-1.0, 2.0]), np.array([1.0, 7.0]))
    values = probe.evaluate(np.random.default_rng(0).uniform(probe.lower, probe.upper, (20_000, 2)))
    assert values.min() < 1e-3
    assert 0.9 * probe.range < values.max() <= probe.range
    assert probe.value(probe.lower + probe.centre * (probe.upper - probe.lower)) < 1e-30
