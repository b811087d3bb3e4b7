"""Exports the gaps of a study's runs in COCO's data format, which cocopp reads."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import final

from .export import Exported, refuse_existing, safe_name
from .export_gaps import GapRun, GapRuns
from .export_suite import Suite
from .folder import whole_folder
from .results import Results

__all__ = ["export_coco"]

PRECISION = 1e-8  # the smallest gap that COCO distinguishes
FORMAT, LOGGER, VERSION = "bbob-new2", "bbob", "2.8.2"  # of the coco-experiment whose files are imitated
POSTPROCESS = "export_postprocess.py"  # copied next to the data, so that they can be moved to another machine
COLUMNS = (
    "% f evaluations | g evaluations | best noise-free fitness - Fopt ({offset:.12e}) + sum g_i+ | measured fitness | "
    "best measured fitness or single-digit g-values\n"
)


def export_coco(results: Results, out: Path | None = None) -> Exported:
    """Write the gaps of all runs to the folder ``out`` in COCO's data format.

    Each method becomes a folder that cocopp reads. A study of BBOB has COCO's suite ``bbob`` with COCO's numbers of
    functions and instances, so that it can be compared with COCO's archive. Any other study has a suite of its own,
    where each combination of scenario point and formulation is a function, and each scene an instance with its number
    from 1. The file ``postprocess.py`` in ``out`` declares the suite to cocopp and runs it on all methods. Which runs
    are written, and their values, are as in ``export_ioh``.

    out: folder to write; None: ``export-coco`` in the results folder.

    Raises StoreError if the results folder holds no study or ``out`` cannot be written, and NfbenchError if ``out``
    exists or there is nothing to write. Reference: Hansen, Auger, Ros, Mersmann, Tušar & Brockhoff (2021), and the
    files that COCO's observer ``bbob`` writes.
    """
    out = results.folder / "export-coco" if out is None else out
    refuse_existing(out)
    exported = Exported(out)
    with whole_folder(out) as draft:
        runs = GapRuns(results, exported)
        suite = Suite(results, runs.runs)
        archive = _Archive(draft, suite, _precision(results, suite))
        for run in runs:
            archive.add(run)
        exported.close(results)
        archive.close()
    return exported


def _precision(results: Results, suite: Suite) -> float:
    """The gap below which cocopp need not look: COCO's own, or the smallest target of the study."""
    if suite.is_bbob:
        return PRECISION
    return min([PRECISION, *(target.value for target in results.targets if target.kind == "gap")])


@final
class _Archive:
    """Writes runs to COCO's data files as they come; ``close`` writes the files that describe them."""

    def __init__(self, folder: Path, suite: Suite, precision: float) -> None:
        self._folder, self._suite, self._precision = folder, suite, precision
        self._algorithms: dict[str, str] = {}
        self._runs: dict[tuple[str, int], dict[int, list[str]]] = {}

    def add(self, found: GapRun) -> None:
        place = self._suite.place(found)
        if place.algorithm not in self._algorithms:
            self._algorithms[place.algorithm] = safe_name(place.algorithm, self._algorithms.values())
        path = self._folder / self._algorithms[place.algorithm] / _data_path(place.function, found.dimension)
        of_function = self._runs.setdefault((place.algorithm, place.function), {})
        if found.dimension not in of_function:
            path.parent.mkdir(parents=True, exist_ok=True)
        rows = zip(found.evaluations.tolist(), found.gaps.tolist(), strict=True)
        text = COLUMNS.format(offset=found.offset)
        text += "".join(f"{n} 0 {gap!r} {gap + found.offset!r} {gap + found.offset!r}\n" for n, gap in rows)
        for name in (path, path.with_suffix(".tdat")):  # rows at improvements, and at numbers of evaluations
            with name.open("a", encoding="ascii") as file:
                file.write(text)
        run = f"{place.instance}:{found.evaluations[-1]}|{found.gaps[-1]:.1e}"
        of_function.setdefault(found.dimension, []).append(run)

    def close(self) -> None:
        for (algorithm, function), by_dimension in self._runs.items():
            text = "\n".join(
                f"suite = '{self._suite_name}', funcId = {function}, DIM = {dimension}, "
                f"Precision = {self._precision:.3e}, algId = '{_plain(algorithm)}', coco_version = '{VERSION}', "
                f"logger = '{LOGGER}', data_format = '{FORMAT}'\n% {_plain(self._suite.names[function])}\n"
                + ", ".join([_data_path(function, dimension), *by_dimension[dimension]])
                for dimension in sorted(by_dimension)
            )
            path = self._folder / self._algorithms[algorithm] / f"bbobexp_f{function}.info"
            path.write_text(text, encoding="utf-8")
        about = {
            "suite": self._suite_name,
            "precision": self._precision,
            "functions": {str(function): self._suite.names[function] for function in sorted(self._suite.names)},
            "dimensions": sorted({dimension for by_dimension in self._runs.values() for dimension in by_dimension}),
            "algorithms": self._algorithms,
        }
        (self._folder / "suite.json").write_text(json.dumps(about, indent=1) + "\n", encoding="ascii")
        names = [f"{function} {_plain(name)}\n" for function, name in sorted(self._suite.names.items())]
        (self._folder / "functions.txt").write_text("".join(names), encoding="utf-8")
        shutil.copyfile(Path(__file__).with_name(POSTPROCESS), self._folder / "postprocess.py")

    @property
    def _suite_name(self) -> str:
        return safe_name(self._suite.name)


def _data_path(function: int, dimension: int) -> str:
    return f"data_f{function}/bbobexp_f{function}_DIM{dimension}.dat"


def _plain(label: str) -> str:
    """A label without what delimits the values of a header line."""
    return " ".join(label.replace("'", "’").replace("\\", "/").split())
