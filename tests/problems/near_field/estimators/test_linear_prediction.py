"""Linear prediction: agreement with a naive implementation, exact estimates, no saturation, what it refuses."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from line_scenes import THREE, in_order, noise_free, scene, solve
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible
from nfbench.problems.near_field.estimators.linear_prediction import LinearPrediction
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic


def naive_polynomial(z, K):
    """Coefficients, the highest power first, from the singular values of the matrix of the past."""
    L = len(z) // 2
    past = np.array([[z[i + j] for j in range(L)] for i in range(len(z) - L)])
    U, s, Vh = np.linalg.svd(past)
    b = Vh[:K].conj().T @ ((U[:, :K].conj().T @ z[L:]) / s[:K])
    coefficients = np.concatenate([[1.0], -b[::-1]])
    return coefficients / np.sqrt(np.sum(np.abs(coefficients) ** 2))


def naive(instance, sweeps):
    y, wavelength = instance.manifold.positions[:, 1], instance.manifold.wavelength_m
    M, K, delta = len(y), instance.sources, y[1] - y[0]
    R = instance.Y @ instance.Y.conj().T / instance.Y.shape[1]
    R = R - np.mean(np.linalg.eigvalsh(R)[: M - K]) * np.eye(M)
    step, largest = 4 * np.pi / wavelength * delta, min(M // 2, M - 2 * K - 2)
    low, high = instance.lower, instance.upper

    def sequence(S, p):
        return np.array([S[m, n] for m in range(M) for n in range(M) if m + n == M - 1 + p])

    def bend(azimuth):
        return 1.0 if instance.manifold.wavefront == "paper" else np.cos(azimuth) ** 2

    zeros = np.roots(naive_polynomial(sequence(R, 0), K))
    margin = wavelength / (M * delta)
    zeros = [x for x in zeros if np.sin(low[0]) - margin <= np.angle(x) / step <= np.sin(high[0]) + margin]
    zeros = sorted(zeros, key=lambda x: abs(abs(x) - 1))[:K]
    inverse = np.linspace(1 / high[1], 1 / low[1], 400)
    polynomials = {
        p: naive_polynomial(sequence(R, p), K) for p in {largest, -largest, largest // 2, -(largest // 2)} if p
    }
    theta = []
    for x in zeros:
        sine = np.angle(x) / step
        azimuth = np.clip(np.arcsin(np.clip(sine, -1, 1)), low[0], high[0])
        misfit = [
            sum(
                abs(np.polyval(c, np.exp(1j * step * (sine - bend(azimuth) * each * p * delta / 2)))) ** 2
                for p, c in polynomials.items()
            )
            for each in inverse
        ]
        theta.append([azimuth, 1 / inverse[int(np.argmin(misfit))]])
    theta = np.array(theta)
    for _ in range(sweeps):
        for k in range(K):
            A = np.array([oracles.response(instance.manifold, each) for each in theta]).T
            a, rest = A[:, [k]], np.delete(A, k, axis=1)
            P = np.eye(M) - a @ a.conj().T / M
            E = rest @ np.linalg.inv(rest.conj().T @ P @ rest) @ rest.conj().T @ P
            S = (np.eye(M) - E) @ R @ (np.eye(M) - E).conj().T
            offsets = sorted({round(each) for each in np.linspace(-largest, largest, 9)})
            auxiliary = []
            for p in offsets:
                z = sequence(S, p)
                kay = sum((i + 1) * (len(z) - 1 - i) * z[i + 1] * z[i].conj() for i in range(len(z) - 1))
                near = np.sin(theta[k, 0]) - bend(theta[k, 0]) / theta[k, 1] * p * delta / 2
                auxiliary.append(near + np.angle(kay * np.exp(-1j * step * near)) / step)
            weights = np.array([M - abs(p) for p in offsets]) ** 1.5  # polyfit squares them
            slope, sine = np.polyfit(np.array(offsets) * delta / 2, auxiliary, 1, w=weights)
            azimuth = np.arcsin(np.clip(sine, -1, 1))
            r = -bend(azimuth) / slope if slope < 0 else np.inf
            theta[k] = np.clip([azimuth, r], low, high)
    return in_order(theta)


@pytest.mark.parametrize("seed", [*range(20), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(20, 50))])
def test_it_agrees_with_a_naive_implementation(seed):
    wavefront = ["exact", "fresnel", "paper"][seed % 3]
    changes = {"wavefront": wavefront, "range_m": [0.3, 2.0], "sources": 1 + seed % 3, "min_separation_deg": 25.0}
    instance = scene(seed, {"elements": 24 + seed % 2}, **changes)
    for sweeps in (0, 3):
        assert_allclose(solve(LinearPrediction(sweeps=sweeps), instance), naive(instance, sweeps), rtol=1e-6)


@pytest.mark.parametrize("elements", [127, 128])
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
def test_sources_are_found_exactly_without_noise(elements, wavefront):
    """Without any grid: zeros of the polynomial, and a regression."""
    instance = noise_free(0, {"elements": elements}, wavefront=wavefront, **THREE)
    assert_allclose(solve(LinearPrediction(), instance), instance.theta, rtol=1e-6)


def test_the_angles_are_exact_even_before_sources_are_isolated():
    instance = noise_free(0, **THREE)
    found = solve(LinearPrediction(sweeps=0), instance)
    assert_allclose(found[:, 0], instance.theta[:, 0], rtol=1e-9)
    assert_allclose(found[:, 1], instance.theta[:, 1], rtol=0.02)  # half a step of the first search


def test_an_exact_wavefront_biases_the_estimate():
    """The odd cubic phase moves the angles by some mrad, and the ranges by some percent."""
    instance = noise_free(wavefront="exact", positions=[[-35, 1.5], [10, 2.0], [30, 1.5]])
    error = np.abs(solve(LinearPrediction(), instance) - instance.theta)
    assert 1e-4 < error[:, 0].max() < 1e-2
    assert 1e-3 < (error[:, 1] / instance.theta[:, 1]).max() < 0.1


def test_oblique_projections_remove_the_saturation():
    """As Zuo et al. claim: with few snapshots the angles keep an error at any SNR, unless each source is isolated.

    The sample correlations of the sources do not fall with the SNR. Isolated sources reach the bound.
    """

    def error(method, snr_db):
        scenes = [scene(seed, snr_db=snr_db, snapshots=50, min_separation_deg=10.0) for seed in range(10)]
        return np.median([np.abs(solve(method, each)[:, 0] - in_order(each.theta)[:, 0]).max() for each in scenes])

    for method in (LinearPrediction(sweeps=0), ModifiedMusic(refine=True)):
        assert error(method, 60.0) > 0.5 * error(method, 30.0)
    assert error(LinearPrediction(), 60.0) < 0.05 * error(LinearPrediction(), 30.0)
    scenes = [scene(seed, snr_db=50.0, snapshots=50, min_separation_deg=10.0) for seed in range(10)]
    scores = [each.score(solve(LinearPrediction(), each)) for each in scenes]
    assert np.median([score["rmse_m"] / score["crb_m"] for score in scores]) < 1.6


def test_the_range_at_the_far_end_of_the_box_is_kept_if_the_wave_bends_the_wrong_way():
    instance = noise_free(0, sources=1, positions=[[0, 3.0]])
    turned = replace(instance, Y=instance.Y.conj())
    assert solve(LinearPrediction(), turned)[0, 1] == instance.upper[1]


def test_a_box_behind_the_array():
    instance = noise_free(0, sources=1, azimuth_deg=[120, 240], positions=[[200, 3.0]])
    assert_allclose(solve(LinearPrediction(), instance), instance.theta, rtol=1e-6)


def test_sweeps_end_when_nothing_changes():
    instance = scene(0, min_separation_deg=10.0)
    assert_array_equal(solve(LinearPrediction(sweeps=50), instance), solve(LinearPrediction(sweeps=100), instance))


@pytest.mark.parametrize("elements", [7, 8])
def test_too_few_elements_are_refused(elements):
    with pytest.raises(Incompatible, match=rf"array: expected more than 8 elements for 3 sources, got {elements}"):
        solve(LinearPrediction(), scene(0, {"elements": elements}, range_m=[0.1, 2.0]))
