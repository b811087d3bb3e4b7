"""A scene drawn again is the same to the last bit, and nothing that a method does to it reaches the next one."""

import dataclasses

import numpy as np
import pytest

from nfbench.problems.near_field import cached_draw, instance
from nfbench.problems.near_field.bounds import position_bounds
from nfbench.problems.near_field.scenario import NearField

BASE = {
    "array": {"kind": "ula", "elements": 16, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 20,
    "snr_db": 10.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.1, 1.0],
}
VARIANTS = {
    "line of sight": {},
    "fading": {"rician_k": 3.0, "fading": "snapshot"},
    "impaired": {"impairments": {"gain_error_db": 1.0, "phase_error_deg": 10.0}},
}


def draw(scenario, seed):
    return scenario.draw(np.random.default_rng(seed))


def arrays(instance):
    return {name: value for name, value in vars(instance).items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_scene_drawn_again_is_that_of_a_new_process(name, monkeypatch):
    scenario = NearField(**BASE, **VARIANTS[name])
    first = draw(scenario, 5)
    again = draw(NearField(**BASE, **VARIANTS[name]), 5)
    monkeypatch.setattr(cached_draw, "_last", None)
    fresh = draw(scenario, 5)
    assert len(arrays(fresh)) >= 5
    for key, values in arrays(fresh).items():
        np.testing.assert_array_equal(arrays(first)[key], values)
        np.testing.assert_array_equal(arrays(again)[key], values)
        assert not np.shares_memory(arrays(first)[key], arrays(again)[key])
    assert first.bounds() == fresh.bounds() == again.bounds()


def test_another_seed_or_scenario_is_another_scene():
    scenario = NearField(**BASE)
    kept = draw(scenario, 5).Y
    assert not np.array_equal(draw(scenario, 6).Y, kept)
    draw(scenario, 5)
    louder = draw(NearField(**{**BASE, "snr_db": 20.0}), 5)
    assert not np.array_equal(louder.Y, kept)
    np.testing.assert_array_equal(draw(scenario, np.random.SeedSequence(5)).Y, kept)
    assert not np.array_equal(draw(scenario, np.random.SeedSequence(5, spawn_key=(1,))).Y, kept)


def test_a_generator_that_has_spawned_before_gives_another_scene():
    scenario, rng = NearField(**BASE), np.random.default_rng(5)
    first, second = scenario.draw(rng), scenario.draw(rng)
    assert not np.array_equal(first.Y, second.Y)


def test_writing_to_a_scene_does_not_change_the_next_one():
    scenario = NearField(**BASE)
    bounds = draw(scenario, 5).bounds()
    draw(scenario, 6)  # so that the bounds of the scene are not known yet
    first = draw(scenario, 5)
    kept = first.Y.copy()
    first.Y[:] = 0
    first.theta[:] = 1
    first.bounds()["crb_m"] = 0.0
    np.testing.assert_array_equal(draw(scenario, 5).Y, kept)
    assert draw(scenario, 5).bounds() == bounds


def test_a_large_scene_is_not_kept(monkeypatch):
    monkeypatch.setattr(cached_draw, "LARGEST", 16 * 16 * 20 - 1)  # bytes of Y alone
    monkeypatch.setattr(cached_draw, "_last", None)
    first = draw(NearField(**BASE), 5)
    assert cached_draw._last is None
    np.testing.assert_array_equal(draw(NearField(**BASE), 5).Y, first.Y)


def test_the_bounds_are_computed_once_for_all_copies(monkeypatch):
    scenario, calls = NearField(**BASE), []
    expected = draw(scenario, 7).bounds()
    draw(scenario, 8)
    monkeypatch.setattr(instance, "position_bounds", lambda *args: calls.append(1) or position_bounds(*args))
    assert [draw(scenario, 7).bounds() for _ in range(3)] == [expected] * 3
    assert len(calls) == 2  # the stochastic and the deterministic bounds


def test_a_changed_scene_has_bounds_of_its_own():
    instance = draw(NearField(**BASE), 5)
    before = instance.bounds()["crb_m"]
    louder = dataclasses.replace(instance, snr=instance.snr * 100)
    assert louder.bounds()["crb_m"] == pytest.approx(before / 10, rel=0.2)


@pytest.mark.parametrize("name", VARIANTS)
def test_the_truth_of_a_scene_scores_estimates_as_the_scene_does(name):
    scenario = NearField(**BASE, **VARIANTS[name])
    scene, truth = draw(scenario, 5), scenario.draw_truth(np.random.default_rng(5), 0)
    estimates = np.random.default_rng(1).uniform([-1.0, 0.1], [1.0, 1.0], (50, 2, 2))
    np.testing.assert_array_equal(truth.theta, scene.theta)
    np.testing.assert_array_equal(truth.errors("rmse_m", estimates), scene.errors("rmse_m", estimates))
    assert truth.Y.size == 0
