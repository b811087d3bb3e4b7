"""The exceptions of nfbench, one class per cause.

Every message names the argument, the expected value and the actual value.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from pathlib import Path

from .text import printable

SHOWN = 50  # errors in one message; the others are counted
LONGEST = 2000  # bytes of one error


class NfbenchError(Exception):
    """Base class of the errors that nfbench reports to its users."""


class OptionError(NfbenchError, ValueError):
    """One or more options are unknown, missing, of the wrong type, or out of range.

    ``problems`` holds ``(path, message)`` pairs, e.g. ``("population", "expected at least 4, got 2")``.
    """

    def __init__(self, owner: str, problems: Iterable[tuple[str, str]]) -> None:
        self.owner = owner
        self.problems = list(problems)
        super().__init__("; ".join(self.lines()))

    def lines(self) -> list[str]:
        """Return the errors, one per line; the first 50 of them, and the number of the others."""
        named = (": ".join(filter(None, [self.owner, path, text])) for path, text in self.problems)
        return _first(named)


class ManifestError(NfbenchError):
    """A manifest is invalid; ``problems`` lists every error as ``path: message``.

    The message shows the first 50 of them and the number of the others.
    """

    def __init__(self, source: str, problems: Iterable[str]) -> None:
        self.source = source
        self.problems = [_one_line(text) for text in problems]
        super().__init__("\n".join([f"{_one_line(source)}:", *(f"  {text}" for text in _first(self.problems))]))


class PluginError(NfbenchError):
    """A plugin is unknown, failed to import, or has the same name as another plugin."""


class MissingExtra(PluginError):
    """A registered plugin needs a library that is not installed; the message says how to install it."""


class StoreError(NfbenchError):
    """A results folder cannot be read or written, or belongs to another study."""


class Incompatible(NfbenchError):
    """A combination, such as a solver and a problem, cannot work; the message gives the reason.

    This is not a failure: the run is stored as a row with the status ``skipped``.
    """


class InvalidEvaluation(NfbenchError, ValueError):
    """A solver evaluated a point outside the box, or a point or a value had the wrong shape.

    The run gets the status ``invalid``.
    """


class BudgetExhausted(BaseException):
    """Stops a solver because the next evaluation would exceed the budget, or because the target has been reached.

    It derives from BaseException, like KeyboardInterrupt, so that an ``except Exception`` in a wrapped library cannot
    swallow it. Every run that uses its whole budget ends with this exception; it does not indicate a failure.
    """


def explain(error: BaseException) -> str:
    """Describe an exception in one line: its type, its message, and the file and line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {message_of(error)}{where}"


def message_of(error: BaseException) -> str:
    """The message of an exception, also of one whose own ``__str__`` fails."""
    try:
        return str(error)
    except Exception:
        return "(its message cannot be read)"


def _first(texts: Iterable[str]) -> list[str]:
    """Return the first texts, each in one line, and how many more there are."""
    lines = list(texts)
    shown = [_one_line(text) for text in lines[:SHOWN]]
    left = len(lines) - SHOWN
    return shown if left <= 0 else [*shown, f"… and {left:,} more (the first {SHOWN} of {len(lines):,} are shown)"]


def _one_line(text: str) -> str:
    return text if len(text) <= LONGEST and text.isprintable() else printable(text, LONGEST)
