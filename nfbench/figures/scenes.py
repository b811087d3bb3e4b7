"""The scenes of a study that figures show: redrawn from the manifest's scenario and the stored seeds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from nfbench.core import Instance, NfbenchError, Picture, explain
from nfbench.results import Results, cell
from nfbench.study import load_scenarios, scene_numbers

from .data import Drawn, chosen, key_of
from .drawing import Drawing, NotDrawnError
from .error import named

__all__ = ["first_scenes", "picture_of", "swept_key"]


def swept_key(swept: Iterable[tuple[str, Any]]) -> frozenset[tuple[str, Any]]:
    """A point of the sweep as a key."""
    return frozenset((key, cell(value)) for key, value in swept)


def first_scenes(study: Drawn, results: Results, how: Drawing) -> Iterator[tuple[Drawn, Instance, int]]:
    """Yield the first scene of up to four swept points, with its seed.

    Of plugin files, only those of ``how`` are imported, whatever the manifest names. Raises NfbenchError if a scene
    cannot be redrawn.
    """
    manifest = how.manifest or results.folder / "manifest.toml"
    numbers = scene_numbers(manifest)
    scenarios = {swept_key(swept.items()): scenario for swept, scenario in load_scenarios(manifest, how.plugins)}
    for part in chosen(study.by([column for column in study.swept if not column.startswith("budget.")])):
        key = swept_key((key_of(column), value) for column, value in part.where)
        scenario = next((found for known, found in scenarios.items() if key <= known), None)
        if scenario is None:
            raise NfbenchError(f"{manifest}: expected the scenario of the runs, found none with {named(part)}")
        seed = int(part.runs.sort_values("repetition", kind="stable")["instance_seed"].iloc[0])
        try:
            instance = scenario.draw_scene(np.random.default_rng(seed), numbers.get(seed, 0))
        except Exception as error:  # of the scenario, which may be a plugin's
            raise NfbenchError(f"{manifest}: the scene cannot be redrawn: {explain(error)}") from error
        yield part, instance, seed


def picture_of(instance: Instance) -> Picture:
    """The picture of the true sources of a scene, with the standard errors of an estimate there.

    Raises NotDrawnError if the scene has no truth or no picture.
    """
    truth = instance.truth()
    if truth is None:
        raise NotDrawnError("the true sources are not known")
    try:
        found = instance.describe(truth, {})
    except Exception as error:  # of the scenario
        raise NotDrawnError(f"the scene cannot be described: {explain(error)}") from error
    if found is None or found.picture is None:
        raise NotDrawnError("the scenario's instances have no positions to draw")
    return found.picture
