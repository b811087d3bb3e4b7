"""What can go wrong, one class a cause. Every message names the argument, what was expected and what came."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from pathlib import Path


class NfbenchError(Exception):
    """The base of every error nfbench raises for its user."""


class OptionError(NfbenchError, ValueError):
    """One or more options are unknown, of a wrong type, or impossible.

    ``problems`` holds ``(path, message)`` pairs, e.g. ``("population", "expected at least 4, got 2")``.
    """

    def __init__(self, owner: str, problems: Iterable[tuple[str, str]]) -> None:
        self.owner = owner
        self.problems = list(problems)
        super().__init__("; ".join(f"{owner}: {path}: {text}" for path, text in self.problems))


class ManifestError(NfbenchError):
    """A manifest cannot be used; ``problems`` lists every error as ``path: message``."""

    def __init__(self, source: str, problems: Iterable[str]) -> None:
        self.source = source
        self.problems = list(problems)
        super().__init__("\n".join([f"{source}:", *(f"  {text}" for text in self.problems)]))


class PluginError(NfbenchError):
    """A plugin is unknown, failed to import, or claims a name that is taken."""


class MissingExtra(PluginError):
    """A plugin is registered, but a library it needs is not installed; the message says how to install it."""


class StoreError(NfbenchError):
    """A results folder cannot be read or written, or belongs to another study."""


class Incompatible(NfbenchError):
    """This pair cannot work together (a reason, not a failure): the run becomes a ``skipped`` row."""


class InvalidEvaluation(NfbenchError, ValueError):
    """A solver asked for a point outside the box, or a point or value had a wrong shape: the run is ``invalid``."""


class BudgetExhausted(BaseException):
    """The next evaluation would exceed the budget, or the target is reached: the solver ends here.

    Derives from BaseException, like KeyboardInterrupt, so that an ``except Exception`` inside a wrapped
    library cannot swallow it. It is how every run that uses its whole budget ends, and no failure.
    """


def explain(error: BaseException) -> str:
    """An exception in one line: its type, its text, and the file and line it came from."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"
