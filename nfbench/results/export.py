"""Exports a study's traces for other tools: in IOHprofiler's data format, or as one CSV table."""

from __future__ import annotations

import csv
import json
import re
import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np

from nfbench.core import NfbenchError, Status, Trace

from .cells import cell, csv_text
from .folder import whole_folder, write_whole
from .results import Results
from .rows import TracedRun

__all__ = ["Exported", "export_csv", "export_ioh"]

IOH_FORMAT = "0.3.22"  # version of ioh whose file format is written; IOHanalyzer requires 0.3.3 or newer
NAME_LENGTH = 80  # maximum length of a file or folder name made from a label [characters]


@dataclass
class Exported:
    """What an export wrote.

    path: file or folder that was written.
    runs: number of exported runs.
    total: number of runs in the study.
    left_out: number of runs that were left out, by reason.
    """

    path: Path
    runs: int = 0
    total: int = 0
    left_out: Counter[str] = field(default_factory=Counter)

    def __str__(self) -> str:
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())
        return f"{self.path}: {self.runs} of {self.total} runs" + (f"; left out: {reasons}" if reasons else "")

    def takes(self, reason: str | None) -> bool:
        """Count one more run; return False if there is a reason to leave it out."""
        if reason is None:
            self.runs += 1
        else:
            self.left_out[reason] += 1
        return reason is None

    def close(self, results: Results) -> None:
        """Count the unfinished runs. Raises NfbenchError if there was nothing to write."""
        self.total = sum(results.counts.values())
        if left := self.total - self.runs - sum(self.left_out.values()):
            self.left_out["open"] = left
        if not self.runs:
            reason = "no finished run can be exported" if self.total > left else "no run has finished yet"
            raise NfbenchError(f"{results.folder}: {reason}; nothing was written ({self})")


def export_ioh(results: Results, out: Path | None = None) -> Exported:
    """Write the traces of all runs with status ok to the folder ``out`` in IOHprofiler's data format.

    Each method becomes an algorithm with its own folder. Each combination of scenario point, formulation and problem
    number becomes a function, and each repetition becomes an instance with the same number. The values are the best
    values so far, as in the stored traces. Runs that the format cannot represent are left out: those without a trace,
    and those whose first value is not finite, because readers recognize the start of a run by its first evaluation.

    out: folder to write; None: ``export-ioh`` in the results folder.

    Raises StoreError if the results folder holds no study or ``out`` cannot be written, and NfbenchError if ``out``
    exists or there is nothing to write. Reference: Doerr, Wang, Ye, van Rijn & Bäck (2018), and the files that ioh's
    logger ``Analyzer`` writes.
    """
    out = results.folder / "export-ioh" if out is None else out
    _refuse_existing(out)
    exported = Exported(out)
    study = results.meta["name"]
    with whole_folder(out) as draft:
        profile = _Profile(draft, study)
        for run in results.traced_runs():
            if exported.takes(_unfit(run)):
                profile.add(run)
        exported.close(results)
        profile.close()
    return exported


def export_csv(results: Results, out: Path | None = None) -> Exported:
    """Write ``Results.traces`` to a CSV file, and add the method, repetition, swept values and status to each row.

    out: file to write; None: ``traces.csv`` in the results folder.

    Raises StoreError if the results folder holds no study or ``out`` cannot be written, and NfbenchError if ``out``
    exists or there is nothing to write.
    """
    out = results.folder / "traces.csv" if out is None else out
    _refuse_existing(out)
    exported = Exported(out)

    def write(draft: Path) -> None:
        draft.parent.mkdir(parents=True, exist_ok=True)
        keys = results.swept_keys
        with (
            tempfile.TemporaryFile("w+", dir=draft.parent, encoding="utf-8", newline="") as body,
            draft.open("w", encoding="utf-8", newline="") as file,
        ):
            rows, dimension = csv.writer(body), 0
            for run in results.traced_runs():
                if exported.takes(None if run.traces else _status(run, "without a trace")):
                    swept = [_csv_cell(run.swept.get(key)) for key in keys]
                    about = [run.run_id, csv_text(run.method), run.repetition, *swept]
                    for number, trace in enumerate(run.traces):
                        dimension = max(dimension, trace.points.shape[1])
                        columns = (trace.evaluations, trace.seconds, trace.values, *trace.points.T)
                        cells = zip(*(column.tolist() for column in columns), strict=True)
                        rows.writerows([*about, run.status, number, *row] for row in cells)
            exported.close(results)
            body.seek(0)
            head = ["run_id", "method", "repetition", *(f"scenario.{key}" for key in keys), "status", "problem"]
            head += ["evaluations", "seconds", "value", *(f"x_{j}" for j in range(dimension))]
            table = csv.writer(file, lineterminator="\n")
            table.writerow(head)  # the number of columns is known only now
            table.writerows(row + [""] * (len(head) - len(row)) for row in csv.reader(body))

    write_whole(out, write)
    return exported


def _csv_cell(value: Any) -> Any:
    found = cell(value)
    return csv_text(found, is_cell=True) if isinstance(found, str) else found


def _refuse_existing(out: Path) -> None:
    if out.exists() or out.is_symlink():
        raise NfbenchError(f"{out} already exists; remove it, or choose another path with --out")


def _status(run: TracedRun, reason_if_ok: str) -> str:
    """The status of a run that is left out, or the given reason if its status is ok."""
    return reason_if_ok if run.status == Status.OK else run.status


def _unfit(run: TracedRun) -> str | None:
    """Why a run cannot be part of an IOHprofiler data set; None if it can."""
    if run.status != Status.OK or not run.traces:
        return _status(run, "without a trace")
    if not all(np.isfinite(trace.values).all() for trace in run.traces):
        return "with a non-finite first value"
    return None


@final
class _Profile:
    """Writes runs to IOHprofiler data sets as they come; ``close`` writes the JSON files that describe them."""

    def __init__(self, folder: Path, study: str) -> None:
        self._folder, self._study = folder, study
        self._functions: dict[tuple[str, str, int], int] = {}
        self._algorithms: dict[str, str] = {}
        self._data: dict[tuple[str, int], _DataSet] = {}

    def add(self, run: TracedRun) -> None:
        for number, trace in enumerate(run.traces):
            key = (json.dumps(run.swept), run.formulation, number)
            function = self._functions.setdefault(key, len(self._functions) + 1)
            if (run.method, function) not in self._data:
                self._data[run.method, function] = self._new(run, number, function)
            self._data[run.method, function].add(run.repetition, trace)

    def close(self) -> None:
        for data in self._data.values():
            data.close()

    def _new(self, run: TracedRun, problem: int, function: int) -> _DataSet:
        folder = self._algorithms.get(run.method) or _safe(run.method, self._algorithms.values())
        self._algorithms[run.method] = folder
        swept = [f"{key} = {cell(value)}" for key, value in run.swept.items()]
        name = ", ".join([f"{run.formulation} problem {problem}", *swept])
        attributes: dict[str, Any] = {"formulation": run.formulation, "solver": run.solver, "problem": problem}
        attributes |= {f"scenario.{key}": value for key, value in run.swept.items()}
        head = {
            "version": IOH_FORMAT,
            "suite": f"nfbench {self._study}",
            "function_id": function,
            "function_name": name,
            "maximization": False,
            "algorithm": {"name": run.method, "info": f"formulation {run.formulation}, solver {run.solver}"},
            "experiment_attributes": [{key: _attribute(value)} for key, value in attributes.items()],
            "attributes": ["evaluations", "raw_y"],
        }
        return _DataSet(self._folder / folder, f"f{function}_{_safe(name)}", head)


@dataclass
class _DataSet:
    """One method on one function: a file of traces per dimension, and a JSON file with one line per run."""

    folder: Path
    stem: str
    head: dict[str, Any]
    runs: dict[int, list[str]] = field(default_factory=dict)

    def add(self, instance: int, trace: Trace) -> None:
        dimension = trace.points.shape[1]
        path = self.folder / self._path(dimension)
        if dimension not in self.runs:
            path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="ascii") as file:  # there may be thousands of files, too many to keep open
            file.write("evaluations raw_y\n")
            rows = zip(trace.evaluations.tolist(), trace.values.tolist(), strict=True)
            file.writelines(f"{evaluations} {value!r}\n" for evaluations, value in rows)
        i = int(trace.values.argmin())
        best = {"evals": int(trace.evaluations[i]), "y": float(trace.values[i]), "x": trace.points[i].tolist()}
        run = {"instance": instance, "evals": int(trace.evaluations[-1]), "best": best}
        self.runs.setdefault(dimension, []).append(json.dumps(run))  # JSON text takes a fifth of the memory of the dict

    def close(self) -> None:
        scenarios = ",\n".join(
            f'{{"dimension": {dimension}, "path": "{self._path(dimension)}", "runs": [\n' + ",\n".join(runs) + "\n]}"
            for dimension, runs in self.runs.items()
        )
        text = f'{json.dumps(self.head)[:-1]}, "scenarios": [\n{scenarios}\n]}}\n'
        (self.folder / f"IOHprofiler_{self.stem}.json").write_text(text, encoding="ascii")

    def _path(self, dimension: int) -> str:
        return f"data_{self.stem}/IOHprofiler_f{self.head['function_id']}_DIM{dimension}.dat"


def _safe(label: str, taken: Iterable[str] = ()) -> str:
    """A label as a valid file name on any system, unlike those taken even where case is ignored."""
    name = re.sub(r"[^A-Za-z0-9+-]+", "_", label).strip("_-")[:NAME_LENGTH] or "_"
    lowered, number, found = {other.lower() for other in taken}, 2, name
    while found.lower() in lowered:
        found, number = f"{name}-{number}", number + 1
    return found


def _attribute(value: Any) -> str:
    """A value as text. Readers evaluate it as Python if they can, so the JSON of a list or table is quoted."""
    return value if isinstance(value, str) else repr(cell(value))
