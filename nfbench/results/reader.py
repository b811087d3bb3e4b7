"""What conclusions need to read from a results folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from .rows import TracedRun

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Reader"]


class Reader(Protocol):
    """A results folder, as ``Results`` reads it."""

    @property
    def folder(self) -> Path:
        """The results folder."""

    @property
    def runs(self) -> pd.DataFrame:
        """One row per finished run, in the study's order."""

    @property
    def references(self) -> pd.DataFrame:
        """One row per finished proof of an optimum."""

    @property
    def meta(self) -> dict[str, str]:
        """The properties of the study, as text."""

    def traced_runs(self, lenient: bool = False, only: Sequence[str] | None = None) -> Iterator[TracedRun]:
        """Yield every finished run with its method and traces, in order; if lenient, also those with damaged traces.

        only: identifiers of runs; only these are read, in this order.
        """
