"""Methods for uniform linear arrays: what they refuse and with which sentence, and what they do in hostile scenes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from line_scenes import PAPER, THREE, noise_free, scene
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible, Solution
from nfbench.core.options import build
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.generalized_esprit import GeneralizedEsprit
from nfbench.problems.near_field.estimators.linear_prediction import LinearPrediction
from nfbench.problems.near_field.estimators.reduced_dimension_music import ReducedDimensionMusic
from nfbench.problems.near_field.estimators.subarray_music import SubarrayMusic
from nfbench.problems.near_field.scenario import NearField

TITLES = {
    SubarrayMusic: "subarray MUSIC",
    GeneralizedEsprit: "generalized ESPRIT",
    ReducedDimensionMusic: "reduced-dimension MUSIC",
    LinearPrediction: "linear prediction",
}
CENTRED = [
    GeneralizedEsprit,
    ReducedDimensionMusic,
    LinearPrediction,
]  # those that need a centred array and a spacing below λ/4
METHODS = list(TITLES)
OPTIONS = [{}, {"refine": True}]


def name(value) -> str:
    return value.__name__ if isinstance(value, type) else "-".join(value) or "plain"


def estimate(method, instance, **options) -> np.ndarray:
    found = method(**options).solve(instance, None)
    return found.estimate if isinstance(found, Solution) else found


# refusals


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize(
    ("array", "changes", "reason"),
    [
        ({}, {"snapshots": 2}, r"snapshots: expected at least 3 .* got 2"),
        ({}, {"elevation_deg": [-30, 30]}, r"elevation_deg: expected none, as {title} works in the plane only"),
        ({}, {"wavefront": "planar"}, r'wavefront: expected "exact", "fresnel" or "paper" for {title}, got "planar"'),
        ({}, {"bins": 3, "bandwidth_relative": 0.1}, r"bins: expected 1 for .*, got 3"),
    ],
)
def test_unsuitable_scenes_are_declined(method, array, changes, reason):
    with pytest.raises(Incompatible, match=reason.format(title=TITLES[method])):
        estimate(method, scene(0, array, **changes))


@pytest.mark.parametrize("method", CENTRED, ids=name)
@pytest.mark.parametrize(
    ("array", "changes", "reason"),
    [
        ({"origin": "first"}, {}, r'array.origin: expected "center" for {title}, got another origin'),
        ({"spacing_wavelengths": 0.5}, {}, r"a spacing below .* = 0.2887 λ for {title}, got 0.5 λ"),
        ({}, {"azimuth_deg": [-60, 90]}, r"= 0.25 λ for {title}, got 0.25 λ"),
    ],
)
def test_arrays_without_symmetric_and_unambiguous_phases_are_declined(method, array, changes, reason):
    with pytest.raises(Incompatible, match=reason.format(title=TITLES[method])):
        estimate(method, scene(0, array, **changes))


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize(
    "array",
    [
        {"kind": "upa", "columns": 16, "rows": 2, "spacing_wavelengths": 0.25, "origin": "center"},
        {"kind": "uca", "elements": 32, "radius_wavelengths": 4.0, "origin": "center"},
        {"kind": "custom", "origin": "center", "positions": [[0, y, 0] for y in (0, 1, 2, 3, 4, 5, 7)]},
        {"kind": "custom", "origin": "center", "positions": [[y, 0, 0] for y in range(9)]},
    ],
    ids=["upa", "uca", "gaps", "along-x"],
)
def test_only_a_uniform_linear_array_along_y_is_accepted(method, array):
    instance = build(NearField, PAPER | {"array": array, "sources": 1}).draw(np.random.default_rng(0))
    with pytest.raises(Incompatible, match=f"uniform linear array along y for {TITLES[method]}"):
        estimate(method, instance)


@pytest.mark.parametrize("method", METHODS, ids=name)
def test_known_gains_are_refused_unless_they_are_phases(method):
    impaired = scene(0, impairments={"gain_error_db": 3.0}, **THREE)
    with pytest.raises(Incompatible, match=f"expected phases only for {TITLES[method]}"):
        estimate(method, impaired, known_gains=True)
    turned = scene(0, impairments={"phase_error_deg": 60.0}, **THREE)
    known, unknown = (estimate(method, turned, known_gains=known, refine=True) for known in (True, False))
    assert turned.score(known)["rmse_m"] < 0.05 < turned.score(unknown)["rmse_m"]


@pytest.mark.parametrize("method", METHODS, ids=name)
def test_failed_elements_that_are_known_leave_gaps(method):
    with pytest.raises(Incompatible, match="expected a uniform linear array"):
        estimate(method, scene(0, impairments={"failed_elements": [3]}), known_failed=True)


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize("elements", [9, 10])
def test_almost_as_many_sources_as_elements_are_refused(method, elements):
    array = {"elements": elements}
    with pytest.raises(Incompatible, match=rf"more than \d+ elements for {elements - 1} sources"):
        estimate(method, scene(0, array, sources=elements - 1, range_m=[0.1, 2.0]))


# hostile scenes


HOSTILE = {
    "coincident": {"positions": [[10, 3.0], [10, 3.0], [-30, 4.0]]},
    "same angle": {"positions": [[10, 2.0], [10, 8.0], [-30, 4.0]]},
    "coherent": {"source_correlation": 1.0, **THREE},
    "endfire": {"azimuth_deg": [-89, 89], "positions": [[-88.9, 3.0], [88.9, 3.0], [10.0, 4.0]]},
    "edge of the box": {"positions": [[-60, 1.27], [60, 20.16], [0.0, 1.27]]},
    "as many snapshots as sources": {"snapshots": 3, **THREE},
    "noise only": {"snr_db": -60.0, **THREE},
    "strong and weak": {"snr_db": [60.0, 0.0, -20.0], **THREE},
    "few elements": {"positions": [[10, 0.5]], "sources": 1, "range_m": [0.2, 2.0]},
}


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize("options", OPTIONS, ids=name)
@pytest.mark.parametrize(("elements", "wavefront"), [(32, "exact"), (33, "fresnel"), (33, "paper")])
@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_scenes_give_an_estimate_in_the_box(method, options, elements, wavefront, case):
    changes = dict(HOSTILE[case])
    correlation = changes.pop("source_correlation", None)
    if correlation is not None:
        changes["impairments"] = {"source_correlation": correlation}
    count = 5 if case == "few elements" else elements
    array = {"elements": count, "spacing_wavelengths": 0.24}
    instance = scene(1, array, wavefront=wavefront, **changes)
    found = estimate(method, instance, **options)
    assert np.isfinite(found).all() and 1 <= len(found) <= instance.sources
    assert (found >= instance.lower).all() and (found <= instance.upper).all()


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize("options", OPTIONS, ids=name)
def test_silence_gives_an_estimate_or_none(method, options):
    """All data are 0, as of a recording of a receiver that is switched off."""
    instance = scene(0)
    found = estimate(method, replace(instance, Y=np.zeros_like(instance.Y)), **options)
    assert np.isfinite(found).all() and len(found) <= 3


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize("bad", [math.nan, math.inf], ids=str)
def test_data_that_are_not_finite_are_refused(method, bad):
    instance = scene(0)
    Y = instance.Y.copy()
    Y[3, 4] = bad
    with pytest.raises(ValueError, match="Y: expected finite data, got NaN or infinite entries"):
        estimate(method, replace(instance, Y=Y))


@pytest.mark.parametrize("method", METHODS, ids=name)
def test_the_number_of_sources_may_be_estimated_or_wrong(method):
    instance = scene(0, **THREE)
    assert len(estimate(method, instance, sources="estimate")) == 3
    assert len(estimate(method, instance, sources=2)) == 2
    noise = np.random.default_rng(0).normal(size=(2, *instance.Y.shape))
    nothing = replace(instance, Y=noise[0] + 1j * noise[1])
    for options in OPTIONS:
        assert estimate(method, nothing, sources="estimate", **options).shape == (0, 2)


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize("options", OPTIONS, ids=name)
def test_the_same_data_give_the_same_estimate(method, options):
    instance = scene(3)
    assert_array_equal(estimate(method, instance, **options), estimate(method, instance, **options))


@pytest.mark.parametrize("method", METHODS, ids=name)
@pytest.mark.parametrize("elements", [127, 128])
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
def test_refined_estimates_are_exact_without_noise(method, elements, wavefront):
    instance = noise_free(0, {"elements": elements}, wavefront=wavefront, **THREE)
    found = estimate(method, instance, refine=True)
    assert_allclose(found[np.argsort(found[:, 0])], instance.theta, rtol=1e-6)


@pytest.mark.parametrize("method", METHODS, ids=name)
def test_a_mirrored_array_gives_the_same_estimate(method):
    """The elements may be numbered from either end."""
    instance = scene(0, **THREE)
    manifold = replace(instance.manifold, positions=instance.manifold.positions[::-1])
    mirrored = replace(instance, Y=instance.Y[::-1], manifold=manifold)
    found, other = (estimate(method, each) for each in (instance, mirrored))
    order, other_order = np.argsort(found[:, 0]), np.argsort(other[:, 0])
    assert_allclose(other[other_order], found[order], rtol=1e-5)


@pytest.mark.parametrize("method", METHODS, ids=name)
def test_it_is_built_from_a_manifest_table(method):
    kind = TITLES[method].lower().replace(" ", "-")
    formulation = Registry().make("formulation", kind, {"refine": True})
    assert formulation == method(refine=True)
    assert not formulation.needs_solver
