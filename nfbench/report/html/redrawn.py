"""What a page shows of redrawn scenes: the array, the positions, and pictures of what the solvers minimize."""

from __future__ import annotations

import base64
import io
import tomllib
from collections.abc import Sequence
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy import ndarray
from PIL import Image

from nfbench.core import Cut, Formulation, Instance, NfbenchError, Problem, Survey, explain, printable
from nfbench.results import Redrawing, cell
from nfbench.study import load_scenarios

from .study import Study, numbers

__all__ = ["Redrawn"]

SIDE = 72  # pixels of a landscape
CUT = (240, 90)  # pixels of a cut
PICTURES = 12  # landscapes of first problems in a page
SCENES = 5  # with cuts in a page
LEVELS = 64  # shades of a landscape
Places = tuple[ndarray, ndarray]


class _Captured(Exception):  # it is no error
    """Ends a formulation at its first problem."""

    def __init__(self, problem: Problem) -> None:
        super().__init__("captured")
        self.problem = problem


@final
class Redrawn:
    """The scenes of a study, redrawn with installed plugins; ``reason`` says why there are none, if so."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._redrawing = Redrawing(study.results.folder)

    @property
    def reason(self) -> str:
        """Why nothing can be redrawn; empty if scenes can be."""
        return self._redrawing.reasons.get("", "") if self._swept else "the folder has no manifest.toml to redraw from"

    @cached_property
    def _swept(self) -> dict[frozenset[Any], dict[str, Any]]:
        """The swept values as the manifest has them, by those of the tables."""
        try:
            points = load_scenarios(self._study.results.folder / "manifest.toml")
        except Exception:  # Redrawing has the reason
            return {frozenset(): {}} if "" in self._redrawing.reasons else {}
        return {frozenset((key, cell(value)) for key, value in swept.items()): swept for swept, _ in points}

    def _at(self, point: int) -> dict[str, Any]:
        keys = [name.removeprefix("scenario.") for name in self._study.swept]
        pairs = zip(keys, self._study.settings[point], strict=True)
        return self._swept.get(frozenset(pairs), dict(zip(keys, self._study.settings[point], strict=True)))

    def instance(self, point: int, seed: int) -> Instance | None:
        """The scene with this seed at this point; None if it cannot be redrawn."""
        return None if self.reason else self._redrawing.instance(self._at(point), seed)

    def positions(self, point: int, run: dict[Any, Any], estimate: Any, error: str) -> Places | None:
        """The true and the estimated positions of a run; None if there are none, or if the scene has changed."""
        instance = self.instance(point, int(run["instance_seed"]))
        if instance is None or estimate is None:
            return None
        try:
            found = np.array(estimate, dtype=np.float64)
            same = np.isclose(instance.score(found)[error], run[error], rtol=1e-6, atol=1e-12)
            return instance.positions(found) if same else None
        except Exception:  # of a plugin, which may have changed
            return None

    @cached_property
    def array(self) -> Survey | None:
        """The array of the first point; None if the scenario has none."""
        scenario = None if self.reason else self._redrawing.scenario(self._at(0))
        if scenario is None:
            return None
        try:
            table = tomllib.loads((self._study.results.folder / "manifest.toml").read_text(encoding="utf-8"))
            return type(scenario).survey({k: v for k, v in table["scenario"].items() if k != "kind"})
        except Exception:  # of a plugin
            return None

    def landscapes(self, scenes: Sequence[tuple[int, Any]], formulations: Sequence[str]) -> list[dict[str, Any]]:
        """Pictures of what is minimized in the first of these scenes.

        They are the cuts that the instances name or, where these have none, the first problem of each formulation over
        its first two unknowns, through the best point of any run.
        """
        if self.reason:
            return []
        found = self._cuts(scenes[:SCENES])
        return found or self._first_problems(scenes, formulations)

    def _cuts(self, scenes: Sequence[tuple[int, Any]]) -> list[dict[str, Any]]:
        found = []
        for point, scene in scenes:
            instance = self.instance(point, self._seeds[point, scene])
            if instance is None:
                continue
            try:
                cuts = list(instance.cuts())
                pictures = [_cut(cut) for cut in cuts]
            except Exception as error:  # of a plugin
                raise NfbenchError(f"the landscape cannot be drawn: {explain(error)}") from error
            found += [{"point": point, "scene": int(scene), **picture} for picture in pictures]
        return found

    @cached_property
    def _seeds(self) -> dict[tuple[int, Any], int]:
        runs = self._study.runs
        rows = runs.drop_duplicates([*self._study.swept, "scene"])
        return {(self._study.place(row), row["scene"]): int(row["instance_seed"]) for row in rows.to_dict("records")}

    def _first_problems(self, scenes: Sequence[tuple[int, Any]], formulations: Sequence[str]) -> list[dict[str, Any]]:
        wanted = [(point, scene, label) for point, scene in scenes for label in formulations][:PICTURES]
        best = self._best_points(wanted)
        found = []
        for point, scene, label in wanted:
            formulation = self._redrawing.formulation(label)
            if (point, scene, label) not in best or formulation is None:
                continue
            instance = self.instance(point, self._seeds[point, scene])
            picture = None if instance is None else _landscape(formulation, instance, best[point, scene, label])
            if picture is not None:
                found.append({"point": point, "scene": int(scene), "name": printable(label), **picture})
        return found

    def _best_points(self, wanted: Sequence[tuple[int, Any, str]]) -> dict[tuple[int, Any, str], ndarray]:
        """The best point that any run has found for its first problem."""
        runs, needed = self._study.runs, set(wanted)
        rows = runs[runs["formulation"].isin({label for *_, label in wanted})].to_dict("records")
        keys = {row["run_id"]: (self._study.place(row), row["scene"], row["formulation"]) for row in rows}
        best: dict[tuple[int, Any, str], tuple[float, ndarray]] = {}
        only = [run_id for run_id, key in keys.items() if key in needed]
        for run in self._study.results.traced_runs(lenient=True, only=only):
            key = keys[run.run_id]
            if not run.traces or not len(run.traces[0]):
                continue
            value = float(run.traces[0].values[-1])
            if key not in best or value < best[key][0]:
                best[key] = value, run.traces[0].points[-1]
        return {key: point for key, (_, point) in best.items()}


def _landscape(formulation: Formulation, instance: Instance, best: ndarray) -> dict[str, Any] | None:
    """The first problem over its first two unknowns through the best known point; None if it has fewer."""

    def capture(problem: Problem) -> Any:
        raise _Captured(problem)

    try:
        formulation.solve(instance, capture)
    except _Captured as captured:
        problem = captured.problem
    except Exception:  # of a plugin
        return None
    else:
        return None
    if problem.dimension < 2 or len(best) != problem.dimension:
        return None
    try:
        x, y = (np.linspace(problem.lower[i], problem.upper[i], SIDE) for i in (0, 1))
        grid = np.tile(best, (SIDE * SIDE, 1))
        grid[:, 0], grid[:, 1] = np.tile(x, SIDE), np.repeat(y, SIDE)
        values = np.asarray(problem.evaluate(grid), dtype=np.float64).reshape(SIDE, SIDE)
    except Exception as error:  # of a plugin
        raise NfbenchError(f"the landscape cannot be drawn: {explain(error)}") from error
    box = numbers([problem.lower[0], problem.upper[0], problem.lower[1], problem.upper[1]])
    return {
        "png": _picture(values),
        "box": box,
        "axes": ["unknown 1", "unknown 2"],
        "marks": [],
        "lowest": numbers(best[:2], 6),
        "unknowns": problem.dimension,
    }


def _cut(cut: Cut) -> dict[str, Any]:
    """A plane through an objective, with the true positions and the lowest value of the picture."""
    plane, scale = cut.plane(), np.array(cut.scale)
    x, y = (np.linspace(low, high, n) for low, high, n in zip(plane.lower, plane.upper, CUT, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    values = np.asarray(plane.evaluate(points), dtype=np.float64).reshape(len(y), len(x))
    corners = np.array([[plane.lower[0], plane.lower[1]], [plane.upper[0], plane.upper[1]]]) * scale
    return {
        "name": printable(cut.name),
        "about": printable(cut.about),
        "png": _picture(values),
        "box": numbers(corners.T.ravel()),
        "axes": [printable(axis) for axis in cut.axes],
        "marks": [numbers(mark) for mark in cut.marks * scale],
        "lowest": numbers(points[int(np.nanargmin(values))] * scale, 6),
        "unknowns": cut.problem.dimension,
        "spectrum": cut.spectrum,
    }


def _picture(values: ndarray) -> str:
    """The values as a picture of equal areas per shade, the smallest values darkest, as base64 of a PNG."""
    flat = np.nan_to_num(values.ravel(), nan=np.inf)
    ranks = np.empty(flat.size)
    ranks[np.argsort(flat, kind="stable")] = np.arange(flat.size)
    shades = (LEVELS * np.sqrt(ranks / flat.size)).astype(np.uint8).reshape(values.shape)[::-1]
    image = Image.fromarray(np.ascontiguousarray(shades), "P")
    image.putpalette(_palette())
    content = io.BytesIO()
    image.save(content, "PNG", optimize=True)
    return base64.b64encode(content.getvalue()).decode("ascii")


def _palette() -> list[int]:
    """From dark blue over green to light yellow, with a lightness that rises evenly, so that it works in grey."""
    stops = np.array([[48, 18, 84], [44, 90, 140], [38, 150, 130], [140, 200, 90], [250, 240, 150]], dtype=np.float64)
    at = np.linspace(0, len(stops) - 1, LEVELS)
    colours = np.column_stack([np.interp(at, np.arange(len(stops)), stops[:, c]) for c in range(3)])
    return [int(value) for value in colours.round().ravel()]
