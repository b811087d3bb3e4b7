"""Ctrl-C and SIGTERM: once to finish what is running and stop, twice to stop now."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

__all__ = ["Interrupts"]


class Interrupts:
    """While entered, the first SIGINT or SIGTERM makes this true when called; the second raises KeyboardInterrupt.

    ``told`` is called at the first.

    Only a program's main thread can catch signals; elsewhere this stays false.
    """

    def __init__(self, told: Callable[[], None] = lambda: None) -> None:
        self._requested = False
        self._told = told
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
        self._told()
