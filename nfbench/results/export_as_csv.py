"""Exports the traces of a study's runs as one CSV table."""

from __future__ import annotations

import contextlib
import csv
import tempfile
from pathlib import Path
from typing import Any

from nfbench.study import swept_column

from .cells import cell, csv_text
from .export import Exported, refuse_existing, status_or
from .export_gaps import Gaps
from .folder import write_whole
from .results import Results

__all__ = ["export_csv"]


def export_csv(results: Results, out: Path | None = None) -> Exported:
    """Write ``Results.traces`` to a CSV file with more columns: method, repetition, swept values, status and gap.

    The gap is the value minus the reference optimum of the run's first problem. It is empty for later problems, and for
    runs that are not ok.

    out: file to write; None: ``traces.csv`` in the results folder.

    Raises StoreError if the results folder holds no study or ``out`` cannot be written, and NfbenchError if ``out``
    exists or there is nothing to write.
    """
    out = results.folder / "traces.csv" if out is None else out
    refuse_existing(out)
    exported = Exported(out)

    def write(draft: Path) -> None:
        draft.parent.mkdir(parents=True, exist_ok=True)
        keys = results.swept_keys
        with (
            tempfile.TemporaryFile("w+", dir=draft.parent, encoding="utf-8", newline="") as body,
            draft.open("w", encoding="utf-8", newline="") as file,
        ):
            dimension = _write_rows(results, keys, exported, csv.writer(body))
            exported.close(results)
            body.seek(0)
            head = ["run_id", "method", "repetition", *map(swept_column, keys), "status", "problem"]
            head += ["evaluations", "seconds", "value", "gap", *(f"x_{j}" for j in range(dimension))]
            table = csv.writer(file, lineterminator="\n")
            table.writerow(head)  # the number of columns is known only now
            table.writerows(row + [""] * (len(head) - len(row)) for row in csv.reader(body))

    write_whole(out, write)
    return exported


def _write_rows(results: Results, keys: list[str], exported: Exported, rows: Any) -> int:
    """Write one row per improvement, without padding; return the largest number of unknowns."""
    dimension = 0
    with contextlib.closing(Gaps(results, results.runs)) as known:
        for run in results.traced_runs():
            if not exported.takes(None if run.traces else status_or(run, "without a trace")):
                continue
            swept = [_csv_cell(run.swept.get(key)) for key in keys]
            about = [run.run_id, csv_text(run.method), run.repetition, *swept, run.status]
            gaps = known.of(run.run_id)
            for number, trace in enumerate(run.traces):
                dimension = max(dimension, trace.points.shape[1])
                of_first = gaps.tolist() if number == 0 and gaps is not None else [""] * len(trace)
                columns = (trace.evaluations, trace.seconds, trace.values)
                cells = zip(*(column.tolist() for column in columns), of_first, *trace.points.T.tolist(), strict=True)
                rows.writerows([*about, number, *row] for row in cells)
    return dimension


def _csv_cell(value: Any) -> Any:
    found = cell(value)
    return csv_text(found, is_cell=True) if isinstance(found, str) else found
