"""Whole certificates: no search finds less than they say, and what cannot be proven is refused."""

import math

import certificate_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.certificate import certify
from nfbench.problems.near_field.certificate.certify import _leaf_couplings, _Proof
from nfbench.problems.near_field.certificate.regions import prune_box

LINE, PAPER, PLANE = scenes.LINE, scenes.PAPER, scenes.PLANE
SHORT = scenes.SHORT
CERTIFIED = [
    (LINE, 1, 10.0, 0),
    (LINE, 2, 20.0, 1),
    (LINE, 3, 10.0, 2),
    (LINE, 5, 20.0, 3),
    (PAPER, 1, 20.0, 0),
    (PAPER, 2, 10.0, 1),
    (PAPER, 3, 20.0, 2),
    (PLANE, 1, 10.0, 0),
    (PLANE, 3, 20.0, 0),
    (SHORT, 3, 10.0, 1),
    (SHORT | {"wavefront": "fresnel"}, 3, 20.0, 2),
    (scenes.CUSTOM, 2, 20.0, 0),
]


def starts(instance, theta, rng, count):
    """Random, perturbed and doubled sources."""
    width = instance.upper - instance.lower
    for n in range(count):
        random = rng.uniform(instance.lower, instance.upper, theta.shape)
        if n % 3 == 0:
            yield random
        elif n % 3 == 1:
            yield theta + 10 ** rng.uniform(-3, 0) * width * rng.standard_normal(theta.shape)
        else:
            start, (j, k) = theta.copy(), rng.choice(len(theta), 2, replace=len(theta) == 1)
            start[j] = theta[k] + 1e-3 * width * rng.standard_normal(len(width)) if j != k else random[j]
            yield start


def attacked(instance, proof, seed, count):
    """Assert that no local search ends below J − gap; returns local minima that are not global."""
    U, rng = scenes.subspace(instance), np.random.default_rng(seed)
    others = []
    for start in [instance.theta, *starts(instance, proof.theta, rng, count)]:
        x = scenes.local_minimum(U, instance, start)
        J = scenes.misfit(U, instance.manifold, x)
        assert proof.J - proof.gap - 1e-11 <= J
        if J > proof.J + 1e-6:
            others.append(x)
    return others


@pytest.mark.parametrize(("manifest", "K", "snr", "seed"), CERTIFIED)
def test_no_search_ends_below_a_certified_minimum(manifest, K, snr, seed):
    instance = scenes.draw(manifest, seed, sources=K, snr_db=snr)
    found = scenes.estimate(instance)
    proof = scenes.certify_scene(instance, found)
    U = scenes.subspace(instance)
    assert proof.certified and proof.step == 0 and proof.regions == K and 0 <= proof.gap < 1e-10
    assert pytest.approx(scenes.misfit(U, instance.manifold, proof.theta), abs=1e-11) == proof.J
    assert scenes.misfit(U, instance.manifold, found) + 1e-11 >= proof.J
    others = attacked(instance, proof, seed, 9)
    assert others  # some searches fail, as they should for this to be an attack
    for x in others[:4]:  # a local minimum is not certified, unless the polishing leads to the global one
        again = scenes.certify_scene(instance, x)
        assert not again.certified or pytest.approx(proof.J, abs=1e-9) == again.J
        assert again.J - again.gap <= proof.J + 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("snr", [0.0, 10.0, 30.0])
@pytest.mark.parametrize("manifest", [LINE, PAPER, PLANE])
@pytest.mark.parametrize("K", [1, 2, 3, 5])
def test_no_search_ends_below_a_bound_in_many_scenes(manifest, K, snr):
    for seed in range(10, 14):
        instance = scenes.draw(manifest, seed, sources=K, snr_db=snr, min_separation_deg=0.0)
        attacked(instance, scenes.certify_scene(instance), seed, 30)


def test_the_gap_is_proven_where_no_certificate_is_given():
    refused = 0
    for seed in range(12):
        instance = scenes.draw(SHORT, seed, sources=3, snr_db=-5.0, min_separation_deg=0.0)
        proof = scenes.certify_scene(instance)
        refused += not proof.certified
        assert 0 <= proof.gap <= proof.J + 1e-11
        attacked(instance, proof, seed, 3)
    assert refused >= 3


@pytest.mark.parametrize("separation", [0.2, 0.5])
def test_close_sources_are_never_certified_with_a_wrong_estimate(separation):
    for seed, snr in enumerate((10.0, 20.0, 30.0, 40.0)):
        azimuth, r = -20.0 + 11 * seed, 2.0 + seed
        positions = ((azimuth, r), (azimuth + separation, r * 1.1))
        instance = scenes.draw(LINE, seed, sources=2, snr_db=snr, positions=positions, min_separation_deg=0.0)
        best = scenes.certify_scene(instance)
        merged = scenes.certify_scene(instance, np.array([instance.theta[0], instance.theta[0] + [1e-7, 0]]))
        assert not merged.certified or merged.J <= best.J + 1e-9
        for x in attacked(instance, best, seed, 3):
            again = scenes.certify_scene(instance, x)
            assert not again.certified or again.J <= best.J + 1e-9


@pytest.mark.parametrize("manifest", [LINE, PAPER])
def test_sources_on_faces_and_in_corners_of_the_box(manifest):
    (low, high), (near, far) = manifest["azimuth_deg"], manifest["range_m"]
    places = [(low, 3.0), (high, near), (0.0, near), (10.0, far), (high, far), (low, near)]
    on_edge = 0
    for seed in range(6):
        positions = (places[seed], places[(seed + 2) % 6])
        instance = scenes.draw(manifest, seed, sources=2, snr_db=20.0, positions=positions)
        proof = scenes.certify_scene(instance)
        assert proof.certified and proof.gap < 1e-10
        on_edge += int(np.sum((proof.theta == instance.lower) | (proof.theta == instance.upper)))
        attacked(instance, proof, seed, 3)
    assert on_edge >= 4  # or the scenes do not test what they should


@pytest.mark.parametrize("origin", ["center", "first"])
def test_ranges_down_to_little_more_than_the_radius(origin):
    array = SHORT["array"] | {"origin": origin}
    radius = 0.155 if origin == "center" else 0.31
    certified = 0
    for seed in range(4):
        instance = scenes.draw(SHORT, seed, array=array, sources=2, snr_db=20.0, range_m=[1.3 * radius, 10 * radius])
        proof = scenes.certify_scene(instance)
        certified += proof.certified
        attacked(instance, proof, seed, 3)
    assert certified >= 3


def test_both_sides_of_a_line_are_refused():
    positions = ((50.0, 1.0), (-100.0, 2.0))
    instance = scenes.draw(SHORT, 1, azimuth_deg=[-170, 170], sources=2, positions=positions)
    proof = scenes.certify_scene(instance)
    assert not proof.certified and proof.step == 5 and proof.regions >= 4
    half = scenes.draw(SHORT, 1, sources=2, positions=((50.0, 1.0), (-50.0, 2.0)))
    assert scenes.certify_scene(half).certified


def test_coinciding_and_meaningless_estimates_are_refused():
    instance = scenes.draw(SHORT, 2, sources=3)
    theta = scenes.estimate(instance)
    U = scenes.subspace(instance)
    for x in (theta[[0, 0, 1]], theta[[0, 0, 0]], np.tile(instance.lower, (3, 1)), theta * (1 + 1e-9)):
        proof = scenes.certify_scene(instance, x)
        assert pytest.approx(scenes.misfit(U, instance.manifold, proof.theta), abs=1e-8) == proof.J
        assert proof.certified == (proof.J < 0.1) and (proof.certified or proof.step in (1, 3))
    doubled = theta[[0, 1, 1]]
    doubled[2, 0] += 1e-5
    proof = scenes.certify_scene(instance, doubled)
    assert not proof.certified and proof.step in (1, 3) and math.isfinite(proof.gap)


def test_noise_without_signal_is_refused():
    instance = scenes.draw(SHORT, 3)
    rng = np.random.default_rng(0)
    U = np.linalg.qr(rng.standard_normal((32, 3)) + 1j * rng.standard_normal((32, 3)))[0]
    proof = certify(U, instance.manifold, instance.lower, instance.upper, instance.theta)
    assert not proof.certified and proof.step == 1 and proof.gap == pytest.approx(proof.J)


def test_exact_data_is_certified():
    instance = scenes.draw(SHORT, 4, sources=3)
    U = np.linalg.qr(instance.manifold.response(instance.theta).T)[0]
    proof = certify(U, instance.manifold, instance.lower, instance.upper, instance.theta)
    assert proof.certified and proof.J < 1e-13 and proof.gap < 2e-11
    assert_allclose(proof.theta, instance.theta, rtol=1e-6)


def test_couplings_of_leaves_bound_those_of_their_points():
    instance = scenes.draw(SHORT, 5, sources=3, snr_db=5.0)
    theta = scenes.estimate(instance)
    proof = _Proof(scenes.subspace(instance), instance.manifold, instance.lower, instance.upper, theta)
    leaves, chart = prune_box(proof.cells, proof.rows, proof.f, 1 / 4), proof.chart
    coupled = _leaf_couplings(leaves, chart)
    rng = np.random.default_rng(6)
    assert leaves.regions >= 3 and (coupled == coupled.T).all() and (np.diag(coupled) == 0).all()
    for _ in range(20):
        C = leaves.centres + leaves.halves * rng.uniform(-1, 1, leaves.centres.shape)
        a = scenes.responses(chart, C)
        found = np.abs(a.conj() @ a.T)
        for k in range(leaves.regions):
            for j in range(k):
                block = found[np.ix_(leaves.region == k, leaves.region == j)]
                assert block.max() <= coupled[k, j] + 1e-12


def test_thresholds_of_regions_that_have_become_empty_are_dropped():
    instance = scenes.draw(SHORT, 6, sources=2, snr_db=10.0)
    theta = scenes.estimate(instance)
    proof = _Proof(scenes.subspace(instance), instance.manifold, instance.lower, instance.upper, theta)
    leaves = prune_box(proof.cells, proof.rows, proof.f, 1 / 4)
    assert leaves.regions == 2
    kept, thresholds = proof.discard(leaves, np.array([0.1, 0.2, 0.3]))
    assert kept.regions == 2 and (thresholds == [0.1, 0.2]).all()
