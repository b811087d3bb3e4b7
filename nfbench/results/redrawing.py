"""Redraws the scenes of a results folder with installed plugins: reading must not run code that the folder names."""

from __future__ import annotations

import functools
import json
import tomllib
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from nfbench.core import Formulation, Instance, NfbenchError, ProblemInstance, Scenario, Trace, explain
from nfbench.plugins import Registry
from nfbench.study import ErrorCollector, Resolver, load_scenarios, scene_numbers

__all__ = ["UNRELATED", "Redrawing"]

UNRELATED = "the estimate does not follow from the best point alone"

_KEPT = 64  # scenes in memory
_SAME = 1e-6  # relative difference of two values that are computed on different machines
_FORGOTTEN = 1e-9  # of the largest value of a trace, below which differences are rounding


class Redrawing:
    """The scenarios and formulations that the manifest in a folder names, and the scenes that they draw.

    folder: results folder; its ``manifest.toml`` is read when something is asked for. manifest: a manifest to read
    instead.

    Whatever cannot be redrawn is None, and ``reasons`` says why: by the label of a formulation, or under "" for the
    scenes. A plugin may have changed since the study ran, so every use is checked against what the run has stored.
    """

    def __init__(self, folder: Path, manifest: Path | None = None) -> None:
        self._path = manifest or folder / "manifest.toml"
        self._instances: OrderedDict[tuple[str, int, bool], Instance | None] = OrderedDict()

    @functools.cached_property
    def reasons(self) -> dict[str, str]:
        """Why scenes ("") or formulations (by label) are not available; empty if all are."""
        found = {"": self._scenarios[1]} if self._scenarios[1] else {}
        return found | self._formulations[1]

    def instance(self, swept: dict[str, Any], seed: int) -> Instance | None:
        """The scene with this seed at this point of the sweep; None if it cannot be redrawn."""
        return self._kept(_key(swept), seed, True)

    def truth(self, swept: dict[str, Any], seed: int) -> Instance | None:
        """What the scores of a scene need, which may lack the data; None if it cannot be redrawn."""
        return self._kept(_key(swept), seed, False)

    def _kept(self, point: str, seed: int, data: bool) -> Instance | None:
        key = (point, seed, data)
        if key not in self._instances:
            self._instances[key] = self._drawn(*key)
            if len(self._instances) > _KEPT:
                self._instances.popitem(last=False)
        return self._instances[key]

    def scenario(self, swept: dict[str, Any]) -> Scenario | None:
        """The scenario at this point of the sweep; None if it is not available."""
        return self._scenarios[0].get(_key(swept))

    @property
    def formulations(self) -> list[str]:
        """The labels of the formulations that are available."""
        return list(self._formulations[0])

    @property
    def seeds(self) -> dict[int, int]:
        """The numbers of the scenes by their seeds."""
        return self._numbers

    @property
    def points(self) -> list[dict[str, Any]]:
        """The points of the sweep without what is swept in the budget."""
        return [json.loads(key) for key in self._scenarios[0]]

    def formulation(self, label: str) -> Formulation | None:
        """The formulation with this label; None if it is not available."""
        return self._formulations[0].get(label)

    def errors(
        self, measure: str, instance: Instance | None, formulation: str, trace: Trace, final: float
    ) -> tuple[ndarray | None, str]:
        """The error of the estimate from the best point so far, at each row of a trace (r,); inf where it is NaN.

        final: the error that the run has stored. If the last error differs from it, the redrawn scene is not that of
        the run. Returns None and the reason if there are no errors along the trace.
        """
        made = self._formulations[0].get(formulation)
        if made is None or instance is None:
            reason = self.reasons.get("") or self.reasons.get(formulation)
            return None, reason or f"the {'scene' if made else 'formulation'} is not available"
        try:
            estimates = made.estimates(instance, trace.points)
            if estimates is None:
                return None, UNRELATED
            errors = np.asarray(instance.errors(measure, estimates), dtype=np.float64)
        except Exception as error:  # of a plugin, which may have changed
            return None, _short(error)
        if errors.shape != (len(trace),):
            return None, f"expected {len(trace)} errors, got the shape {errors.shape}"
        errors = np.where(np.isnan(errors), np.inf, errors)
        if not _agree(errors, final):
            return None, "the redrawn scene is not that of the run, as it gives another error"
        return np.append(errors[:-1], final), ""

    def minimum(self, instance: Instance | None, trace: Trace) -> float | None:
        """The known minimum of the scene's own problem, if that is the one whose trace this is."""
        if not isinstance(instance, ProblemInstance) or not len(trace):
            return None
        problem = instance.problem
        if problem.minimum is None or trace.points.shape[1] != problem.dimension:
            return None
        try:
            value = problem.value(np.array(trace.points[-1]))
        except Exception:
            return None
        return float(problem.minimum) if _agree(np.append(trace.values[:-1], value), float(trace.values[-1])) else None

    @functools.cached_property
    def _scenarios(self) -> tuple[dict[str, Scenario], str]:
        """The scenario at each point of the sweep, and why there are none."""
        try:
            return {_key(swept): scenario for swept, scenario in load_scenarios(self._path)}, ""
        except Exception as error:  # also of an installed plugin
            return {}, f"the scenes cannot be redrawn: {_short(error)}"

    @functools.cached_property
    def _formulations(self) -> tuple[dict[str, Formulation], dict[str, str]]:
        """The formulations by label, and why others are missing."""
        if self._scenarios[1]:
            return {}, {}
        table = tomllib.loads(self._path.read_text(encoding="utf-8"))  # load_scenarios has checked it
        errors = ErrorCollector()
        resolver = Resolver(Registry.present(), errors)
        specs, missing = [], {}
        for i, entry in enumerate(_formulation_tables(table)):
            known = len(errors.texts)
            resolved = resolver.resolve("formulation", entry, f"formulation[{i}]")
            if resolved is not None and resolved.made is not None:
                specs.append(resolved.spec)
            else:
                label = str(entry.get("label") or entry.get("kind"))
                problems = [resolved.spec.broken] if resolved is not None and resolved.spec.broken else []
                missing[label] = (
                    "; ".join([*problems, *errors.texts[known:]])[:300] or "the formulation is not available"
                )
        made = {}
        for spec in specs:
            formulation = resolver.made("formulation", spec)
            if isinstance(formulation, Formulation):
                made[resolver.labelled("formulation", spec).label] = formulation
        return made, missing

    @functools.cached_property
    def _numbers(self) -> dict[int, int]:
        """The numbers of the scenes by their seeds."""
        return scene_numbers(self._path)

    def _drawn(self, point: str, seed: int, data: bool) -> Instance | None:
        scenario = self._scenarios[0].get(point)
        if scenario is None:
            return None
        draw = scenario.draw_scene if data else scenario.draw_truth
        try:
            return draw(np.random.default_rng(seed), self._numbers.get(seed, 0))
        except Exception:  # of the plugin
            return None


def _formulation_tables(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The tables of all formulations of a manifest, without budgets."""
    listed = manifest.get("formulation", [])
    found: list[Any] = list(listed) if isinstance(listed, list) else [listed]
    methods = manifest.get("method", [])
    for method in methods if isinstance(methods, list) else [methods]:
        entry = method.get("formulation") if isinstance(method, dict) else None
        found.append({"kind": entry} if isinstance(entry, str) else entry)
    return [{k: v for k, v in entry.items() if k != "budget"} for entry in found if isinstance(entry, dict)]


def _key(swept: dict[str, Any]) -> str:
    """A point of the sweep as text, without what is swept in the budget, which changes no scene."""
    return json.dumps({k: v for k, v in swept.items() if not k.startswith("budget.")}, sort_keys=True)


def _agree(along: ndarray, final: float) -> bool:
    """Whether the last of the values along a trace is the stored one, up to rounding."""
    finite = np.abs(along[np.isfinite(along)])
    tolerance = _SAME * abs(final) + (_FORGOTTEN * finite.max() if finite.size else 0.0)
    return bool(along[-1] == final or abs(along[-1] - final) <= tolerance)


def _short(error: Exception) -> str:
    text = str(error) if isinstance(error, NfbenchError) else explain(error)
    return text.replace("\n", " ")[:300]
