"""Handles Ctrl-C and SIGTERM: the first stops after the current runs, the second stops at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

__all__ = ["Interrupts"]


class Interrupts:
    """A context manager that catches SIGINT and SIGTERM; calling it returns whether one was received.

    The first signal calls ``on_first``; the second raises KeyboardInterrupt. Only the main thread of a program can
    catch signals; in other threads, the result is always False.

    on_first: function without arguments, called from the signal handler.
    """

    def __init__(self, on_first: Callable[[], None] = lambda: None) -> None:
        self._requested = False
        self._on_first = on_first
        self._before: dict[int, Any] = {}

    def __call__(self) -> bool:
        return self._requested

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._caught) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _caught(self, number: int, frame: FrameType | None) -> None:
        if self._requested:
            raise KeyboardInterrupt
        self._requested = True
        self._on_first()
