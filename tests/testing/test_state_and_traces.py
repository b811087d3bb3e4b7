"""Runs that depend on the runs before them, and runs that change their process, are found; their opposites pass."""

import pytest
from leaving_solvers import (
    ACTIONS,
    KeepsAfterError,
    KeepsDeviate,
    KeepsDimension,
    KeepsGenerator,
    Leaves,
    LeavesAfterError,
    Restores,
    Threads,
    forget,
)

from nfbench.testing import CheckResult, solver_checks


def result(solver, check):
    (found,) = solver_checks(solver, only=[check])
    return found


@pytest.mark.parametrize(
    ("cls", "where"),
    [
        (KeepsGenerator, "in this process"),
        (KeepsDeviate, "in 6 dimensions before and after a run in 1 dimensions of 3 evaluations"),
        (KeepsDimension, "in 3 dimensions before and after a run in 1 dimensions of 3 evaluations"),
        (KeepsAfterError, "in 3 dimensions before and after a run in 2 dimensions of 17 evaluations, which a Broken"),
    ],
)
def test_state_that_survives_a_run_is_found(cls, where):
    forget()
    found = result(cls(), "same-seed")
    assert not found.passed
    assert f"with the same seed {where}" in found.message
    assert found.message.endswith("must be reset at the start of minimize.")


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(number, id=name.split()[-1], marks=[pytest.mark.slow] * (number % 2))
        for number, name in enumerate(ACTIONS.values())
    ],
)
def test_a_trace_is_found_and_named(number):
    found = result(Leaves(number), "leaves-no-trace")
    assert not found.passed
    assert found.message.startswith("expected ") and list(ACTIONS.values())[number] in found.message
    assert found.message.endswith(".")


def test_a_trace_that_only_an_exception_leaves_is_found():
    found = result(LeavesAfterError(), "leaves-no-trace")
    assert "np.geterr() to be unchanged after a run whose problem raises" in found.message


def test_evaluations_in_threads_are_found():
    found = result(Threads(), "leaves-no-trace")
    assert "every evaluation to come from the thread that called minimize" in found.message


def test_a_solver_that_restores_everything_leaves_no_trace():
    assert result(Restores(), "leaves-no-trace") == CheckResult("leaves-no-trace", True, "")
