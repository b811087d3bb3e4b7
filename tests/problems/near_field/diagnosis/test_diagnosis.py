"""What is reported about data, model and estimate: each mistake by its name, and rarely anything if all is right."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_scenes import LARGE, PLANE, SCENES, ula

from nfbench.problems.near_field.bands import Band
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.diagnosis import diagnose
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.geometry import Frame
from nfbench.problems.near_field.scenario import NearField

NOTHING = np.empty((0, 3))


def localized(instance):
    return GridRefine(objective="wsf").solve(instance, None).estimate


def warned(instance, theta=None):
    theta = localized(instance) if theta is None else theta
    return instance.describe(theta, {}).warnings


@pytest.fixture(scope="module")
def irregular():
    """A scene of an array without symmetry in the x-y plane of the user, seen from +z; conjugation shows in it."""
    rng = np.random.default_rng(5)
    Q = np.column_stack([rng.uniform(-0.7, 0.7, (48, 2)), np.zeros(48)])
    array = {"kind": "custom", "origin": "center", "positions": Q.tolist(), "broadside": "+z", "up": "+y"}
    scene = {"wavelength_m": 0.35, "sources": 2, "snapshots": 100, "snr_db": 15.0}
    where = {"azimuth_deg": (-60, 60), "elevation_deg": (-60, 60), "range_m": (0.4, 2.0)}
    return NearField(array=array, **scene, **where, positions=[(-20, 15, 0.9), (25, -10, 1.2)])


@pytest.mark.parametrize("scene", [pytest.param(s, marks=[pytest.mark.slow] * (i % 2)) for i, s in enumerate(SCENES)])
def test_a_right_model_is_rarely_doubted(scene):
    """At most one of 60 scenes of each kind, apart from estimates on the edge of the box, which are facts."""
    kinds = Counter()
    for seed in range(60):
        instance = SCENES[scene].draw(np.random.default_rng(1000 + seed))
        kinds.update({text[:30] for text in warned(instance) if "on the edge" not in text})
    assert sum(kinds.values()) <= 1, kinds


def test_conjugated_data_are_named(irregular):
    instance = irregular.draw(np.random.default_rng(0))
    assert not warned(instance)
    (first, *_) = warned(replace(instance, Y=instance.Y.conj()))
    assert "your phase convention is the opposite one" in first and "--conjugate" in first


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "mm"), (1e2, "cm"), (1 / 0.0254, "in"), (1e-3, "m")])
def test_wrong_units_are_named(irregular, factor, unit):
    instance = irregular.draw(np.random.default_rng(0))
    wrong = replace(instance, manifold=replace(instance.manifold, positions=instance.manifold.positions * factor))
    first = warned(wrong, NOTHING)[0]
    assert f'set unit = "{unit}" (--unit {unit})' in first


@pytest.mark.parametrize(("broadside", "up"), [("+x", "+z"), ("+y", "+z"), ("-x", "+y")])
def test_a_turned_array_is_named(irregular, broadside, up):
    right = irregular.draw(np.random.default_rng(0))
    array = replace(irregular.array, broadside=broadside, up=up)
    wrong = replace(right, manifold=replace(right.manifold, positions=array.place(0.35)), frame=array.frame(0.35))
    assert "--broadside +z" in warned(wrong)[0]


def test_channels_in_reverse_order_are_named(irregular):
    instance = irregular.draw(np.random.default_rng(0))
    assert "reverse the rows of the positions" in warned(replace(instance, Y=instance.Y[::-1].copy()))[0]


def test_a_model_that_does_not_fit_is_quantified():
    scenario = NearField(**LARGE, snr_db=20.0, rician_k=3.0, fading="block")
    (first, *_) = warned(scenario.draw(np.random.default_rng(0)))
    assert first.startswith("the model does not fit: it explains") and "standard errors are too small" in first


def test_an_estimate_that_is_not_the_best_is_named():
    instance = SCENES["ULA of 128 elements, 20 dB"].draw(np.random.default_rng(0))
    wrong = np.clip(instance.theta + np.array([0.3, 0.0]), instance.lower, instance.upper)
    assert any("the estimate is not the best fit" in text for text in warned(instance, wrong))


@pytest.mark.parametrize(("sources", "sentence"), [(2, "3 eigenvalues rise"), (4, "only 3 eigenvalues rise")])
def test_a_wrong_number_of_sources_is_named(sources, sentence):
    instance = SCENES["ULA of 128 elements, 20 dB"].draw(np.random.default_rng(0))
    theta = GridRefine(sources=sources, objective="wsf").solve(instance, None).estimate
    assert any(text.startswith(sentence) for text in warned(instance, theta))


def test_noise_alone_shows_no_source():
    instance = SCENES["ULA of 16 elements"].draw(np.random.default_rng(0))
    noise = replace(instance, Y=complex_normal(np.random.default_rng(0), instance.Y.shape))
    assert any(text.startswith("no eigenvalue of the data rises") for text in warned(noise))


def test_estimates_on_the_edge_are_named_with_the_option():
    scenario = SCENES["UPA of 8 × 8 elements"]
    instance = scenario.draw(np.random.default_rng(0))
    theta = instance.theta.copy()
    theta[0, 2], theta[1, 1] = instance.upper[2], instance.lower[1]
    texts = [text for text in warned(instance, theta) if "on the edge" in text]
    assert len(texts) == 2
    assert "source 2" in texts[0] and "elevation -60°" in texts[0] and "--elevation-deg" in texts[0]
    assert "source 1" in texts[1] and "range 2 m" in texts[1] and "--range-m" in texts[1]


def test_a_full_circle_has_no_edge():
    circle = {"kind": "uca", "elements": 12, "radius_wavelengths": 0.8, "origin": "center"}
    scene = {"wavelength_m": 0.1, "sources": 1, "snapshots": 100, "snr_db": 20.0}
    scenario = NearField(array=circle, **scene, azimuth_deg=(-180, 180), range_m=(0.2, 0.6))
    instance = scenario.draw(np.random.default_rng(0))
    theta = np.array([[np.pi, 0.4]])
    assert not any("on the edge" in text for text in warned(replace(instance, theta=theta), theta))


def test_both_sides_of_a_plane_are_named():
    scenario = NearField(**{**PLANE, "azimuth_deg": (-170, 170)}, snr_db=10.0)
    texts = warned(scenario.draw(np.random.default_rng(0)))
    assert any("the box contains both sides of the array" in text and "in a plane" in text for text in texts)
    assert not any("is ambiguous" in text for text in texts)  # which would say the same


def test_aliases_of_a_sparse_array_are_named_with_the_other_place():
    array = ula(16, 1.0)
    where = {"azimuth_deg": (-60, 60), "range_m": (3.0, 40.0), "positions": [(20.0, 20.0)]}
    scenario = NearField(array=array, wavelength_m=0.1, sources=1, snapshots=50, snr_db=20.0, **where)
    texts = [text for text in warned(scenario.draw(np.random.default_rng(0))) if "is ambiguous" in text]
    other = np.degrees(np.arcsin(np.sin(np.radians(20)) - 1))  # one wavelength of path per element
    assert len(texts) == 1 and "the elements are 1 wavelengths apart" in texts[0]
    place = float(texts[0].partition("azimuth ")[2].partition("°")[0])
    assert place == pytest.approx(other, abs=1.5)


def test_coincident_estimates_are_named():
    instance = SCENES["ULA of 16 elements"].draw(np.random.default_rng(0))
    theta = instance.theta[[0, 0]] + np.array([[0.0, 0.0], [1e-5, 0.0]])
    assert any("sources 1 and 2 are at nearly the same place" in text for text in warned(instance, theta))


def test_data_that_no_array_receives_are_named():
    instance = SCENES["ULA of 16 elements"].draw(np.random.default_rng(0))
    box = instance.lower, instance.upper
    arguments = (Frame(np.eye(3), np.zeros(3)), *box, 2, instance.theta)
    damaged = instance.Y.copy()
    damaged[3, 7] = np.nan
    assert "first at element 3, snapshot 7" in diagnose([Band(damaged, instance.manifold)], *arguments).warnings[0]
    assert "all zero" in diagnose([Band(0 * instance.Y, instance.manifold)], *arguments).warnings[0]
    assert "--sample-rate-hz" in diagnose([Band(instance.Y.real + 0j, instance.manifold)], *arguments).warnings[0]
