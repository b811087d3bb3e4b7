"""Progress of a running study: a live bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .budget import Status
from .execute import RunRecord

__all__ = ["Bar", "Lines", "Quiet"]

LINE_EVERY_S = 10.0


class Quiet:
    """Says nothing."""

    def begin(self, total: int, done: int) -> None: ...

    def finished(self, record: RunRecord) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...


class Bar:
    """A live bar with runs done, time left and failures, for terminals."""

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[bad]}"),
            console=console,
        )
        self._bad = 0

    def begin(self, total: int, done: int) -> None:
        self._task = self._progress.add_task("runs", total=total, completed=done, bad="")

    def finished(self, record: RunRecord) -> None:
        self._bad += record.status is not Status.OK
        bad = f"[red]{self._bad} not ok[/red]" if self._bad else ""
        self._progress.update(self._task, advance=1, bad=bad)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()


class Lines:
    """A plain line every ten seconds and at the end, for logs and pipes."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._start = self._last = time.monotonic()
        self._total = self._done = self._before = self._bad = 0

    def begin(self, total: int, done: int) -> None:
        self._total, self._done, self._before = total, done, done
        self._console.print(f"{done} of {total} runs were done before" if done else f"{total} runs to do")

    def finished(self, record: RunRecord) -> None:
        self._done += 1
        self._bad += record.status is not Status.OK
        now = time.monotonic()
        if now - self._last >= LINE_EVERY_S or self._done == self._total:
            self._last = now
            elapsed = now - self._start
            left = elapsed / (self._done - self._before) * (self._total - self._done)
            bad = f", {self._bad} not ok" if self._bad else ""
            self._console.print(f"{self._done} of {self._total} runs, {elapsed:.0f} s, {left:.0f} s left{bad}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...
