"""The cuts of a scene go through the true sources, and show the objectives that the formulations minimize."""

import numpy as np
import pytest

from nfbench.execution import first_problem
from nfbench.plugins import Registry

OPTIONS = {
    "wavelength_m": 0.02, "sources": 2, "snapshots": 400, "snr_db": 40.0, "azimuth_deg": [-60, 60],
    "range_m": [0.1, 0.5], "min_separation_deg": 20.0,
}  # fmt: skip
LINE = {"kind": "ula", "elements": 16, "spacing_wavelengths": 0.5, "origin": "center"}
PLANE = {"kind": "upa", "columns": 5, "rows": 5, "spacing_wavelengths": 0.5, "origin": "center"}


def drawn(array, **options):
    scenario = Registry().make("scenario", "near-field", {**OPTIONS, "array": array, **options})
    return scenario.draw(np.random.default_rng(3))


@pytest.mark.parametrize(("kind", "number"), [("nemo", 0), ("neef", 1)])
def test_a_cut_has_the_values_of_the_problem_that_is_minimized(kind, number):
    instance = drawn(LINE)
    problem = first_problem(Registry().make("formulation", kind, {}), instance)
    cut = instance.cuts()[number]
    x = problem.lower + 0.3 * (problem.upper - problem.lower)
    full = np.array(cut.through)
    full[list(cut.free)] = x[list(cut.free)]
    at = x[list(cut.free)]
    assert cut.plane().evaluate(at[None]) == pytest.approx(problem.evaluate(full[None]), rel=1e-9)
    value, gradient = cut.plane().value_and_gradient(at)
    step = 1e-6 * (cut.plane().upper - cut.plane().lower)
    slopes = [(cut.plane().value(at + e) - cut.plane().value(at - e)) / (2 * e.sum()) for e in np.diag(step)]
    assert value == pytest.approx(cut.plane().value(at)) and gradient == pytest.approx(np.array(slopes), rel=1e-3)


def test_esf_and_the_spectrum_are_lowest_near_the_truth():
    instance = drawn(LINE)
    _, esf, music = instance.cuts()
    for cut, at in ((esf, instance.theta[0]), (music, instance.theta[1])):
        plane = cut.plane()
        grid = plane.lower + np.random.default_rng(0).random((2000, 2)) * (plane.upper - plane.lower)
        assert plane.value(at) < plane.evaluate(grid).min() + 1e-3
    assert music.spectrum and not esf.spectrum and music.marks == pytest.approx(instance.theta)


def test_with_elevation_there_are_two_planes_of_each_and_marks_lie_in_them():
    instance = drawn(PLANE, elevation_deg=[-30, 30])
    cuts = instance.cuts()
    assert [cut.axes for cut in cuts[:2]] == [("Azimuth [°]", "Range [m]"), ("Azimuth [°]", "Elevation [°]")]
    assert len(cuts) == 6 and [cut.free for cut in cuts] == [(0, 2), (0, 1)] * 3
    for cut in cuts:
        assert cut.marks == pytest.approx(instance.theta[:1, list(cut.free)])


def test_with_fewer_snapshots_than_sources_there_is_rls_only():
    assert [cut.name for cut in drawn(LINE, snapshots=1).cuts()] == ["RLS"]
