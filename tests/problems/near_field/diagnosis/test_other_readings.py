"""A forgotten elevation, exchanged axes, mirror images, one snapshot and dependent channels are named."""

import re
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_scenes import SCENES

from nfbench.problems.near_field.bands import Band
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.diagnosis import Reading, describe_sources, spectrum
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.scenario import NearField


@pytest.fixture(scope="module")
def plane():
    """Two sources in front of 32 elements in the x-y plane of the user, which are seen from +z, and 32 snapshots."""
    rng = np.random.default_rng(5)
    Q = np.column_stack([rng.uniform(-0.7, 0.7, (32, 2)), np.zeros(32)])
    array = {"kind": "custom", "origin": "center", "positions": Q.tolist(), "broadside": "+z", "up": "+y"}
    where = {"azimuth_deg": (-60, 60), "elevation_deg": (-60, 60), "range_m": (0.4, 2.0)}
    what = {"wavelength_m": 0.35, "sources": 2, "snapshots": 32, "snr_db": 20.0}
    return NearField(array=array, **what, **where, positions=[(-20, 15, 0.9), (25, -10, 1.2)])


def localized(instance):
    return instance.describe(GridRefine(objective="wsf").solve(instance, None).estimate, {})


def test_a_forgotten_elevation_is_named(plane):
    right = plane.draw(np.random.default_rng(0))
    box = right.lower[[0, 2]], right.upper[[0, 2]]
    flat = replace(right.manifold, has_elevation=False)
    found = describe_sources([Band(right.Y, flat)], right.frame, *box, 2, np.array([[-0.3, 0.9], [0.4, 1.2]]))
    assert found.warnings[0].startswith("the sources are probably not at elevation 0")
    assert "(100 % instead of" in found.warnings[0] and "--elevation-deg -60 60" in found.warnings[0]


def test_exchanged_axes_are_named(plane):
    right = plane.draw(np.random.default_rng(0))
    theta = GridRefine().solve(replace(right, Y=right.Y.T.copy()), None).estimate
    arguments = (right.frame, right.lower, right.upper, 2)
    found = describe_sources(
        [Band(right.Y.T, right.manifold)], *arguments, theta, None, Reading(transposed=(right.Y, 1))
    )
    assert found.warnings[0].startswith("the data are probably transposed") and "--element-axis 1" in found.warnings[0]
    theta = GridRefine().solve(right, None).estimate
    assert not describe_sources(right.bands, *arguments, theta, None, Reading(transposed=(right.Y.T, 1))).warnings


def test_mirror_images_behind_a_plane_are_named_in_the_users_coordinates(plane):
    front = plane.draw(np.random.default_rng(0))
    assert not localized(front).notes
    turn = np.array([np.pi, 0.0, 0.0])
    behind = replace(front, lower=front.lower * [1, 1, 1] + turn, upper=front.upper + turn)
    found = localized(behind)
    (note,) = found.notes
    assert "the elements lie in a plane" in note and "mirror images of sources 1 and 2" in note
    images = [part.split(",") for part in re.findall(r"\((-?[0-9].*?)\) m", note)]
    for source, image in zip(found.sources, np.array(images, dtype=float), strict=True):
        np.testing.assert_allclose(image, [source["x_m"], source["y_m"], -source["z_m"]], rtol=1e-3)
        Q = front.frame.outward(front.manifold.positions)
        source = np.array([source[name] for name in ("x_m", "y_m", "z_m")])
        np.testing.assert_allclose(  # the same distances to all elements
            np.linalg.norm(Q - image, axis=1), np.linalg.norm(Q - source, axis=1), atol=1e-3
        )


def test_mirror_images_behind_a_line_are_named():
    front = SCENES["ULA of 16 elements"].draw(np.random.default_rng(0))
    assert not localized(front).notes
    turned = np.array([np.pi, 0.0])
    behind = replace(front, lower=front.lower + turned, upper=front.upper + turned)
    (note,) = localized(behind).notes
    assert "the elements lie on a line" in note and "mirror images of sources 1 and 2" in note


def test_one_snapshot_does_not_show_that_there_is_no_source(plane):
    one = plane.draw(np.random.default_rng(0))
    one = replace(one, Y=one.Y[:, :1])
    (text,) = one.describe(GridRefine(objective="dml").solve(one, None).estimate, {}).warnings
    assert text.startswith("one snapshot shows neither") and "--option objective=dml" in text


def test_channels_without_signal_or_that_depend_on_others_leave_the_noise_as_it_is():
    Y = complex_normal(np.random.default_rng(0), (20, 400))
    Y[:, :] += 3 * np.outer(np.ones(20), complex_normal(np.random.default_rng(1), (400,)))
    for dependent in (np.zeros((2, 400)), Y[[3, 4]], Y[[3, 4]] - Y[[5, 6]]):
        seen = spectrum(np.vstack([Y, dependent]))
        assert seen.significant <= 3 and seen.noise == pytest.approx(1.0, abs=0.15)
    centred = spectrum(Y[:, :15] - Y[:, :15].mean(axis=1, keepdims=True))  # removes one dimension of the snapshots
    assert centred.significant == 1 and centred.noise == pytest.approx(1.0, abs=0.2)
    without_noise = spectrum(np.outer(np.ones(20), complex_normal(np.random.default_rng(1), (400,))))
    assert (without_noise.significant, without_noise.noise) == (1, 0.0)


def test_coinciding_estimates_are_all_counted_and_no_more_sources_are_suggested():
    scene = NearField(**SCENES["ULA of 128 elements, 20 dB"].__dict__)
    instance = scene.draw(np.random.default_rng(0))
    theta = instance.theta[[0, 0, 1, 1]] + 1e-6 * np.arange(4)[:, None]
    texts = instance.describe(theta, {}).warnings
    assert any("sources 1 and 2, 3 and 4 are at nearly the same place" in text for text in texts)
    assert any("(--sources 2)" in text for text in texts)
    texts = instance.describe(instance.theta[[0, 0]] + 1e-6 * np.arange(2)[:, None], {}).warnings
    assert any("3 eigenvalues rise" in text for text in texts) and not any("try sources" in text for text in texts)
