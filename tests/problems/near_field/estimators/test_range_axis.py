"""The spectrum of MUSIC along the range, interpolated from its values at few ranges."""

import time
from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.core.options import build
from nfbench.problems.near_field.estimators.music import Music, grid_maxima
from nfbench.problems.near_field.estimators.range_axis import range_axis
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import signal_subspace

PLANE = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "exact",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
SPACE = PLANE | {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-30, 30],
    "range_m": [0.452, 2.56],
}


def grid(scenario, *counts):
    return [np.linspace(*side, count) for *side, count in zip(*scenario.box(), counts, strict=True)]


def energies(manifold, U_s, directions, ranges):
    """‖U_sᴴa‖² by the formula of the response, one direction a row."""
    values = np.empty((len(directions), len(ranges)))
    for i, direction in enumerate(directions):
        A = np.array([oracles.response(manifold, np.array([*direction, r])) for r in ranges])
        values[i] = np.sum(np.abs(A.conj() @ U_s) ** 2, axis=1)
    return values


@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
@pytest.mark.parametrize(
    ("settings", "counts", "most"), [(PLANE, (400, 2000), 64), (SPACE, (200, 200, 400), 20)], ids=["2d", "3d"]
)
def test_interpolated_values_are_those_of_the_formula_to_rounding(settings, counts, most, wavefront):
    """With the grids of the paper; two of the sources are in corners of the box, at its nearest range."""
    scenario = build(NearField, settings | {"wavefront": wavefront})
    axes, manifold, M = grid(scenario, *counts), scenario.manifold(), scenario.array.count
    axis = range_axis([manifold], axes)
    assert 4 <= len(axis.ranges) <= most
    rng = np.random.default_rng(1)
    corners = np.array([[side[0] for side in axes], [*(side[-1] for side in axes[:-1]), axes[-1][0]]])
    within = [side[rng.integers(len(side))] for side in axes]
    A = np.array([oracles.response(manifold, theta) for theta in [*corners, within]]).T
    U_s = np.linalg.qr(A)[0]
    directions = [*corners[:, :-1], within[:-1], *rng.uniform(*np.array(scenario.box())[:, :-1], (5, len(axes) - 1))]
    every = slice(None, None, 7)
    values = axis.values(energies(manifold, U_s, directions, axis.ranges))[:, every]
    assert_allclose(values, energies(manifold, U_s, directions, axes[-1][every]), rtol=0, atol=1e-12 * M)


@pytest.mark.parametrize(("settings", "counts"), [(PLANE, (400, 2000)), (SPACE, (40, 30, 400))], ids=["2d", "3d"])
def test_the_maxima_are_those_of_the_whole_grid(settings, counts):
    scenario = build(NearField, settings)
    axes = grid(scenario, *counts)
    for seed in range(3):
        instance = scenario.draw(np.random.default_rng(seed))
        bins = [(signal_subspace(instance.Y, 3), instance.manifold)]
        expected = grid_maxima(bins, axes, 300, interpolate=False)
        assert len(expected) > 10
        assert_array_equal(grid_maxima(bins, axes, 300), expected)


def test_interpolation_pays():
    """By a factor of nine or so for the paper's 3D MUSIC, of which four are demanded on a grid of a fourth."""
    instance = build(NearField, SPACE).draw(np.random.default_rng(0))
    bins, axes = [(signal_subspace(instance.Y, 3), instance.manifold)], grid(build(NearField, SPACE), 50, 200, 400)
    seconds = []
    for interpolate in (True, False):
        start = time.process_time()
        grid_maxima(bins, axes, 300, interpolate)
        seconds.append(time.process_time() - start)
    assert seconds[0] < seconds[1] / 4


def test_a_planar_wave_needs_one_range():
    """So that all ranges have one value to the last bit, and a plateau stays one maximum."""
    scenario = build(NearField, PLANE | {"wavefront": "planar"})
    axis = range_axis([scenario.manifold()], grid(scenario, 400, 2000))
    assert len(axis.ranges) == 1
    values = axis.values(np.array([[0.3], [0.7]]))
    assert_array_equal(values, [[0.3] * 2000, [0.7] * 2000])


def test_where_interpolation_does_not_pay_the_grid_is_evaluated():
    small = build(NearField, PLANE)
    inside = build(NearField, PLANE | {"array": PLANE["array"] | {"elements": 1024}})  # ranges begin within the array
    weighted = replace(small.manifold(), amplitude="spherical")
    for manifold, counts in ((small.manifold(), (20, 50)), (inside.manifold(), (400, 500)), (weighted, (400, 2000))):
        axes = grid(small, *counts)
        axis = range_axis([manifold], axes)
        assert axis.weights is None
        assert_array_equal(axis.ranges, axes[-1])


def test_the_coarsest_bin_and_the_finest_are_both_interpolated():
    scenario = build(NearField, PLANE)
    axes, low = grid(scenario, 400, 2000), replace(scenario.manifold(), wavelength_m=0.04)
    few, many = (len(range_axis([manifold], axes).ranges) for manifold in (low, scenario.manifold()))
    assert few < many == len(range_axis([low, scenario.manifold()], axes).ranges)


def test_a_search_can_evaluate_every_point():
    instance = build(NearField, PLANE).draw(np.random.default_rng(5))
    fast, plain = (Music(interpolate=interpolate).solve(instance, None) for interpolate in (True, False))
    assert_array_equal(fast, plain)
