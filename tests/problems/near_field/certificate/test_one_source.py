"""The proven minimum of RLS over one source, against a dense grid and local searches from its best points."""

import certificate_scenes as scenes
import numpy as np
import pytest
from scipy.optimize import minimize

from nfbench.problems.near_field.certificate import certify_one_source
from nfbench.problems.near_field.certificate.balls import charted
from nfbench.problems.near_field.certificate.cells import cells_of
from nfbench.problems.near_field.certificate.chart import chart_of
from nfbench.problems.near_field.certificate.one_source import _ball, _families
from nfbench.problems.near_field.subspace import compress

SHORT_PAPER = scenes.PAPER | {"array": scenes.PAPER["array"] | {"elements": 32, "spacing_wavelengths": 0.5}}
SMALL_PLANE = scenes.PLANE | {"array": scenes.PLANE["array"] | {"columns": 10, "rows": 8}, "range_m": [0.15, 1.5]}
SHORT_FRESNEL = scenes.SHORT | {"wavefront": "fresnel"}
POINTS = {2: (400, 60), 3: (60, 40, 14)}
GAP = 1e-6


def search(L, chart, starts=6):
    """Return coordinates of local maxima of p = ‖Lᴴâ‖² and their values, best first, from a dense grid."""
    ends = zip(chart.lower, chart.upper, POINTS[chart.dimension], strict=True)
    axes = [np.linspace(low, high, n) for low, high, n in ends]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, chart.dimension)

    def p(c):
        return np.sum(np.abs(scenes.responses(chart, c) @ L.conj()) ** 2, axis=1)

    values = p(grid)
    scale, top = 0.01 * chart.width, values.max()
    bounds = np.stack([chart.lower / scale, chart.upper / scale], axis=1)
    found, chosen = [], np.ones(len(grid), dtype=bool)
    for _ in range(starts):
        c = grid[np.argmax(np.where(chosen, values, -1))]
        chosen &= (np.abs(grid - c) > 0.05 * chart.width).any(axis=1)
        for _ in range(3):
            options = {"ftol": 1e-16, "gtol": 1e-10}
            end = minimize(lambda x: -p((x * scale)[None])[0] / top, c / scale, bounds=bounds, options=options)
            c = np.clip(end.x * scale, chart.lower, chart.upper)
        found.append((p(c[None])[0], c))
    found.sort(key=lambda pair: -pair[0])
    return found


def scene(manifest, seed, lower=None, upper=None, **changes):
    """Return the data's factor, the array and a box, which may leave out the sources."""
    instance = scenes.draw(manifest, seed, **changes)
    box = instance.lower.copy() if lower is None else np.array(lower)
    top = instance.upper.copy() if upper is None else np.array(upper)
    return compress(instance.Y), instance.manifold, box, top


def check(L, manifold, lower, upper, gap=GAP):
    chart = chart_of(manifold, lower, upper)
    found = search(L, chart)
    best, c = found[0]
    theta = chart.to_theta(c[None])[0]
    proof = certify_one_source(L, manifold, lower, upper, theta, gap)
    assert proof.certified and 0 <= proof.gap <= best * gap * 1.01
    a = manifold.response(theta[None])[0] / np.sqrt(manifold.elements)
    J = np.linalg.norm(L - np.outer(a, a.conj() @ L)) ** 2
    assert pytest.approx(J, rel=1e-9, abs=1e-9 * best) == proof.J
    for p, worse in found[1:]:
        if p < best * (1 - 1e-4):  # another local maximum
            again = certify_one_source(L, manifold, lower, upper, chart.to_theta(worse[None])[0], gap)
            assert not again.certified
            better = manifold.response(again.theta[None])[0] / np.sqrt(manifold.elements)
            assert np.linalg.norm(better.conj() @ L) ** 2 > p * (1 - 1e-9)
    return proof, chart, c


@pytest.mark.parametrize(
    "manifest", [scenes.SHORT, SHORT_PAPER, scenes.SHORT | {"wavefront": "fresnel"}, scenes.CUSTOM]
)
@pytest.mark.parametrize(("K", "snr"), [(1, 0.0), (1, 20.0), (3, 10.0)])
def test_the_minimum_is_that_of_a_dense_grid(manifest, K, snr):
    for seed in range(2):
        proof, _, _ = check(*scene(manifest, seed, sources=K, snr_db=snr))
        assert proof.evaluations < 5000


def test_the_minimum_in_space():
    check(*scene(SMALL_PLANE, 1, sources=1, snr_db=10.0))
    check(*scene(SMALL_PLANE, 2, sources=2, snr_db=20.0), gap=1e-3)


@pytest.mark.parametrize("manifest", [scenes.SHORT, SHORT_PAPER])
def test_maxima_on_edges_and_in_corners(manifest):
    """The box leaves out the source, so that the best point is on an edge, or in a corner, towards it."""
    rad, edges, corners = np.radians, 0, 0
    for seed, (azimuth, r, low, high) in enumerate(
        (
            (20.0, 0.8, [rad(-60), 1.5], [rad(60), 4.0]),  # too near: on the edge of the shortest range
            (20.0, 2.0, [rad(-60), 0.7], [rad(18.5), 4.0]),  # on the edge of the largest angle
            (-30.0, 3.0, [rad(-29), 0.7], [rad(60), 2.0]),
            (20.0, 0.8, [rad(20.8), 1.2], [rad(60), 4.0]),
            (20.0, 3.9, [rad(20.8), 0.7], [rad(60), 1.2]),
        )
    ):
        ranges = [0.7, 4.0]
        data = scene(manifest, seed, low, high, sources=1, snr_db=20.0, range_m=ranges, positions=((azimuth, r),))
        _, chart, c = check(*data)
        on_edge = int(np.sum((c == chart.lower) | (c == chart.upper)))
        edges, corners = edges + (on_edge == 1), corners + (on_edge == 2)
    assert edges >= 1 and (corners >= 1 or manifest is SHORT_PAPER)


def test_points_beyond_an_edge_do_not_count_where_coordinates_are_sheared():
    """Under ``paper`` boxes may stick out of Θ, towards a source that the box leaves out."""
    for seed in range(6):
        azimuth = np.random.default_rng(seed).uniform(-50, 50)
        low, high = ([-60, azimuth - 0.5], [azimuth + 0.5, 60])[seed % 2]
        positions = ((azimuth, 1.5 + 0.4 * seed),)
        data = scene(
            SHORT_PAPER,
            seed,
            [np.radians(low), 1.27],
            [np.radians(high), 4.0],
            sources=1,
            snr_db=10.0,
            positions=positions,
        )
        check(*data)


def test_a_face_and_an_edge_in_space():
    lower, upper = [np.radians(-30), np.radians(-20), 0.3], [np.radians(30), np.radians(20), 1.0]
    data = scene(SMALL_PLANE, 3, lower, upper, sources=1, snr_db=20.0, positions=((10.0, 5.0, 0.2),))
    _, chart, c = check(*data)
    assert c[-1] == chart.upper[-1] and (c[:-1] > chart.lower[:-1]).all()


def test_a_worse_point_than_another_is_refused_even_with_a_large_gap():
    L, manifold, lower, upper = scene(scenes.SHORT, 5, sources=2, snr_db=20.0)
    chart = chart_of(manifold, lower, upper)
    best, c = search(L, chart)[0]
    off = np.clip(c + 0.02 * chart.width, chart.lower, chart.upper)
    proof = certify_one_source(L, manifold, lower, upper, chart.to_theta(off[None])[0], 1e-3)
    assert not proof.certified
    end = manifold.response(proof.theta[None])[0] / np.sqrt(manifold.elements)
    assert np.linalg.norm(end.conj() @ L) ** 2 > 0.9 * best


def test_families_hold_the_interior_and_every_edge():
    _, manifold, lower, upper = scene(SMALL_PLANE, 0)
    families = _families(cells_of(manifold, lower, upper))
    assert len(families) == 1 + 6 + 12
    free = sorted(int((halves[0] > 0).sum()) for _, _, halves, _ in families)
    assert free == [1] * 12 + [2] * 6 + [3]
    for _, centres, halves, _ in families[1:]:
        volume = np.prod(np.where(halves > 0, 2 * halves, 1.0), axis=1).sum()
        fixed = halves[0] == 0
        whole = np.prod(np.where(fixed, 1.0, manifold_width(manifold, lower, upper)))
        assert volume == pytest.approx(whole) and (centres[:, fixed] == centres[0, fixed]).all()


def manifold_width(manifold, lower, upper):
    return chart_of(manifold, lower, upper).width


def test_no_value_in_the_ball_exceeds_its_bound():
    for manifest in (scenes.SHORT, SHORT_PAPER, SMALL_PLANE):
        for seed in range(3):
            L, manifold, lower, upper = scene(manifest, seed, sources=2, snr_db=10.0)
            chart = chart_of(manifold, lower, upper)
            c = search(L, chart, 1)[0][1]
            shifted = chart.snapped(
                (c + 1e-4 * chart.width * np.random.default_rng(seed).standard_normal(len(c)))[None]
            )
            source = charted(chart, np.clip(shifted, chart.lower, chart.upper))
            (centre, inverse, radius), beyond = _ball(source, L, float(np.linalg.norm(L, 2)))
            assert radius > 0.01
            t = radius * scenes.in_unit_ball(4000, len(c), np.random.default_rng(seed))
            points = centre + t @ np.linalg.inv(inverse).T
            points = points[((points >= chart.lower) & (points <= chart.upper)).all(axis=1)]
            p = np.sum(np.abs(scenes.responses(chart, points) @ L.conj()) ** 2, axis=1)
            top = np.sum(np.abs(source.a[0] @ L.conj()) ** 2)
            assert len(points) > 100 and p.max() <= (top + beyond) * (1 + 1e-12)
            assert beyond > 0
