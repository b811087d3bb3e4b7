"""Progress of a running study: a live view in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from types import TracebackType
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from nfbench.core import Status, printable
from nfbench.study import RunRecord, RunSpec

from .forecast import Forecast, rough_duration

__all__ = ["Lines", "LiveView", "Quiet"]

LINE_EVERY_S = 10.0
LEADERS = 3
STOPPING = "Finishing the current runs; press Ctrl-C again to stop at once."


class Quiet:
    """Prints nothing."""

    def begin(self, total: int, done: int) -> None: ...

    def finished(self, spec: RunSpec, record: RunRecord) -> None: ...

    def stopping(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...


class _Tally:
    """Counts the runs that are not ok, and ranks the methods by their mean square error so far."""

    def __init__(self, error: str) -> None:
        self._error = error
        self._bad: dict[str, int] = defaultdict(int)
        self._squares: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])

    def add(self, spec: RunSpec, record: RunRecord) -> None:
        if record.status is not Status.OK:
            self._bad[record.status] += 1
        elif spec.asks == "estimate" and not math.isnan(record.scores.get(self._error, math.nan)):
            square, error = self._squares[spec.method.label], record.scores[self._error]
            square[0] += error * error  # of a huge error this is inf, where a power would raise OverflowError
            square[1] += 1

    @property
    def bad(self) -> str:
        """The runs that are not ok, e.g. ``3 failed, 1 timeout``; empty if there are none."""
        return ", ".join(f"{count} {status}" for status, count in self._bad.items())

    @property
    def leaders(self) -> str:
        """The methods with the lowest error, over all scenario points of this session."""
        means = {method: math.sqrt(total / count) for method, (total, count) in self._squares.items()}
        best = sorted(means, key=means.__getitem__)[:LEADERS]
        return printable(", ".join(f"{method} {means[method]:.3g}" for method in best))


class LiveView:
    """Shows runs done, rate, time left, failures and the leading methods so far in a terminal."""

    def __init__(self, console: Console, error: str, what: str = "runs", forecast: Forecast | None = None) -> None:
        self._what, self._console, self._forecast = what, console, forecast
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
        )
        self._tally = _Tally(error)
        self._name = printable(error)
        self._note = Text()
        self._live = Live(Group(self._bar, self._note), console=console, refresh_per_second=4)
        self._done = 0
        self._start = time.monotonic()

    def begin(self, total: int, done: int) -> None:
        self._start = time.monotonic()
        if self._forecast:
            self._forecast.begin(total - done)
        self._task = self._bar.add_task(self._what, total=total, completed=done, rate="", left="")

    def finished(self, spec: RunSpec, record: RunRecord) -> None:
        self._done += 1
        self._tally.add(spec, record)
        now = time.monotonic()
        rate, left = f"{self._done / (now - self._start):.3g}/s", ""
        if self._forecast:
            self._forecast.add(spec, record)
            left = f"{rough_duration(self._forecast.left_s(now))} left"
            if sentence := self._forecast.sentence(now):
                self._console.print(sentence, markup=False)
        self._bar.update(self._task, advance=1, rate=rate, left=left)
        self._note.plain = "\n".join(
            line
            for line in (
                self._tally.leaders and f"lowest {self._name} so far: {self._tally.leaders}",
                self._tally.bad and f"not ok: {self._tally.bad}",
            )
            if line
        )

    def stopping(self) -> None:
        self._bar.update(self._task, description=STOPPING)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._note.plain = ""
        self._live.stop()


class Lines:
    """Prints a plain line every ten seconds and at the end, for logs and pipes."""

    def __init__(self, console: Console, error: str, what: str = "runs", forecast: Forecast | None = None) -> None:
        self._what, self._forecast = what, forecast
        self._console = console
        self._tally = _Tally(error)
        self._start = self._last = time.monotonic()
        self._total = self._done = self._before = 0

    def begin(self, total: int, done: int) -> None:
        self._total, self._done, self._before = total, done, done
        self._start = self._last = time.monotonic()
        if self._forecast:
            self._forecast.begin(total - done)
        before = f"{done} of {total} {self._what} are already done; " if done else ""
        self._console.print(f"{before}{self._what} to do: {total - done}")

    def finished(self, spec: RunSpec, record: RunRecord) -> None:
        self._done += 1
        self._tally.add(spec, record)
        now = time.monotonic()
        if self._forecast:
            self._forecast.add(spec, record)
            if sentence := self._forecast.sentence(now):
                self._console.print(sentence, markup=False)
        if now - self._last >= LINE_EVERY_S or self._done == self._total:
            self._last = now
            elapsed = now - self._start
            left = elapsed / (self._done - self._before) * (self._total - self._done)
            left = self._forecast.left_s(now) if self._forecast else left
            bad = f", not ok: {self._tally.bad}" if self._tally.bad else ""
            self._console.print(
                f"{self._done} of {self._total} {self._what} done, {elapsed:.0f} s elapsed, {left:.0f} s left{bad}"
            )

    def stopping(self) -> None:
        self._console.print(STOPPING)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...
