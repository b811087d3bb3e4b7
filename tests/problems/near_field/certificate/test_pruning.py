"""T2 and T3: how far a response turns in a box, and that no point with D <= f* is lost."""

import certificate_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nfbench.problems.near_field.certificate import kernels
from nfbench.problems.near_field.certificate.balls import charted
from nfbench.problems.near_field.certificate.cells import cells_of, unsheared
from nfbench.problems.near_field.certificate.regions import prune_box, prune_leaves
from nfbench.problems.near_field.objectives.kernels import pack_rows

SMALL_PLANE = scenes.PLANE | {"array": scenes.PLANE["array"] | {"columns": 8, "rows": 8}, "range_m": [0.15, 1.0]}
SHORT_PAPER = scenes.PAPER | {"array": scenes.PAPER["array"] | {"elements": 32, "spacing_wavelengths": 0.5}}
SCENES = {
    "line": scenes.SHORT,
    "line, paper, first": SHORT_PAPER,
    "line, fresnel": scenes.SHORT | {"wavefront": "fresnel"},
    "endfire, short": scenes.SHORT | {"azimuth_deg": [-90, 90], "range_m": [0.17, 1.0]},
    "endfire, paper, first": SHORT_PAPER | {"azimuth_deg": [-90, 90]},
    "plane": SMALL_PLANE,
    "custom": scenes.CUSTOM,
}


def cells_and_instance(name, seed=0, **changes):
    instance = scenes.draw(SCENES[name], seed, **changes)
    return cells_of(instance.manifold, instance.lower, instance.upper), instance


def in_boxes(centres, halves, rng):
    """A random point in each box, a third of them corners."""
    shift = rng.uniform(-1, 1, centres.shape)
    corners = rng.random(len(centres)) < 1 / 3
    shift[corners] = np.sign(shift[corners])
    return centres + halves * shift


def near_sources(chart, theta, n, rng):
    """Points of Θ, half of them anywhere, half of them around the sources at all distances."""
    c = scenes.random_coordinates(chart, n, rng)
    sources = chart.from_theta(theta)
    reach = 10 ** rng.uniform(-4, 0, (n // 2, 1)) * chart.width
    around = sources[rng.integers(len(sources), size=n // 2)] + reach * rng.standard_normal((n // 2, chart.dimension))
    c[: n // 2] = np.clip(around, chart.lower, chart.upper)
    return c


def kept(leaves, c):
    """Whether each point lies in a leaf: in the coordinates of the cells, allowing for their rounding."""
    plain = c.copy()
    plain[:, 0] -= leaves.cells.chart.shear * c[:, -1]
    inside = np.zeros(len(c), dtype=bool)
    for first in range(0, len(c), 1000):
        part = plain[first : first + 1000, None]
        inside[first : first + 1000] = (np.abs(part - leaves.centres) <= leaves.halves * (1 + 1e-9)).all(axis=2).any(1)
    return inside


@pytest.mark.parametrize("name", SCENES)
def test_responses_turn_no_further_than_beta(name):
    cells, _ = cells_and_instance(name)
    chart, rng, n = cells.chart, np.random.default_rng(1), 20_000
    cell = rng.integers(len(cells.centres), size=n)
    size = rng.random((n, chart.dimension)) ** 2 * (rng.random((n, 1)) < 0.7) + 1e-3
    halves = cells.halves[cell] * np.minimum(size, 1.0)
    centres = cells.centres[cell] + (cells.halves[cell] - halves) * rng.uniform(-1, 1, halves.shape)
    points = unsheared(chart, in_boxes(centres, halves, rng))
    inside = ((points >= chart.lower) & (points <= chart.upper)).all(axis=1)
    a, b = (scenes.responses(chart, c[inside]) for c in (unsheared(chart, centres), points))
    chord = np.linalg.norm(a - b * np.exp(-1j * np.angle(np.sum(a.conj() * b, axis=1)))[:, None], axis=1)
    angle = 2 * np.arcsin(chord / 2)  # arccos|âᴴb̂|
    F, R, h = cells.F[cell[inside]], cells.R[cell[inside]], halves[inside]
    beta = np.sqrt(np.einsum("nij,ni,nj->n", np.abs(F), h, h)) + np.sum(R * h, axis=1)
    assert (angle <= beta * (1 + 1e-9) + 1e-12).all()
    assert np.max(angle / beta) > (0.85 if chart.dimension == 2 else 0.6)
    assert beta[0] == pytest.approx(kernels._length(F[0], R[0], h[0]))


@pytest.mark.parametrize("name", SCENES)
def test_cells_cover_the_box(name):
    cells, _ = cells_and_instance(name)
    chart = cells.chart
    c = scenes.random_coordinates(chart, 2000, np.random.default_rng(2))
    on_edge = np.random.default_rng(3).integers(3, size=c.shape)
    c = np.where(on_edge == 0, chart.lower, np.where(on_edge == 1, chart.upper, c))
    c[:, 0] -= chart.shear * c[:, -1]
    inside = np.abs(c[:, None] - cells.centres) <= cells.halves * (1 + 1e-9) + 1e-13
    assert inside.all(axis=2).any(axis=1).all()


def attack_pruning(instance, points, seed, snr_share=1.0):
    """Prune at f* = J(x̂), and again, and check random points; returns how many had D <= f*."""
    cells = cells_of(instance.manifold, instance.lower, instance.upper)
    U, rng, chart = scenes.subspace(instance), np.random.default_rng(seed), cells.chart
    f = scenes.misfit(U, instance.manifold, scenes.estimate(instance)) * snr_share
    rows = pack_rows(U)
    leaves = prune_box(cells, rows, f, 1 / 4)
    finer = prune_leaves(leaves, rows, np.full(leaves.regions, f), 1 / 10)
    c = near_sources(chart, instance.theta, points, rng)
    D = kernels.subspace_distances(*instance.manifold.packed, rows, c, chart.is_sine)
    assert_allclose(D[:100], scenes.distances(U, chart, c[:100]), atol=1e-11)
    low = np.flatnonzero(f >= D)
    assert kept(leaves, c[low]).all() and kept(finer, c[low]).all()
    inside = unsheared(chart, in_boxes(finer.centres, finer.halves, rng))
    within = ((inside >= chart.lower) & (inside <= chart.upper)).all(axis=1)
    assert (scenes.distances(U, chart, inside[within]) >= finer.lower_bounds()[within] - 1e-11).all()
    return len(low)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "plane")) for n in SCENES])
def test_no_point_with_a_small_distance_is_pruned(name):
    found = 0
    for seed, snr in enumerate((10.0, 30.0) if name == "plane" else (0.0, 20.0)):
        instance = cells_and_instance(name, seed, snr_db=snr, sources=2)[1]
        found += attack_pruning(instance, 15_000, seed)
    assert found > 1000


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_no_point_with_a_small_distance_is_pruned_in_many_scenes(name):
    found = 0
    levels = (20.0, 25.0, 30.0, 40.0) if name == "plane" else (0.0, 5.0, 10.0, 15.0, 20.0, 40.0)
    for seed, snr in enumerate(levels):  # below, too much of the box of the plane is left
        instance = cells_and_instance(name, seed, snr_db=snr, sources=2 if name == "plane" else 3)[1]
        found += attack_pruning(instance, 170_000, seed)
    assert found > 10_000


@pytest.mark.parametrize("dimension", [2, 3])
def test_components_are_those_of_the_graph_of_touching_boxes(dimension):
    rng = np.random.default_rng(dimension)
    for n in (1, 2, 30, 300):
        halves = 2.0 ** rng.integers(-5, -3, (n, dimension))
        centres = (rng.integers(0, 24, (n, dimension)) + 0.5) * 2.0**-4
        gaps = np.abs(centres[:, None] - centres) - (halves[:, None] + halves)
        pairs = np.nonzero((gaps <= 1e-12).all(axis=2))
        count, labels = connected_components(coo_array((np.ones(len(pairs[0])), pairs), shape=(n, n)))
        found = kernels.components(centres, halves)
        assert len(np.unique(found)) == count == found.max() + 1
        assert (found[pairs[0]] == found[pairs[1]]).all() and len(np.unique(found + 1000 * labels)) == count


@pytest.mark.parametrize("name", ["line", "line, paper, first", "plane"])
def test_leaves_know_their_regions_and_their_distances(name):
    cells, instance = cells_and_instance(name, 4, snr_db=20.0, sources=2)
    chart, U, rng = cells.chart, scenes.subspace(instance), np.random.default_rng(5)
    theta = scenes.estimate(instance)
    f = scenes.misfit(U, instance.manifold, theta)
    leaves = prune_box(cells, pack_rows(U), f, 1 / 6)
    points = unsheared(chart, in_boxes(leaves.centres, leaves.halves * 0.99, rng))
    assert (leaves.region_of(points) == leaves.region).all()
    assert (leaves.region_of(np.array([chart.lower])) == -1).all()
    mine = leaves.region_of(chart.from_theta(theta))
    assert len(set(mine)) == 2 and mine.min() >= 0
    chosen = leaves.only(mine[::-1])
    assert (chosen.region_of(chart.from_theta(theta)) == [1, 0]).all()
    sources = charted(chart, chart.from_theta(theta[::-1]))
    longest = chosen.distances(sources)
    for _ in range(20):
        points = unsheared(chart, in_boxes(chosen.centres, chosen.halves, rng))
        t = np.einsum("bij,bj->bi", sources.inverse[chosen.region], points - sources.C[chosen.region])
        for k in range(2):
            share = np.linalg.norm(t, axis=1)[chosen.region == k] / longest[k]
            assert 0.9 < share.max() <= 1 + 1e-9
