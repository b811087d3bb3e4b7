"""Exports a study's runs, traces, hits and targets as Parquet files."""

from __future__ import annotations

import contextlib
import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from nfbench.core import MissingExtra, Trace
from nfbench.study import swept_column

from .cells import cell
from .export import Exported, refuse_existing, status_or
from .export_gaps import Gaps
from .folder import whole_folder
from .results import Results

__all__ = ["export_parquet"]

ROWS = 100_000  # of the traces, that are collected before they are written


def export_parquet(results: Results, out: Path | None = None) -> Exported:
    """Write the tables of a study as Parquet files to the folder ``out``.

    ``runs.parquet``, ``hits.parquet`` and ``targets.parquet`` have the columns of ``Results.runs``, ``Results.hits()``
    and ``Results.target_table()``, and ``references.parquet``, in studies with proven optima, those of
    ``Results.reference_table()``, and ``positions.parquet``, where sources have positions, those of
    ``Results.positions``. ``traces.parquet`` has one row per improvement, with the columns of ``traces.csv``,
    except that the coordinates are in one column ``x`` of lists. Swept values of different types are written as text.

    out: folder to write; None: ``export-parquet`` in the results folder.

    Raises MissingExtra if pyarrow is not installed, StoreError if the results folder holds no study or ``out`` cannot
    be written, and NfbenchError if ``out`` exists or there is nothing to write.
    """
    parquet = _library()
    out = results.folder / "export-parquet" if out is None else out
    refuse_existing(out)
    exported = Exported(out)
    with whole_folder(out) as draft, np.errstate(all="ignore"):  # scores may be infinite
        evidence = results.evidence()
        runs = _uniform(evidence.runs)
        _write_traces(parquet, results, evidence.runs, draft / "traces.parquet", exported)
        exported.close(results)
        tables = {"runs": runs, "hits": _uniform(evidence.hits.frame), "targets": _uniform(evidence.target_table())}
        if len(evidence.references):
            tables["references"] = _uniform(evidence.references)
        if len(positions := results.positions):
            tables["positions"] = _uniform(positions)
        for name, frame in tables.items():
            frame.to_parquet(draft / f"{name}.parquet", engine="pyarrow", index=False)
    return exported


def _library() -> ModuleType:
    try:
        return importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise MissingExtra("Parquet needs pyarrow, which is not installed: pip install 'nfbench[parquet]'") from error


def _write_traces(parquet: ModuleType, results: Results, runs: pd.DataFrame, path: Path, exported: Exported) -> None:
    """Write the traces in pieces of about ROWS rows, which bounds the memory."""
    keys = results.swept_keys
    schema = _schema(runs, [swept_column(key) for key in keys])
    texts = {name for name in schema.names if str(schema.field(name).type) == "string"}
    pyarrow = importlib.import_module("pyarrow")
    with contextlib.closing(Gaps(results, runs)) as known, parquet.ParquetWriter(path, schema) as writer:
        pieces: dict[str, list[Any]] = {name: [] for name in schema.names}

        def flush() -> None:
            writer.write_table(pyarrow.table(pieces, schema=schema))
            for piece in pieces.values():
                piece.clear()

        for run in results.traced_runs():
            if not exported.takes(None if run.traces else status_or(run, "without a trace")):
                continue
            swept = {swept_column(key): cell(run.swept.get(key)) for key in keys}
            about = {"run_id": run.run_id, "method": run.method, "repetition": run.repetition, "status": run.status}
            about |= {name: str(value) if name in texts else value for name, value in swept.items()}
            gaps = known.of(run.run_id)
            for number, trace in enumerate(run.traces):
                _append(pieces, about, number, trace, gaps if number == 0 else None)
            if len(pieces["value"]) >= ROWS:
                flush()
        flush()


def _append(
    pieces: dict[str, list[Any]], about: dict[str, Any], number: int, trace: Trace, gaps: np.ndarray | None
) -> None:
    """Append the rows of one trace to the columns."""
    rows: dict[str, list[Any]] = {name: [value] * len(trace) for name, value in {**about, "problem": number}.items()}
    rows |= {"evaluations": trace.evaluations.tolist(), "seconds": trace.seconds.tolist()}
    rows |= {"value": trace.values.tolist(), "gap": [None] * len(trace) if gaps is None else gaps.tolist()}
    rows["x"] = trace.points.tolist()
    for name, column in rows.items():
        pieces[name].extend(column)


def _schema(runs: pd.DataFrame, swept: list[str]) -> Any:
    pyarrow = importlib.import_module("pyarrow")
    kinds = {"i": pyarrow.int64(), "f": pyarrow.float64(), "b": pyarrow.bool_()}
    text, whole, real = pyarrow.string(), pyarrow.int64(), pyarrow.float64()
    fields = [("run_id", text), ("method", text), ("repetition", whole)]
    fields += [(name, kinds.get(runs[name].dtype.kind, text)) for name in swept]
    fields += [("status", text), ("problem", whole), ("evaluations", whole), ("seconds", real)]
    return pyarrow.schema([*fields, ("value", real), ("gap", real), ("x", pyarrow.list_(real))])


def _uniform(frame: pd.DataFrame) -> pd.DataFrame:
    """A copy with one type per column: what is neither numbers nor truth values becomes text."""
    columns: dict[str, Any] = {}
    for name in frame.columns:
        values = frame[name]
        if values.dtype.kind not in "biuf":
            values = pd.Series(
                [None if value is None else str(value) for value in values], index=frame.index, dtype=object
            )
        columns[str(name)] = values
    return pd.DataFrame(columns)
