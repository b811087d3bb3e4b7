"""Subarray MUSIC: agreement with a naive implementation, exact and biased estimates, spacings up to λ/2."""

from itertools import permutations

import numpy as np
import pytest
from line_scenes import THREE, in_order, noise_free, scene, signal_subspace, solve
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares, minimize_scalar

from nfbench import Incompatible
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid, Music
from nfbench.problems.near_field.estimators.subarray_music import SubarrayMusic

HALF = {"spacing_wavelengths": 0.5}
FAR = {"range_m": [2.54, 80.0]}


# agreement with a naive implementation


def naive(instance, n, step):
    """Angles from a fine grid and Brent's method, pairs by all permutations, positions by nonlinear least squares."""
    wavelength, y = instance.manifold.wavelength_m, instance.manifold.positions[:, 1]
    K, U_s = instance.sources, signal_subspace(instance.Y, instance.sources)
    lines, first = [], None
    for m in range(0, len(y) - n + 1, step):
        c, own = y[m : m + n].mean(), y[m : m + n] - y[m : m + n].mean()
        P = U_s[m : m + n] @ np.linalg.pinv(U_s[m : m + n])

        def steer(s, own=own):
            return np.exp(2j * np.pi / wavelength * own * s)

        def noise(s, P=P, steer=steer):
            return np.linalg.norm(steer(s) - P @ steer(s)) ** 2

        grid = np.linspace(-1, 1, 1001)
        values = np.array([noise(s) for s in grid])
        lowest = [i for i in range(1, 1000) if values[i] < min(values[i - 1], values[i + 1])]
        lowest = sorted(lowest, key=lambda i, values=values: values[i])[:K]
        s = [minimize_scalar(noise, (grid[i - 1], grid[i], grid[i + 1]), tol=1e-12).x for i in lowest]
        t = [np.linalg.pinv(U_s[m : m + n]) @ steer(each) for each in s]
        t = [each / np.linalg.norm(each) for each in t]
        first = t if first is None else first
        order = max(permutations(range(K)), key=lambda p, t=t: sum(abs(np.vdot(first[k], t[p[k]])) for k in range(K)))
        lines.append([(c, s[k]) for k in order])
    found = []
    for k in range(K):
        c, s = np.array([line[k] for line in lines]).T
        cosine = np.sqrt(1 - s**2)

        def miss(p, c=c, s=s, cosine=cosine):  # of a line, in units of its standard deviation, x/cos²φ
            return (cosine * (p[1] - c) - s * p[0]) * cosine**2 / p[0]

        x, along = least_squares(miss, [2.0, 0.0], x_scale=[1.0, 0.1], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        found.append([np.arctan2(along, x), np.hypot(x, along)])
    return in_order(np.array(found))


@pytest.mark.parametrize("seed", [*range(20), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(20, 50))])
def test_it_agrees_with_a_naive_implementation(seed):
    array = HALF | {"elements": 40}
    instance = scene(seed, array, wavefront="exact", range_m=[0.8, 4.0], min_separation_deg=20.0)
    found = solve(SubarrayMusic(elements=16, overlap=0.75), instance)
    assert_allclose(found, naive(instance, 16, 4), rtol=2e-6, atol=2e-7)


# exact and biased estimates


@pytest.mark.parametrize("spacing", [0.25, 0.5])
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
def test_one_source_without_noise_is_found_exactly(wavefront, spacing):
    """The quadratic phase of a subarray is even and does not move its peak."""
    array = {"spacing_wavelengths": spacing}
    instance = noise_free(0, array, wavefront=wavefront, sources=1, positions=[[-40, 3.0]], **FAR)
    assert_allclose(solve(SubarrayMusic(), instance), instance.theta, rtol=1e-6)


def test_the_origin_does_not_matter():
    array = {"origin": "first"}
    instance = noise_free(0, array, sources=1, positions=[[-40, 3.0]])
    assert_allclose(solve(SubarrayMusic(), instance), instance.theta, rtol=1e-6)


def test_an_exact_wavefront_has_a_small_bias():
    """Within a subarray the phase has a cubic part. It moves the range by less than a thousandth."""
    instance = noise_free(wavefront="exact", sources=1, positions=[[-40, 3.0]])
    error = solve(SubarrayMusic(), instance)[0] - instance.theta[0]
    assert 1e-8 < abs(error[0]) < 1e-3
    assert 1e-6 < abs(error[1]) / 3.0 < 1e-3


@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
def test_several_sources_are_biased_and_refined_ones_are_exact(wavefront):
    instance = noise_free(wavefront=wavefront, **THREE)
    error = np.abs(solve(SubarrayMusic(), instance) - instance.theta)
    assert error[:, 0].max() < 1e-3 and 1e-5 < (error[:, 1] / instance.theta[:, 1]).max() < 5e-3
    assert_allclose(solve(SubarrayMusic(refine=True), instance), instance.theta, rtol=1e-6)


def test_refined_estimates_have_standard_errors():
    solution = SubarrayMusic(refine=True).solve(scene(**THREE), None)
    assert set(solution.columns) == {"std_1_m", "std_2_m", "std_3_m", "std_m"}
    assert 0 < solution.columns["std_m"] < 0.05


def test_a_source_beyond_the_reach_of_the_baseline_is_at_the_far_end_of_the_box():
    """The lines of a plane wave are parallel; noise makes about half of them diverge."""
    changes = {"wavefront": "exact", "sources": 1, "positions": [[20, 15000.0]], "range_m": [1.27, 20000.0]}
    scenes = [scene(seed, snr_db=0.0, **changes) for seed in range(20)]
    assert 4 <= sum(solve(SubarrayMusic(), each)[0, 1] == each.upper[1] for each in scenes) <= 16


def test_directions_that_cross_between_subarrays_are_paired():
    """From one end of the array the first source is on the left of the second one, from the other on its right."""
    positions = [[2, 2.0], [0, 12.0]]
    instance = noise_free(0, HALF, wavefront="exact", sources=2, positions=positions, range_m=[1.0, 20.0])
    seen = [np.arctan2(r * np.sin(az) - c, r * np.cos(az)) for az, r in instance.theta for c in (-0.4, 0.4)]
    assert (seen[0] - seen[2]) * (seen[1] - seen[3]) < 0  # they cross
    assert_allclose(solve(SubarrayMusic(refine=True), instance), in_order(instance.theta), rtol=1e-6, atol=1e-12)


def test_a_box_behind_the_array():
    instance = noise_free(0, sources=1, azimuth_deg=[120, 240], positions=[[200, 3.0]])
    assert_allclose(solve(SubarrayMusic(), instance), instance.theta, rtol=1e-6)


# what the paper claims


def test_it_is_better_than_modified_music_and_close_to_music():
    """Haghshenas et al. find a mean error below that of modified MUSIC, and comparable to that of MUSIC."""
    scenes = [scene(seed, wavefront="exact", min_separation_deg=15.0) for seed in range(20)]
    methods = [SubarrayMusic(), ModifiedMusic(refine=True), Music(refine=True, grid=Grid(azimuth=200, range=200))]
    own, modified, full = (np.median([s.score(solve(m, s))["rmse_m"] for s in scenes]) for m in methods)
    assert own < 0.8 * modified
    assert own < 1.5 * full


@pytest.mark.parametrize("wavefront", ["exact", "paper"])
def test_it_works_at_half_a_wavelength(wavefront):
    """There modified MUSIC refuses the array."""
    ratios = []
    for seed in range(10):
        instance = scene(seed, HALF, wavefront=wavefront, min_separation_deg=10.0, range_m=[2.54, 40.0])
        score = instance.score(solve(SubarrayMusic(), instance))
        ratios.append(score["rmse_m"] / score["crb_m"])
        with pytest.raises(Incompatible):
            solve(ModifiedMusic(), instance)
    assert np.median(ratios) < 2


def test_the_same_data_give_the_same_estimate():
    instance = scene(3)
    assert_array_equal(solve(SubarrayMusic(), instance), solve(SubarrayMusic(), instance))


# refusals of its own


@pytest.mark.parametrize(
    ("options", "array", "changes", "reason"),
    [
        ({}, {"spacing_wavelengths": 0.7}, {}, r"spacing of at most 0\.\d+ λ for subarray MUSIC, .* got 0.7 λ"),
        ({}, {}, {"azimuth_deg": [60, 120]}, r"one side of the array for subarray MUSIC, .* got \[60, 120\]"),
        ({"elements": 3}, {}, {}, r"subarrays of more than 3 elements for 3 sources, .* got 3"),
        ({"elements": 128}, {}, {}, r"fewer than the 128 elements of the array, got 128"),
        ({}, {"elements": 6}, {"range_m": [0.1, 20.0]}, r"more than 3 elements for 3 sources, .* 6 elements .* got 3"),
    ],
)
def test_unsuitable_scenes_are_declined(options, array, changes, reason):
    with pytest.raises(Incompatible, match=reason):
        solve(SubarrayMusic(**options), scene(0, array, **changes))


def test_a_narrower_sector_allows_a_wider_spacing():
    array = {"spacing_wavelengths": 0.7}
    instance = noise_free(0, array, azimuth_deg=[-25, 20], sources=1, positions=[[-20, 5.0]], range_m=[3.5, 30.0])
    assert_allclose(solve(SubarrayMusic(), instance), instance.theta, rtol=1e-6)
