"""Exports the gaps of a study's runs in IOHprofiler's data format."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

from nfbench.study import swept_column

from .cells import cell
from .export import Exported, refuse_existing, safe_name
from .export_gaps import GapRun, GapRuns
from .export_suite import Place, Suite
from .folder import whole_folder
from .results import Results

__all__ = ["export_ioh"]

IOH_FORMAT = "0.3.22"  # version of ioh whose file format is written; IOHanalyzer requires 0.3.3 or newer


def export_ioh(results: Results, out: Path | None = None) -> Exported:
    """Write the gaps of all runs to the folder ``out`` in IOHprofiler's data format.

    Each method becomes an algorithm with its own folder. Each combination of scenario point and formulation becomes a
    function, and each scene an instance with its number from 1; in a study of BBOB, functions and instances have COCO's
    numbers. The values are the gaps of the first problem of each run: the best value so far minus the reference optimum
    of the problem, so that a target means the same in every scene. Runs that are not ok are written as runs that have
    spent their evaluations without reaching any target. Runs without a trace are left out.

    out: folder to write; None: ``export-ioh`` in the results folder.

    Raises StoreError if the results folder holds no study or ``out`` cannot be written, and NfbenchError if ``out``
    exists or there is nothing to write. Reference: Doerr, Wang, Ye, van Rijn & Bäck (2018), and the files that ioh's
    logger ``Analyzer`` writes.
    """
    out = results.folder / "export-ioh" if out is None else out
    refuse_existing(out)
    exported = Exported(out)
    with whole_folder(out) as draft:
        runs = GapRuns(results, exported)
        profile = _Profile(draft, Suite(results, runs.runs))
        for run in runs:
            profile.add(run)
        exported.close(results)
        profile.close()
    return exported


@final
class _Profile:
    """Writes runs to IOHprofiler data sets as they come; ``close`` writes the JSON files that describe them."""

    def __init__(self, folder: Path, suite: Suite) -> None:
        self._folder, self._suite = folder, suite
        self._algorithms: dict[str, str] = {}
        self._data: dict[tuple[str, int], _DataSet] = {}

    def add(self, found: GapRun) -> None:
        place = self._suite.place(found)
        key = place.algorithm, place.function
        if key not in self._data:
            self._data[key] = self._new(found, place)
        self._data[key].add(place.instance, found)

    def close(self) -> None:
        for data in self._data.values():
            data.close()

    def _new(self, found: GapRun, place: Place) -> _DataSet:
        run = found.run
        folder = self._algorithms.get(place.algorithm) or safe_name(place.algorithm, self._algorithms.values())
        self._algorithms[place.algorithm] = folder
        attributes: dict[str, Any] = {"formulation": run.formulation, "solver": run.solver}
        attributes |= {swept_column(key): value for key, value in place.swept.items()}
        head = {
            "version": IOH_FORMAT,
            "suite": self._suite.name,
            "function_id": place.function,
            "function_name": place.name,
            "maximization": False,
            "algorithm": {"name": place.algorithm, "info": f"formulation {run.formulation}, solver {run.solver}"},
            "experiment_attributes": [{key: _attribute(value)} for key, value in attributes.items()],
            "attributes": ["evaluations", "raw_y"],
        }
        return _DataSet(self._folder / folder, f"f{place.function}_{safe_name(place.name)}", head)


@dataclass
class _DataSet:
    """One method on one function: a file of gaps per dimension, and a JSON file with one line per run."""

    folder: Path
    stem: str
    head: dict[str, Any]
    runs: dict[int, list[str]] = field(default_factory=dict)

    def add(self, instance: int, found: GapRun) -> None:
        dimension, evaluations, gaps = found.dimension, found.evaluations.tolist(), found.gaps.tolist()
        path = self.folder / self._path(dimension)
        if dimension not in self.runs:
            path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="ascii") as file:  # there may be thousands of files, too many to keep open
            file.write("evaluations raw_y\n")
            file.writelines(f"{n} {gap!r}\n" for n, gap in zip(evaluations, gaps, strict=True))
        best = {"evals": evaluations[found.best], "y": gaps[found.best], "x": found.point.tolist()}
        run = {"instance": instance, "evals": evaluations[-1], "best": best}
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


def _attribute(value: Any) -> str:
    """A value as text. Readers evaluate it as Python if they can, so the JSON of a list or table is quoted."""
    return value if isinstance(value, str) else repr(cell(value))
