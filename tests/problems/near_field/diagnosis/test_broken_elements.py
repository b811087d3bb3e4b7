"""Broken elements are named by what they are called; good ones are not, whatever else is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.diagnosis import Reading
from nfbench.problems.near_field.diagnosis.broken_elements import incoherent
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.scenario import NearField

BROKEN = [5, 19]


@pytest.fixture(scope="module", params=[20.0, 5.0])
def scene(request):
    """Two sources in front of 32 elements in a plane."""
    rng = np.random.default_rng(5)
    Q = np.column_stack([np.zeros(32), rng.uniform(-0.7, 0.7, (32, 2))])
    array = {"kind": "custom", "origin": "center", "positions": Q.tolist()}
    where = {"azimuth_deg": (-60, 60), "elevation_deg": (-60, 60), "range_m": (0.4, 2.0)}
    what = {"wavelength_m": 0.35, "sources": 2, "snapshots": 200, "snr_db": request.param}
    scenario = NearField(array=array, **what, **where, positions=[(-20, 15, 0.9), (25, -10, 1.2)])
    return scenario.draw(np.random.default_rng(0))


def warned(instance, **changed):
    instance = replace(instance, **changed)
    return instance.describe(GridRefine(objective="wsf").solve(instance, None).estimate, {}).warnings


@pytest.mark.parametrize("level_db", [None, -26.0, 0.0, 20.0])
def test_channels_with_noise_only_are_named_at_any_level(scene, level_db):
    Y = scene.Y.copy()
    level = 0.0 if level_db is None else 10 ** (level_db / 20) * np.sqrt(np.mean(np.abs(Y) ** 2))
    Y[BROKEN] = level * complex_normal(np.random.default_rng(1), (2, Y.shape[1]))
    texts = warned(scene, Y=Y)
    what = "receive nothing" if level_db is None else "hardly receive what the others receive"
    assert texts[0].startswith(f"elements 5 and 19 (counted from 0) {what}")
    assert texts[0].endswith("failed = [5, 19] (--failed 5,19)")
    assert not any("try sources" in text or "set sources" in text for text in texts)
    assert not warned(
        scene,
        Y=np.delete(Y, BROKEN, 0),
        manifold=replace(scene.manifold, positions=np.delete(scene.manifold.positions, BROKEN, 0)),
    )


def test_swapped_and_inverted_channels_are_named(scene):
    swapped, inverted = scene.Y.copy(), scene.Y.copy()
    swapped[BROKEN] = swapped[BROKEN[::-1]]
    inverted[5] *= -1
    first = warned(scene, Y=swapped)[0]
    assert first.startswith("elements 5 and 19 (counted from 0) do not fit the others: without them")
    assert "(--failed 5,19)" in first
    first = warned(scene, Y=inverted)[0]
    assert first.startswith("element 5 (counted from 0) does not fit the others: without it")


def test_no_element_is_blamed_for_errors_of_all(scene):
    rng = np.random.default_rng(1)
    for errors in (0.5 * rng.standard_normal(32), 0.1 * rng.standard_normal(32)):
        texts = warned(scene, Y=scene.Y * np.exp(1j * errors)[:, None])
        assert any("the model does not fit" in text for text in texts)
        assert not any("--failed" in text for text in texts)


def test_weak_sources_break_no_element():
    """Noise alone, and noise with signals far below it, have no coherence from which an element could differ."""
    for seed in range(50):
        rng = np.random.default_rng(seed)
        Y = complex_normal(rng, (32, 100))
        weak = 0.2 * np.outer(np.ones(32), complex_normal(rng, (100,)))
        assert not len(incoherent(Y)[0]) and not len(incoherent(Y + weak)[0])
    Y[:16] += 10 * weak[:16]  # half of the elements receive nothing: which of them is broken is not known
    assert not len(incoherent(Y)[0])


def test_the_coherence_is_that_of_the_covariance():
    Y = complex_normal(np.random.default_rng(0), (6, 40))
    R = Y @ Y.conj().T / 40
    expected = [
        np.quantile([abs(R[m, n]) ** 2 / (R[m, m] * R[n, n]).real for n in range(6) if n != m], 0.9) for m in range(6)
    ]
    np.testing.assert_allclose(incoherent(Y)[1], expected, rtol=1e-12)


def test_elements_are_called_by_their_names():
    rng = np.random.default_rng(0)
    Q = np.column_stack([np.zeros(16), rng.uniform(-0.3, 0.3, (16, 2))])
    array = {"kind": "custom", "origin": "center", "positions": Q.tolist()}
    where = {"azimuth_deg": (-60, 60), "elevation_deg": (-60, 60), "range_m": (0.4, 2.0), "positions": [(10, 5, 0.8)]}
    scenario = NearField(array=array, wavelength_m=0.2, sources=1, snapshots=100, snr_db=20.0, **where)
    instance = scenario.draw(np.random.default_rng(0))
    instance.Y[3] = complex_normal(rng, (100,))
    theta = GridRefine().solve(instance, None).estimate
    object.__setattr__(instance, "reading", Reading(elements=tuple(f"M{m:02}" for m in range(16))))
    assert instance.describe(theta, {}).warnings[0].startswith("element M03 hardly receives")
    assert 'failed = ["M03"] (--failed M03)' in instance.describe(theta, {}).warnings[0]
