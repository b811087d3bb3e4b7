"""What the finished runs of a study show: hits of targets, the ranking of methods, and the verdicts on claims."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from nfbench.analysis import (
    Point,
    Ranking,
    Target,
    judge_claims,
    outcomes,
    rank,
    swept_columns,
    target_table,
)
from nfbench.core import Status, StoreError
from nfbench.study import Claim, claim_of

from .hits import Hits, find_hits, targets_of
from .reader import Reader
from .references import judged, origin_of_gaps, with_optimum

__all__ = ["Evidence"]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The conclusions from the finished runs of a results folder. Each is computed at its first use and kept.

    results: results folder.
    runs: ``results.runs``.
    """

    results: Reader
    runs: pd.DataFrame

    @cached_property
    def error(self) -> str:
        """The column by which methods are ranked: the study's error measure.

        It is ``gospa_m`` instead of ``rmse_m`` if any run found too few or too many sources, because the error of the
        matched sources alone would favour such runs.
        """
        error, runs = self.results.meta["error"], self.runs
        ok = runs[runs["status"] == Status.OK]
        if error == "rmse_m" and {"sources", "sources_found", "gospa_m"} <= set(ok.columns):
            return "gospa_m" if (ok["sources_found"] - ok["sources"]).any() else error
        return error

    @cached_property
    def targets(self) -> tuple[Target, ...]:
        """What counts as solved."""
        return targets_of(self.results, self.runs)

    @cached_property
    def hits(self) -> Hits:
        """Which targets each run reached, and when."""
        return find_hits(self.results, self.targets, runs=self.runs)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The runs with their distance from the best possible: the columns of ``runs.csv``.

        ``optimum`` is the certified one where no minimum is known. ``gap``, of the run's first problem, is added unless
        the scenario has a score of that name, and ``error_in_bounds`` where there is a bound.
        """
        runs, gaps = with_optimum(self.runs, self.references), self.hits.gaps
        if "gap" not in runs.columns and gaps is not None and np.isfinite(gaps).any():
            runs = runs.assign(gap=gaps)
        if {"crb_m", "rmse_m"} <= set(runs.columns):
            runs = runs.assign(error_in_bounds=runs["rmse_m"] / runs["crb_m"])
        return runs

    @cached_property
    def references(self) -> pd.DataFrame:
        """The proofs of optima with what the runs say about them: the columns of ``references.csv``."""
        references = self.results.references
        bests = self.hits.bests if len(references) else None
        return judged(references, self.runs, np.full(len(self.runs), np.nan) if bests is None else bests)

    @property
    def contradictions(self) -> pd.DataFrame:
        """The rows of ``references`` whose certified optimum is wrong, because a run has found a better value."""
        return self.references[self.references["contradicted_by"] != ""]

    def origin_of_gaps(self, run_ids: Collection[str] | None = None) -> str:
        """What the gaps of some runs are measured from: "known minimum", "proven optimum" or "best known value"."""
        own = self.runs["run_id"].isin(self.runs["run_id"] if run_ids is None else list(run_ids)).to_numpy()
        return origin_of_gaps(self.runs[own], self.table[own])

    def target_table(self) -> pd.DataFrame:
        """One row per swept point, method and target."""
        return target_table(self.hits.frame)

    @cached_property
    def points(self) -> list[Point]:
        """The outcomes of the methods at each swept point."""
        return self._points([])

    @cached_property
    def unranked(self) -> str:
        """Why methods cannot be ranked by the ratios of their errors; empty if they can."""
        values = self.runs[self.error] if self.error in self.runs.columns else pd.Series(dtype=float)
        smallest = float(values[self.runs["status"] == Status.OK].min()) if len(values) else 0.0
        if smallest < 0:
            return (
                f"Methods are not ranked: {self.error} must be at least 0 to be compared by ratios, got {smallest:g}."
            )
        return ""

    def _points(self, columns: list[str]) -> list[Point]:
        if self.unranked:
            return []
        runs = self.runs if self.error in self.runs.columns else self.runs.assign(**{self.error: np.nan})
        return outcomes(runs, self.hits.frame, self.error, swept_columns(runs), columns=columns)

    @cached_property
    def ranking(self) -> Ranking:
        """The ranking of the methods at each swept point and over all of them."""
        stopped = "target_reached" in self.runs.columns and bool((self.runs["target_reached"] == 1).any())
        return rank(self.points, stopped_at_target=stopped)

    @cached_property
    def stated(self) -> list[Claim]:
        """The claims that the study was run with."""
        return _claims(self.results)

    def claims(self) -> pd.DataFrame:
        """One row per claim of the manifest, with its verdict."""
        claims = self.stated
        columns = dict.fromkeys(claim.compare.measure for claim in claims)
        known = [name for name in columns if name in self.runs.columns and self.runs[name].dtype.kind in "biuf"]
        return judge_claims(claims, self._points(known), unfinished=True)  # the manifest's names were checked


def _claims(results: Reader) -> list[Claim]:
    """The claims that the study was run with. Raises StoreError if the text in the folder is damaged."""
    try:
        return [claim_of(table) for table in json.loads(results.meta.get("claims", "[]"))]
    except (ValueError, TypeError) as error:
        raise StoreError(f"{results.folder}: the claims in the table meta are damaged: {error}") from error
