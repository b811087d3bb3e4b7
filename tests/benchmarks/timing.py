"""Timing of single calls, and of several calls alternately."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

ROUNDS = 31


def seconds(call: Callable[[], object], number: int) -> float:
    """Return the mean time of ``number`` calls [s]."""
    start = time.perf_counter()
    for _ in range(number):
        call()
    return (time.perf_counter() - start) / number


def in_turn(calls: list[Callable[[], object]], numbers: list[int], rounds: int = ROUNDS) -> list[list[float]]:
    """Return the times [s] of calls made alternately: one list per call, with one entry per round."""
    timed = [[seconds(c, n) for c, n in zip(calls, numbers, strict=True)] for _ in range(rounds)]
    return [list(times) for times in zip(*timed, strict=True)]


def ratio(slow: list[float], fast: list[float]) -> float:
    """Return the median over rounds of the ratio of two times."""
    return statistics.median(s / f for s, f in zip(slow, fast, strict=True))


def best_seconds(call: Callable[[], object], rounds: int = 7, least: float = 0.01) -> float:
    """Return the time of a call [s]: the smallest of several means, each over at least ``least`` seconds."""
    number = max(1, int(least / max(seconds(call, 1), 1e-9)))
    return min(seconds(call, number) for _ in range(rounds))
