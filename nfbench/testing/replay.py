"""Repeat runs in this process, with other runs in between, and in a new one; they must agree to the last bit."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Iterator

import numpy as np
from numpy import ndarray

from nfbench.core import Incompatible, Solver

from .subject import Broken, Subject, ended_ok, need

__all__ = ["Replay", "cases_of", "compare_before_and_after_other_runs", "replays", "replays_of", "same"]

Replay = tuple[str, list[ndarray]]

EVALUATIONS = 500
OTHER_CASES = ((3, 61), (6, 62))  # (dimension, evaluations), repeated in addition to the subject's own dimension
INTERLUDES = (  # (dimension, evaluations, seed, number of the evaluation that raises, its exception)
    (1, 3, 1, None, None),
    (3, 1, 2, None, None),
    (5, 33, 3, None, None),
    (2, 200, 4, 17, Broken),
    (7, 200, 5, 101, KeyboardInterrupt),
)


def replay(subject: Subject, n: int, evaluations: int = EVALUATIONS) -> Replay:
    """Run the solver and return what must repeat: the digest of all points, and the trace without its times."""
    probe = subject.probe(n)
    outcome = subject.run(probe, evaluations, seed=7)
    ended_ok(outcome, "on the bowl")
    trace = outcome.minimum.trace
    return probe.digest, [trace.evaluations, trace.values, trace.points]


def replays(subject: Subject, cases: list[tuple[int, int]]) -> dict[tuple[int, int], Replay]:
    """Return the replay of each case (dimension, evaluations), without the dimensions that the solver declines."""
    found = {}
    for n, evaluations in cases:
        with contextlib.suppress(Incompatible):
            found[n, evaluations] = replay(subject, n, evaluations)
    return found


def replays_of(load: Callable[[], Solver], cases: list[tuple[int, int]]) -> dict[tuple[int, int], Replay]:
    """Return the replays of the solver that ``load`` returns; runs in a new interpreter."""
    return replays(Subject(load()), cases)


def cases_of(subject: Subject) -> list[tuple[int, int]]:
    """Return the cases (dimension, evaluations) to repeat."""
    return [(subject.dimension, EVALUATIONS), *OTHER_CASES]


def other_runs(subject: Subject) -> Iterator[str]:
    """Make other runs, one per step, and yield what each was.

    They have other dimensions, seeds and states of the global generators, and numbers of evaluations after which a
    library may keep the second one of a pair of normal deviates. Some are ended by an exception.
    """
    for n, evaluations, seed, raise_at, error in INTERLUDES:
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        what = f"a run in {n} dimensions of {evaluations if raise_at is None else raise_at} evaluations"
        with contextlib.suppress(KeyboardInterrupt):
            subject.run(subject.probe(n, stop=error, stop_at=raise_at or 0), evaluations, seed)
        yield what if error is None else f"{what}, which a {error.__name__} ended"


def compare_before_and_after_other_runs(subject: Subject) -> None:
    """Fail unless runs with the same seed are identical before and after other runs in this process."""
    repeated = []
    for global_seed in (1, 2):  # the state of the global generators must not matter
        random.seed(global_seed)
        np.random.seed(global_seed)  # noqa: NPY002
        repeated.append(replay(subject, subject.dimension))
    same(repeated[0], repeated[1], "in this process", _KEEP_NO_STATE)
    first = replays(subject, cases_of(subject)[1:])
    order = list(first)
    for other in other_runs(subject):
        order.reverse()  # so that the runs that precede a case vary more
        for case, again in replays(subject, order).items():
            same(first[case], again, f"in {case[0]} dimensions before and after {other}", _KEEP_NO_STATE)


_KEEP_NO_STATE = (
    "Draw random numbers only from the generator passed to minimize, and keep no state on the solver or in its module. "
    "A library with hidden state, such as a generator of its own or the second one of a pair of normal deviates, must "
    "be reset at the start of minimize."
)


def same(first: Replay, second: Replay, where: str, remedy: str) -> None:
    """Fail unless both replays are identical; ``where`` and ``remedy`` complete the message."""
    for name, a, b in zip(("evaluations", "values", "points"), first[1], second[1], strict=True):
        rows = min(len(a), len(b))
        differ = np.flatnonzero((a[:rows] != b[:rows]).reshape(rows, -1).any(axis=1))
        row = int(differ[0]) if len(differ) else rows
        need(
            not len(differ) and len(a) == len(b),
            f"identical traces with the same seed {where}",
            f"{name} that differ from row {row} on: {a[row : row + 1].tolist()} and {b[row : row + 1].tolist()}",
            remedy,
        )
    need(first[0] == second[0], f"identical points with the same seed {where}", "points that differ", remedy)
