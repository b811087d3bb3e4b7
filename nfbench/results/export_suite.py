"""Names the runs of a study in the terms of other tools: algorithm, function and instance."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from typing import Any, final

import pandas as pd

from .cells import cell
from .export_gaps import GapRun, point_of
from .results import Results

__all__ = ["Place", "Suite"]

OF_BBOB = ("function", "dimension", "instance_id")  # swept keys that COCO's own numbers express


@dataclass(frozen=True)
class Place:
    """Where a run belongs.

    algorithm: label of the method, and what is swept in the budget.
    function: number of the function, from 1. name: what the function is.
    instance: number of the instance.
    swept: swept values that are part of the function.
    """

    algorithm: str
    function: int
    name: str
    instance: int
    swept: dict[str, Any]


@final
@dataclass
class Suite:
    """The functions of a study.

    A study of BBOB has COCO's numbers of functions and instances. In any other study, each combination of scenario
    point and formulation is a function, in the order in which they appear, and a scene is an instance.

    results: results folder. runs: ``results.runs``.
    """

    results: Results
    runs: pd.DataFrame
    functions: dict[tuple[str, str], int] = field(default_factory=dict, init=False)
    names: dict[int, str] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._scenario = self._bbob_table()
        self._instances = self._instance_ids() if self.is_bbob else {}

    @property
    def name(self) -> str:
        """``bbob``, or the name of a suite of this study's own."""
        return "bbob" if self.is_bbob else f"nfbench {self.results.meta['name']}"

    @property
    def is_bbob(self) -> bool:
        """Whether functions and instances have COCO's numbers."""
        return self._scenario is not None

    def place(self, found: GapRun) -> Place:
        """Return where a run belongs."""
        run = found.run
        if self._scenario is not None:
            parts = {key: value for key, value in run.swept.items() if key not in OF_BBOB}
            function = int(run.swept.get("function", self._scenario.get("function", 1)))  # 1 is the scenario's default
            name, of_function = f"BBOB function {function}", {}
            instance = int(run.swept.get("instance_id") or self._instances.get(found.seed, 0))
        else:
            parts = {key: value for key, value in run.swept.items() if key.startswith("budget.")}
            function = self.functions.setdefault((point_of(run.swept), run.formulation), len(self.functions) + 1)
            of_function = {key: value for key, value in run.swept.items() if key not in parts}
            name, instance = ", ".join([run.formulation, *_texts(of_function)]), found.scene + 1
        self.names[function] = name
        return Place(", ".join([run.method, *_texts(parts)]), function, name, instance, of_function)

    def _bbob_table(self) -> dict[str, Any] | None:
        """The table of the scenario, if every run minimizes a function of BBOB itself and knows its instance."""
        runs = self.runs[self.runs["solver"] != ""]
        if "instance_id" not in runs.columns or runs["formulation"].nunique() != 1:
            return None
        try:
            manifest = tomllib.loads((self.results.folder / "manifest.toml").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        scenario = manifest.get("scenario")
        return scenario if isinstance(scenario, dict) and scenario.get("kind") == "bbob" else None

    def _instance_ids(self) -> dict[int, int]:
        """COCO's number of the instance by the seed of the scene, because failed runs do not have the number."""
        runs = self.runs[self.runs["instance_id"].notna()]
        return dict(zip(runs["instance_seed"].tolist(), runs["instance_id"].astype(int).tolist(), strict=True))


def _texts(swept: dict[str, Any]) -> list[str]:
    return [f"{key} = {cell(value)}" for key, value in swept.items()]
