"""Tests that a run stops at a target given as a gap or an error, and that its record says what happened."""

from dataclasses import replace

import numpy as np
import pytest

from nfbench.core import Status
from nfbench.execution.run_one import execute
from nfbench.plugins import Registry
from nfbench.study import load_study

FUNCTIONS = """
name = "stopping"
scenes = 1
seed = 3
[scenario]
kind = "functions"
function = "sphere"
dimension = 3
[[formulation]]
kind = "direct"
[[solver]]
kind = "SOLVER"
[budget]
evaluations = 3000
"""
NEAR_FIELD = """
name = "stopping"
scenes = 1
seed = 3
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 16, spacing_wavelengths = 0.5, origin = "center" }
wavelength_m = 0.02
wavefront = "exact"
sources = 1
snapshots = 20
snr_db = 10.0
azimuth_deg = [-60, 60]
range_m = [0.3, 1.0]
[[formulation]]
FORMULATION
[[solver]]
kind = "de"
[budget]
evaluations = 3000
"""


@pytest.fixture
def record(tmp_path):
    def run(text, **budget):
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        spec = next(iter(load_study(path).specs()))
        method = replace(spec.method, budget={**spec.method.budget, **budget})
        return execute(replace(spec, method=method), Registry())

    return run


def functions(solver="de"):
    return FUNCTIONS.replace("SOLVER", solver)


def near_field(formulation):
    return NEAR_FIELD.replace("FORMULATION", formulation)


def test_a_run_without_a_target_has_no_column_that_says_so(record):
    scores = record(functions()).scores
    assert "target_reached" not in scores and "gradients" not in scores
    assert scores["optimum"] == 0.0


def test_a_gap_ends_the_run_at_the_first_value_that_meets_it(record):
    free, found = record(functions()), record(functions(), target={"gap": 1e-3})
    values, numbers = free.traces[0].values, free.traces[0].evaluations
    population = 50  # a whole generation is evaluated
    assert free.evaluations == 3000
    assert found.evaluations == -(-numbers[values <= 1e-3][0] // population) * population < 3000
    assert found.scores["target_reached"] == 1.0 and found.objective <= 1e-3
    assert record(functions(), target={"gap": 1e-300}).scores["target_reached"] == 0.0
    assert record(functions(), target=1e-3).scores["target_reached"] == 1.0


def test_gradients_are_a_column_where_there_were_any(record):
    found = record(near_field('kind = "neef"').replace('"de"', '"multistart-lbfgsb"').replace("3000", "200"))
    assert found.status is Status.OK and found.scores["gradients"] == found.evaluations == 200


def test_the_time_inside_the_problems_and_the_batches_are_columns(record):
    found = record(functions())
    assert 0 < found.scores["evaluation_s"] < found.runtime_s
    assert found.scores["batches"] == found.evaluations / 50 and found.scores["batched"] == found.evaluations


@pytest.mark.parametrize("kind", ["error", "error_in_bounds"])
def test_an_error_ends_the_run_and_the_estimate_keeps_it(record, kind):
    free = record(near_field('kind = "neef"'))
    bound = free.scores["crb_m"]
    value = 3.0 if kind == "error_in_bounds" else 3.0 * bound
    assert free.scores["rmse_m"] < 3.0 * bound
    found = record(near_field('kind = "neef"'), target={kind: value})
    assert found.scores["target_reached"] == 1.0 and found.scores["rmse_m"] <= 3.0 * bound
    assert found.evaluations < free.evaluations == 3000
    missed = record(near_field('kind = "neef"'), target={kind: value * 1e-9})
    assert missed.scores["target_reached"] == 0.0 and missed.evaluations == 3000
    np.testing.assert_array_equal(missed.estimate, free.estimate)  # the predicate changes nothing else


@pytest.mark.parametrize(
    ("text", "target", "message"),
    [
        (near_field('kind = "neef"'), {"gap": 0.1}, "target.gap: no reference optimum is known"),
        (near_field('kind = "neef"\nrefine = true'), {"error": 0.1}, "not a function of the minimizer of one problem"),
        (functions(), {"error_in_bounds": 3.0}, "the instance has no Cramér–Rao bound"),
    ],
)
def test_a_target_that_cannot_be_decided_skips_the_run_with_the_reason(record, text, target, message):
    found = record(text, target=target)
    assert found.status is Status.SKIPPED and message in found.message
    assert found.evaluations == 0 and "target_reached" not in found.scores


def test_a_common_start_is_the_same_for_all_methods_of_a_scene(record):
    first = [record(functions(solver), start=30, evaluations=30) for solver in ("de", "cmaes", "pso", "random-search")]
    assert len({found.objective for found in first}) == 1 and {found.evaluations for found in first} == {30}
    more = record(functions("cmaes"), start=30)
    assert more.objective < first[0].objective and more.evaluations == 3000
    found = record(functions("nlopt-direct"), start=30)
    assert (found.status, found.message) == (Status.SKIPPED, "Direct does not accept a start")


def test_a_solver_that_needs_evaluations_is_skipped_with_seconds_only(record):
    found = record(functions("l-shade"), evaluations=None, seconds=1.0)
    assert found.status is Status.SKIPPED and "needs a limit on evaluations" in found.message
