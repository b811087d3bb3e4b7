"""What scenes and formulations say about whole traces agrees with what they say about one estimate at a time."""

import math

import numpy as np
import pytest

from nfbench.core.scenario import Instance
from nfbench.plugins import Registry

NEAR_FIELD = {
    "array": {"kind": "ula", "elements": 16, "spacing_wavelengths": 0.5, "origin": "first"},
    "wavelength_m": 0.1,
    "wavefront": "exact",
    "snapshots": 20,
    "snr_db": 15.0,
    "rician_k": math.inf,
    "azimuth_deg": [-60, 60],
    "range_m": [1.0, 5.0],
}


def scene(sources, **options):
    return (
        Registry()
        .make("scenario", "near-field", NEAR_FIELD | {"sources": sources} | options)
        .draw(np.random.default_rng(1))
    )


@pytest.mark.parametrize("sources", [1, 2, 3, 5])
@pytest.mark.parametrize("found", [1, 2, 3, 4])
def test_near_field_errors_are_those_of_score(sources, found):
    instance = scene(sources)
    estimates = np.random.default_rng(2).uniform(instance.lower, instance.upper, (7, found, 2))
    expected = [instance.score(estimate)["rmse_m"] for estimate in estimates]
    np.testing.assert_allclose(instance.errors("rmse_m", estimates), expected, rtol=1e-12)


def test_near_field_errors_in_three_dimensions_and_by_gospa_are_those_of_score():
    array = {"kind": "upa", "rows": 4, "columns": 4, "spacing_wavelengths": 0.5, "origin": "first"}
    instance = scene(2, array=array, elevation_deg=[-30, 30])
    estimates = np.random.default_rng(2).uniform(instance.lower, instance.upper, (4, 2, 3))
    for measure in ("rmse_m", "gospa_m"):
        expected = [instance.score(estimate)[measure] for estimate in estimates]
        np.testing.assert_allclose(instance.errors(measure, estimates), expected, rtol=1e-12)


@pytest.mark.parametrize("sources", [2, 4])
def test_an_estimate_that_is_not_finite_has_no_error_and_changes_no_other(sources):
    instance = scene(sources)
    estimates = np.repeat(instance.theta[None], 3, axis=0)
    estimates[1, 0, 1] = np.nan
    errors = instance.errors("rmse_m", estimates)
    assert np.isnan(errors[1])
    np.testing.assert_allclose(errors[[0, 2]], 0.0, atol=1e-12)


def test_no_source_found_has_no_error():
    instance = scene(2)
    assert np.isnan(instance.errors("rmse_m", np.empty((3, 0, 2)))).all()


def test_estimates_of_the_wrong_shape_are_refused():
    with pytest.raises(ValueError, match="estimate: expected shape"):
        scene(2).errors("rmse_m", np.zeros((2, 2, 3)))


def test_neef_returns_the_minimizer_and_so_do_its_estimates():
    instance = scene(3)
    neef = Registry().make("formulation", "neef", {})
    X = np.random.default_rng(3).uniform(np.tile(instance.lower, 3), np.tile(instance.upper, 3), (5, 6))

    class Found:
        def __init__(self, x):
            self.x = x

    for x, estimate in zip(X, neef.estimates(instance, X), strict=True):
        np.testing.assert_array_equal(neef.solve(instance, lambda _, x=x: Found(x)), estimate)
    assert Registry().make("formulation", "neef", {"refine": True}).estimates(instance, X) is None


@pytest.mark.parametrize(
    ("options", "sources", "known"),
    [({}, 1, True), ({}, 2, False), ({"refine": True}, 1, False), ({"stop_below": 1.0}, 1, False)],
)
def test_nemo_knows_its_estimates_only_if_it_searches_for_one_source(options, sources, known):
    instance = scene(sources)
    X = np.tile(instance.lower, (4, 1))
    estimates = Registry().make("formulation", "nemo", options).estimates(instance, X)
    assert (estimates is not None) == known
    if known:
        assert estimates.shape == (4, 1, 2)


SHAPES = ["sphere", "rosenbrock", "rastrigin", "ackley", "griewank", "schwefel"]


@pytest.mark.parametrize("function", SHAPES)
@pytest.mark.parametrize("measure", ["gap", "distance"])
def test_function_errors_are_those_of_score(function, measure):
    options = {"function": function, "dimension": 3, "rotated": True}
    instance = Registry().make("scenario", "functions", options).draw(np.random.default_rng(1))
    X = np.random.default_rng(2).uniform(instance.problem.lower, instance.problem.upper, (9, 3))
    expected = [instance.score(x)[measure] for x in X]
    np.testing.assert_allclose(instance.errors(measure, X), expected, rtol=1e-12)
    assert instance.problem.minimum == 0.0
    assert instance.problem.evaluate(X).min() >= 0.0


@pytest.mark.parametrize("backend", ["coco", "ioh"])
def test_bbob_states_its_minimum(backend):
    pytest.importorskip("cocoex" if backend == "coco" else "ioh")
    scenario = Registry().make("scenario", "bbob", {"function": 8, "dimension": 3, "backend": backend})
    instance = scenario.draw(np.random.default_rng(1))
    problem = instance.problem
    assert problem.minimum == pytest.approx(problem.value(problem.optimum), abs=1e-9)
    X = np.random.default_rng(2).uniform(-5, 5, (9, 3))
    np.testing.assert_allclose(instance.errors("gap", X), [instance.score(x)["gap"] for x in X], rtol=1e-12)
    np.testing.assert_allclose(instance.errors("distance", X), [instance.score(x)["distance"] for x in X])


def test_the_default_scores_one_estimate_after_the_other():
    class Plain(Instance):
        def score(self, estimate):
            return {"rmse_m": float(estimate.sum())}

    assert Plain().errors("rmse_m", np.arange(6.0).reshape(3, 2)).tolist() == [1.0, 5.0, 9.0]
    with pytest.raises(KeyError):
        Plain().errors("gap", np.ones((1, 2)))


def test_problems_and_formulations_know_nothing_by_default():
    instance = scene(1)
    assert Registry().make("formulation", "music", {}).estimates(instance, np.zeros((1, 2))) is None
    problems = []

    def stop(problem):
        problems.append(problem)
        raise StopIteration

    with pytest.raises(StopIteration):
        Registry().make("formulation", "nemo", {}).solve(instance, stop)
    assert problems[0].minimum is None
