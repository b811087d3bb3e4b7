"""Generalized ESPRIT: agreement with a naive implementation, exact estimates, false peaks, what the method claims."""

import numpy as np
import oracles
import pytest
from line_scenes import PAPER, THREE, in_order, noise_free, scene, signal_subspace, solve
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible
from nfbench.core.options import build
from nfbench.problems.near_field.estimators.generalized_esprit import GeneralizedEsprit
from nfbench.problems.near_field.estimators.mirrored import candidates, halves, mismatch
from nfbench.problems.near_field.estimators.music import Grid
from nfbench.problems.near_field.scenario import NearField


def naive(instance, azimuths, ranges):
    """The determinant at one angle after the other, and the MUSIC spectrum at one range after the other."""
    Q, wavelength = instance.manifold.positions, instance.manifold.wavelength_m
    M, K = len(Q), instance.sources
    U_s = signal_subspace(instance.Y, K)
    upper = [m for m in range(M) if Q[m, 1] > 1e-9]
    lower = [int(np.argmin(np.abs(Q[:, 1] + Q[m, 1]))) for m in upper]
    height = []
    for phi in azimuths:
        Psi = np.diag([np.exp(2j * np.pi / wavelength * 2 * Q[m, 1] * np.sin(phi)) for m in upper])
        W = U_s[upper] - Psi @ U_s[lower]
        height.append(1 / abs(np.linalg.det(W.conj().T @ U_s[upper] - W.conj().T @ Psi @ U_s[lower])))
    n = len(azimuths)
    peaks = [i for i in range(n) if height[i] == max(height[max(i - 1, 0) : i + 2])]
    peaks = sorted(peaks, key=lambda i: -height[i])[: K * (K + 1) // 2]
    found = []
    for i in peaks:
        points = [np.array([azimuths[i], r]) for r in ranges]
        rest = [M - np.linalg.norm(U_s.conj().T @ oracles.response(instance.manifold, p)) ** 2 for p in points]
        found.append((min(rest), points[int(np.argmin(rest))]))
    return in_order(np.array([point for _, point in sorted(found, key=lambda each: each[0])[:K]]))


@pytest.mark.parametrize("seed", range(50))
def test_it_agrees_with_a_naive_implementation(seed):
    wavefront = ["exact", "fresnel", "paper"][seed % 3]
    instance = scene(seed, {"elements": 20 + seed % 2}, wavefront=wavefront, range_m=[0.3, 2.0], sources=1 + seed % 3)
    found = solve(GeneralizedEsprit(grid=Grid(azimuth=121, range=40)), instance)
    expected = naive(instance, np.linspace(*np.radians([-60, 60]), 121), np.linspace(0.3, 2.0, 40))
    assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("elements", [127, 128])
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
def test_sources_on_the_grid_are_found_exactly_without_noise(elements, wavefront):
    instance = noise_free(0, {"elements": elements}, wavefront=wavefront, range_m=[1.5, 5.5], **THREE)
    found = solve(GeneralizedEsprit(grid=Grid(azimuth=241, range=401)), instance)
    assert_allclose(found, instance.theta, rtol=1e-12)


def test_the_determinant_is_zero_at_the_angles_of_the_sources_only():
    instance = noise_free(0, **THREE)
    pair = halves(signal_subspace(instance.Y, 3), instance.manifold.positions[:, 1])
    squares = np.linalg.eigvalsh(mismatch(pair, instance.theta[:, 0], 0.02))
    assert (squares[:, 0] < 1e-12).all() and (squares[:, 1] > 0.1).all()
    others = np.radians([-50.0, -20.0, 0.0, 20.0, 45.0])
    assert (np.linalg.eigvalsh(mismatch(pair, others, 0.02))[:, 0] > 0.1).all()


def test_an_exact_wavefront_biases_the_angles():
    """The bias is that of modified MUSIC, some mrad for the nearest sources."""
    instance = noise_free(wavefront="exact", positions=[[-35, 1.5], [10, 2.0], [30, 1.5]])
    error = np.abs(solve(GeneralizedEsprit(grid=Grid(azimuth=20_001)), instance)[:, 0] - instance.theta[:, 0])
    assert 1e-4 < error.max() < 1e-2


def test_false_peaks_between_sources_of_one_curvature_are_rejected():
    """The sum of the responses of two such sources is symmetric about the mean of their sines, here 0."""
    instance = noise_free(0, sources=2, positions=[[-20, 4.0], [20, 4.0]])
    pair = halves(signal_subspace(instance.Y, 2), instance.manifold.positions[:, 1])
    azimuths = np.linspace(*np.radians([-60, 60]), 241)
    spectrum = -np.linalg.slogdet(mismatch(pair, azimuths, 0.02))[1]
    assert 0.0 in np.round(azimuths[candidates(spectrum, 2)], 12)
    found = solve(GeneralizedEsprit(grid=Grid(azimuth=241, range=2000)), instance)
    assert_allclose(found[:, 0], instance.theta[:, 0], rtol=1e-12)
    assert_allclose(found[:, 1], 4.0, atol=0.01)


def test_angles_do_not_depend_on_ranges():
    """As Zhi & Chia claim: the angles are found without any knowledge of the ranges."""
    near, far = (noise_free(positions=[[-35, r], [10, 1.2 * r], [30, r]]) for r in (1.5, 15.0))
    grid = Grid(azimuth=241, range=50)
    angles = [solve(GeneralizedEsprit(grid=grid), each)[:, 0] for each in (near, far)]
    assert_array_equal(*angles)


def test_its_error_is_close_to_the_bound():
    """With a grid that is fine enough, and sources whose wavefront is the one that the method assumes."""
    method = GeneralizedEsprit(grid=Grid(azimuth=4000))
    scores = [each.score(solve(method, each)) for each in (scene(seed, min_separation_deg=10.0) for seed in range(12))]
    assert np.median([score["rmse_m"] / score["crb_m"] for score in scores]) < 1.6


@pytest.mark.parametrize("elements", [6, 7])
def test_too_few_elements_are_refused(elements):
    with pytest.raises(Incompatible, match=rf"array: expected more than 7 elements for 3 sources, got {elements}"):
        solve(GeneralizedEsprit(), scene(0, {"elements": elements}, range_m=[0.1, 2.0]))


def test_it_warns_only_where_it_takes_long():
    usual, vast = (
        build(NearField, PAPER | {"array": PAPER["array"] | {"elements": M}, "sources": K, "range_m": [1.27, 2000.0]})
        for M, K in ((128, 3), (100_000, 10))
    )
    assert GeneralizedEsprit().warnings(usual) == []
    (text,) = GeneralizedEsprit().warnings(vast)
    assert text.startswith("grid: the default of 400 azimuths and 2000 ranges with 100000 elements")
    assert GeneralizedEsprit(grid=Grid(azimuth=400, range=2000)).warnings(vast) == []
