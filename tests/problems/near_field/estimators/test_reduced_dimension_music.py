"""Reduced-dimension MUSIC: agreement with a naive implementation, exact estimates, what the paper claims."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from line_scenes import in_order, noise_free, scene, solve
from numpy.testing import assert_allclose

from nfbench import Incompatible
from nfbench.problems.near_field.estimators.music import Grid, Music
from nfbench.problems.near_field.estimators.reduced_dimension_music import ReducedDimensionMusic


def naive(instance, azimuths):
    """Ω(φ), Q(φ) and its inverse written out for one angle after the other, and a line by ``polyfit``."""
    Q, wavelength = instance.manifold.positions, instance.manifold.wavelength_m
    M, K = len(Q), instance.sources
    values = np.sort(np.abs(Q[:, 1]))
    y = values[::2] if M % 2 == 0 else np.append(0.0, values[1::2])  # of the pairs, the innermost first
    vectors = np.linalg.eigh(instance.Y @ instance.Y.conj().T)[1]
    U_n, U_s = vectors[:, : M - K], vectors[:, M - K :]

    def profile(phi):
        Omega = np.zeros((M, len(y)), complex)
        for m in range(M):
            pair = int(np.argmin(np.abs(y - abs(Q[m, 1]))))
            Omega[m, pair] = np.exp(2j * np.pi / wavelength * Q[m, 1] * np.sin(phi))
        inverse = np.linalg.inv(Omega.conj().T @ U_n @ U_n.conj().T @ Omega)
        return inverse[0, 0].real, inverse[:, 0] / inverse[0, 0]

    height = [profile(phi)[0] for phi in azimuths]
    peaks = [i for i in range(len(azimuths)) if height[i] == max(height[max(i - 1, 0) : i + 2])]
    found = []
    for i in sorted(peaks, key=lambda i: -height[i])[: K * (K + 1) // 2]:
        slope = np.polyfit(y**2, np.unwrap(np.angle(profile(azimuths[i])[1])), 1)[0]
        bend = 1.0 if instance.manifold.wavefront == "paper" else np.cos(azimuths[i]) ** 2
        r = -np.pi / wavelength * bend / slope if slope < 0 else np.inf  # slope = −(2π/λ)·cos²φ/(2r)
        point = np.array([azimuths[i], np.clip(r, instance.lower[1], instance.upper[1])])
        found.append((np.linalg.norm(U_s.conj().T @ oracles.response(instance.manifold, point)), point))
    return in_order(np.array([point for _, point in sorted(found, key=lambda each: -each[0])[:K]]))


@pytest.mark.parametrize("seed", range(50))
def test_it_agrees_with_a_naive_implementation(seed):
    wavefront = ["exact", "fresnel", "paper"][seed % 3]
    instance = scene(seed, {"elements": 20 + seed % 2}, wavefront=wavefront, range_m=[0.3, 2.0], sources=1 + seed % 3)
    expected = naive(instance, np.linspace(*np.radians([-60, 60]), 121))
    assert_allclose(solve(ReducedDimensionMusic(azimuths=121), instance), expected, rtol=1e-7)


@pytest.mark.parametrize("elements", [127, 128])
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
def test_sources_with_angles_on_the_grid_are_found_exactly_without_noise(elements, wavefront):
    """The range needs no grid."""
    positions = [[-35, 3.1234], [10, 2.0], [30, 4.5678]]
    instance = noise_free(0, {"elements": elements}, wavefront=wavefront, positions=positions)
    assert_allclose(solve(ReducedDimensionMusic(azimuths=241), instance), instance.theta, rtol=1e-6)


def test_an_exact_wavefront_biases_the_estimate():
    """The odd cubic phase moves the angles by some mrad, and the ranges by some percent."""
    instance = noise_free(wavefront="exact", positions=[[-35, 1.5], [10, 2.0], [30, 1.5]])
    error = np.abs(solve(ReducedDimensionMusic(azimuths=20_001), instance) - instance.theta)
    assert 1e-4 < error[:, 0].max() < 1e-2
    assert 1e-3 < (error[:, 1] / instance.theta[:, 1]).max() < 0.1


def test_false_peaks_between_sources_of_one_curvature_are_rejected():
    instance = noise_free(0, sources=2, positions=[[-20, 4.0], [20, 4.0]])
    assert_allclose(solve(ReducedDimensionMusic(azimuths=241), instance), instance.theta, rtol=1e-6)


def test_a_wave_that_bends_the_wrong_way_is_at_the_far_end_of_the_box():
    """The phases of conjugated data rise with y², as no source in front of the array makes them."""
    instance = noise_free(0, sources=1, positions=[[0, 3.0]])
    assert_allclose(solve(ReducedDimensionMusic(azimuths=241), instance), [[0.0, 3.0]], rtol=1e-6, atol=1e-9)
    turned = replace(instance, Y=instance.Y.conj())
    assert solve(ReducedDimensionMusic(azimuths=241), turned)[0, 1] == instance.upper[1]


def test_it_is_close_to_music():
    """Zhang et al. claim an accuracy close to that of 2D MUSIC at a fraction of its cost."""
    scenes = [scene(seed, min_separation_deg=10.0) for seed in range(12)]
    reduced, full = ReducedDimensionMusic(azimuths=4000), Music(refine=True, grid=Grid(azimuth=200, range=200))
    errors = np.array([[each.score(solve(method, each))["rmse_m"] for method in (reduced, full)] for each in scenes])
    assert np.median(errors[:, 0] / errors[:, 1]) < 1.6


@pytest.mark.parametrize("elements", [6, 7])
def test_too_few_elements_are_refused(elements):
    with pytest.raises(Incompatible, match=rf"array: expected more than 7 elements for 3 sources, got {elements}"):
        solve(ReducedDimensionMusic(), scene(0, {"elements": elements}, range_m=[0.1, 2.0]))
