"""Timing of calls, in turn or by themselves."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

ROUNDS = 31


def seconds(call: Callable[[], object], number: int) -> float:
    """The mean time of a call [s]."""
    start = time.perf_counter()
    for _ in range(number):
        call()
    return (time.perf_counter() - start) / number


def in_turn(calls: list[Callable[[], object]], numbers: list[int], rounds: int = ROUNDS) -> list[list[float]]:
    """Times [s] of each call, one list a call, one entry a round."""
    timed = [[seconds(c, n) for c, n in zip(calls, numbers, strict=True)] for _ in range(rounds)]
    return [list(times) for times in zip(*timed, strict=True)]


def ratio(slow: list[float], fast: list[float]) -> float:
    """The median over rounds of how many times faster."""
    return statistics.median(s / f for s, f in zip(slow, fast, strict=True))


def best_seconds(call: Callable[[], object], rounds: int = 7, least: float = 0.01) -> float:
    """The time of a call [s]: the least of several means, each over ``least`` seconds or more."""
    number = max(1, int(least / max(seconds(call, 1), 1e-9)))
    return min(seconds(call, number) for _ in range(rounds))
