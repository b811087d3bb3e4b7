"""Reads a study's results folder as pandas tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nfbench.core import Trace

from .cells import csv_frame
from .damage import guarded
from .folder import write_whole
from .rows import TracedRun
from .store import ORIGIN_COLUMNS, Store

if TYPE_CHECKING:  # pandas is slow to import, and counting runs does not need it
    import pandas as pd

    from nfbench.analysis import Axis, Ranking, Target

    from .evidence import Evidence

__all__ = ["Results"]

TABLES = ("runs", "summary", "targets", "ranking")


@dataclass(frozen=True)
class Results:
    """The results of a study. Every access reads the folder again, which also works while the study runs.

    folder: the results folder, e.g. ``results/quickstart``.

    Raises StoreError, with the file and what to do, if the folder holds no results or they are damaged.
    """

    folder: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", Path(self.folder))

    @property
    def runs(self) -> pd.DataFrame:
        """One row per finished run, in the study's order; the columns of ``runs.csv``."""
        from .frames import RunsFrame

        with Store(self.folder) as store:
            meta = store.described()
            frame = RunsFrame(meta["name"], int(meta.get("runs_per_scene", "1")))
            for row in store.runs():
                frame.add(*row)
            with guarded(store.path):
                return frame.finished()

    @property
    def origins(self) -> pd.DataFrame:
        """Where and when each run was executed: run_id, host, worker (process id), finished (UTC time)."""
        import pandas as pd

        with Store(self.folder) as store:
            frame = pd.DataFrame(store.origins(), columns=list(ORIGIN_COLUMNS))
        return frame.assign(finished=pd.to_datetime(frame["finished"].astype(float), unit="s", utc=True))

    @property
    def traces(self) -> pd.DataFrame:
        """One row per recorded improvement: run_id, problem (from 0 in a run), evaluations, seconds, value, x_0, …"""
        import pandas as pd

        frames = [
            pd.DataFrame(
                {
                    "run_id": run_id,
                    "problem": number,
                    "evaluations": trace.evaluations,
                    "seconds": trace.seconds,
                    "value": trace.values,
                    **{f"x_{j}": column for j, column in enumerate(trace.points.T)},
                }
            )
            for run_id, traces in self.run_traces()
            for number, trace in enumerate(traces)
        ]
        columns = ["run_id", "problem", "evaluations", "seconds", "value"]
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=columns)

    @property
    def positions(self) -> pd.DataFrame:
        """One row per source of each finished run, and one per surplus estimate: the columns of ``positions.csv``.

        Empty if the scenario has no positions. Runs that were made by a version without this table are missing.
        """
        from .position_table import positions_frame

        with Store(self.folder) as store:
            meta, keys = store.described(), store.swept_keys()
            rows = list(store.positions.finished())
            with guarded(store.path):
                return positions_frame(rows, keys, int(meta.get("runs_per_scene", "1")))

    @property
    def references(self) -> pd.DataFrame:
        """One row per finished proof of an optimum, in the study's order; empty in studies without ``[reference]``.

        The columns are those of ``references.csv`` without ``best_found`` and ``contradicted_by``, which need the runs;
        ``reference_table`` has them.
        """
        from .references import reference_frame

        with Store(self.folder) as store:
            rows = list(store.references.finished())
            with guarded(store.path):
                return reference_frame(rows)

    @property
    def reference_counts(self) -> dict[str, int]:
        """Number of proofs of optima by status; ``open`` counts those without a result yet."""
        with Store(self.folder) as store:
            return store.references.counts()

    @property
    def reference_failures(self) -> list[tuple[str, str, int, str]]:
        """(status, formulation, number, one of their messages) of the proofs of optima that are not ok."""
        with Store(self.folder) as store:
            return store.references.failures()

    @property
    def meta(self) -> dict[str, str]:
        """Name, seed, shard, title, expectation, error measure and outlier threshold [m] of the study, as text."""
        with Store(self.folder) as store:
            return store.described()

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by status; ``open`` counts those without a result yet."""
        with Store(self.folder) as store:
            return store.counts()

    @property
    def failures(self) -> list[tuple[str, str, int, str]]:
        """(status, method, number of runs, one of their messages) of the runs that are not ok."""
        with Store(self.folder) as store:
            return store.failures()

    @property
    def rate(self) -> float:
        """Runs finished per second, over the five minutes before the last finished run; 0 if unknown."""
        with Store(self.folder) as store:
            return store.rate()

    @property
    def swept_keys(self) -> list[str]:
        """The keys that the study sweeps, in order."""
        with Store(self.folder) as store:
            return store.swept_keys()

    def run_traces(self) -> Iterator[tuple[str, tuple[Trace, ...]]]:
        """Yield (run_id, traces) of every finished run, in order; a run has one trace per problem it minimized."""
        with Store(self.folder) as store:
            yield from store.traces()

    def traced_runs(self, lenient: bool = False, only: Sequence[str] | None = None) -> Iterator[TracedRun]:
        """Yield every finished run with its method and traces, in order. Runs are read in pages.

        lenient: whether a run whose traces are damaged is yielded without them, instead of raising StoreError.
        only: identifiers of runs; only these are read, in this order.
        """
        with Store(self.folder) as store:
            yield from store.traced_runs(lenient, only)

    def estimates(self) -> Iterator[tuple[str, Any]]:
        """Yield (run_id, estimate as nested lists) of every finished run that has an estimate, in order."""
        with Store(self.folder) as store:
            yield from store.estimates()

    def summary(self, by: Sequence[str] | None = None, outlier_m: float | None = None) -> pd.DataFrame:
        """One row per group of ``by`` (default: swept keys, formulation, solver, method); see ``summarize``."""
        return self._summary(self.evidence().table, by, outlier_m)

    @property
    def targets(self) -> tuple[Target, ...]:
        """What counts as solved: the targets of the manifest, or those that fit the scenario."""
        return self.evidence().targets

    def hits(self) -> pd.DataFrame:
        """One row per run and target: whether and when the run reached it; see ``Hits`` for the columns."""
        return self.evidence().hits.frame

    def target_table(self) -> pd.DataFrame:
        """One row per swept point, method and target: the columns of ``targets.csv``."""
        return self.evidence().target_table()

    def reference_table(self) -> pd.DataFrame:
        """One row per proof of an optimum, and whether a run contradicts it: the columns of ``references.csv``."""
        return self.evidence().references

    def contradictions(self) -> pd.DataFrame:
        """The rows of ``reference_table`` whose certified optimum is wrong: a run has found a better value."""
        references = self.references
        return self.evidence().contradictions if references["certified"].any() else references[:0]

    def ranking(self) -> Ranking:
        """The ranking of the methods at each swept point and over all of them; its frame is ``ranking.csv``."""
        return self.evidence().ranking

    def claims(self) -> pd.DataFrame:
        """One row per claim of the manifest with its verdict: the columns of ``claims.csv``; empty without claims."""
        return self.evidence().claims()

    def runtime_distribution(self, axis: Axis = "evaluations") -> pd.DataFrame:
        """The share of scenes, runs and targets that each method has reached after a cost.

        axis: the cost: "evaluations", "evaluation_equivalents" or "seconds". See ``runtime_distribution`` of
        ``nfbench.analysis`` for the columns.
        """
        from nfbench.analysis import runtime_distribution

        return runtime_distribution(self.hits(), axis)

    def evidence(self, runs: pd.DataFrame | None = None) -> Evidence:
        """What the finished runs show, with each table computed once; ``runs`` are those of this folder, if known."""
        from .evidence import Evidence

        return Evidence(self, self.runs if runs is None else runs)

    def write_tables(self) -> None:
        """Write ``runs.csv``, ``summary.csv``, ``targets.csv`` and ``ranking.csv``.

        With claims also ``claims.csv`` is written, with proofs of optima ``references.csv``, and with positions of
        sources ``positions.csv``. Each replaces the old
        one only when it is complete. Text that other programs would misread is written as ``csv_text`` does.
        """
        evidence = self.evidence()
        with np.errstate(all="ignore"):  # scores may be infinite
            self._write_table("runs", evidence.table)  # first, as it needs no conclusion
            self._write_table("summary", self._summary(evidence.table))
            self._write_table("targets", evidence.target_table())
            self._write_table("ranking", evidence.ranking.frame)
            if len(claims := evidence.claims()):
                self._write_table("claims", claims)
            if len(evidence.references):
                self._write_table("references", evidence.references)
            if len(positions := self.positions):
                self._write_table("positions", positions)

    def _write_table(self, name: str, frame: pd.DataFrame) -> None:
        text = csv_frame(frame)
        write_whole(self.folder / f"{name}.csv", lambda path: text.to_csv(path, index=False))

    def has_tables(self) -> bool:
        """Whether the tables exist that every study has."""
        return all((self.folder / f"{name}.csv").is_file() for name in TABLES)

    def _summary(
        self, runs: pd.DataFrame, by: Sequence[str] | None = None, outlier_m: float | None = None
    ) -> pd.DataFrame:
        from nfbench.analysis import summarize

        meta = self.meta
        outlier_m = float(meta["outlier_m"]) if outlier_m is None else outlier_m
        with np.errstate(all="ignore"):  # scores may be infinite
            return summarize(runs, by, error=meta["error"], outlier_m=outlier_m)
