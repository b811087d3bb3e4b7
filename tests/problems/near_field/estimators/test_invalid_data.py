"""Every near-field formulation refuses data that are not finite, with one message and before any search."""

import math
from dataclasses import replace
from importlib.metadata import entry_points

import numpy as np
import pytest

from nfbench import Formulation, Problem, load_study, run
from nfbench.core.options import build
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField

SCENE = {
    "array": {"kind": "ula", "elements": 33, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 40,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.5, 4.0],
}
MESSAGE = "Y: expected finite data, got NaN or infinite entries"


def formulations() -> dict[str, type[Formulation]]:
    """The formulations that accept near-field instances."""
    found = {entry.name: entry.load() for entry in entry_points(group="nfbench.formulations")}
    return {name: kind for name, kind in found.items() if issubclass(NearFieldInstance, kind.accepts)}


FORMULATIONS = [(name, {}) for name in formulations()]
FORMULATIONS += [("neef", {"objective": "wsf"}), ("neef", {"objective": "dml"}), ("neef", {"refine": True})]


def search(problem: Problem) -> None:
    raise AssertionError("a search was started")


def test_the_formulations_of_the_near_field_are_found():
    assert {"nemo", "nemo-niching", "neef", "music", "modified-music", "grid-refine", "learned"} <= set(formulations())


@pytest.mark.parametrize("bad", [math.nan, math.inf, complex(0, math.nan)], ids=str)
@pytest.mark.parametrize(("name", "options"), FORMULATIONS, ids=str)
@pytest.mark.parametrize("elements", [32, 33])
def test_data_that_are_not_finite_are_refused(name, options, elements, bad):
    scenario = build(NearField, SCENE | {"array": SCENE["array"] | {"elements": elements}})
    instance = scenario.draw(np.random.default_rng(0))
    Y = instance.Y.copy()
    Y[5, 7] = bad
    with pytest.raises(ValueError, match=MESSAGE):
        formulations()[name](**options).solve(replace(instance, Y=Y), search)


PLUGIN = """
from dataclasses import dataclass, replace
from nfbench import Scenario
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField

@dataclass(frozen=True)
class Broken(Scenario):
    \"\"\"A near-field scene with a NaN in its data.\"\"\"
    instance = NearFieldInstance
    def draw(self, rng):
        instance = NearField(**SCENE).draw(rng)
        instance.Y[0, 0] = float("nan")
        return instance

SCENE = dict(
    array={"kind": "ula", "elements": 16, "spacing_wavelengths": 0.25, "origin": "center"}, wavelength_m=0.02,
    sources=2, snapshots=10, snr_db=20.0, azimuth_deg=(-60, 60), range_m=(0.5, 4.0),
)
"""


def test_such_a_run_is_a_row_with_the_message(tmp_path):
    (tmp_path / "broken.py").write_text(PLUGIN)
    (tmp_path / "study.toml").write_text(
        """
        name = "broken"
        scenes = 1
        seed = 1
        plugins = ["broken.py"]
        [scenario]
        kind = "broken"
        [[formulation]]
        kind = "music"
        grid = { azimuth = 10, range = 10 }
        [[formulation]]
        kind = "neef"
        [[solver]]
        kind = "random-search"
        [budget]
        evaluations = 10
        """
    )
    results = run(load_study(tmp_path / "study.toml"), out=tmp_path / "out", jobs=1)
    assert results.runs.status.tolist() == ["failed", "failed"]
    assert all(MESSAGE in text for text in results.runs.message)
