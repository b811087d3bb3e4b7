"""Bounds of the derivatives of responses on balls, and of the inner products of responses, against random points."""

import certificate_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.certificate.balls import _directions, ball_bounds, charted, cover, over_cover
from nfbench.problems.near_field.certificate.couplings import couplings, gram_limits

SMALL_PLANE = scenes.PLANE | {"array": scenes.PLANE["array"] | {"columns": 6, "rows": 5}, "range_m": [0.06, 1.0]}
SHORT_PAPER = scenes.PAPER | {"array": scenes.PAPER["array"] | {"elements": 24, "spacing_wavelengths": 0.5}}
SCENES = {
    "line": scenes.SHORT,
    "line, paper, first": SHORT_PAPER,
    "line, fresnel": scenes.SHORT | {"wavefront": "fresnel"},
    "endfire, short": scenes.SHORT | {"azimuth_deg": [-90, 90], "range_m": [0.17, 1.0]},
    "both sides": scenes.SHORT | {"azimuth_deg": [-150, 150]},
    "plane": SMALL_PLANE,
    "custom": scenes.CUSTOM,
    "custom, 3-D": scenes.CUSTOM | {"elevation_deg": [-60, 60]},
}
RADII = (0.02, 0.1, 0.3, 0.8)


def sources_of(name, count, seed):
    """Sources in Θ, some of them on its edges, and a subspace."""
    instance, rng = scenes.draw(SCENES[name], seed), np.random.default_rng(seed)
    chart = scenes.chart(instance)
    C = scenes.random_coordinates(chart, count, rng)
    on_edge = rng.integers(6, size=C.shape)
    C = np.where(on_edge == 0, chart.lower, np.where(on_edge == 1, chart.upper, C))
    return charted(chart, C), scenes.subspace(instance), rng


def points_in(sources, rho, n, rng):
    """Points (b, n, d) of the balls that lie in Θ; where a draw does not, its centre."""
    chart, d = sources.chart, sources.C.shape[1]
    t = np.stack([scenes.in_unit_ball(n, d, rng) * r for r in rho])
    C = sources.C[:, None] + t @ sources.S.swapaxes(1, 2)
    for _ in range(12):  # shorten the segments that leave Θ
        outside = ((chart.lower > C) | (chart.upper < C)).any(axis=2)
        C[outside] = (C + sources.C[:, None])[outside] / 2
    outside = ((chart.lower > C) | (chart.upper < C)).any(axis=2)
    return np.where(outside[..., None], sources.C[:, None], C)


def along(sources, C, rng):
    """Random unit directions, and â, ψ', ψ'' and ψ''' along them at points C (b, n, d)."""
    b, n, d = C.shape
    flat, S = C.reshape(-1, d), np.repeat(sources.S, n, axis=0)
    delta = scenes.in_unit_ball(3 * b * n, d, rng)[: b * n]  # on the sphere
    h = 1e-4
    steps = (S @ delta[:, :, None])[:, :, 0]
    jets = [sources.chart.jets(flat + i * h * steps, S) for i in (0, -1, 1)]
    a, psi1 = jets[0][0], np.einsum("bim,bi->bm", jets[0][1], delta)
    psi2 = [np.einsum("bijm,bi,bj->bm", jet[2], delta, delta) for jet in jets]
    psi3 = (psi2[2] - psi2[1]) / (2 * h)
    return delta, a, psi1, psi2[0], psi3


def derivatives(a, psi1, psi2, psi3):
    return (
        1j * psi1 * a,
        (1j * psi2 - psi1**2) * a,
        (1j * psi3 - 3 * psi1 * psi2 - 1j * psi1**3) * a,
    )


def check(bounds, sources, C, U, rng):
    """Assert the bounds at random points; returns the largest shares of n1, n2, n3 and u1 that were found."""
    b, n, _ = C.shape
    _, a, psi1, psi2, psi3 = along(sources, C, rng)
    one, two, three = derivatives(a, psi1, psi2, psi3)
    shares = []
    for found, bound in (
        (np.linalg.norm(one, axis=1), bounds.n1),
        (np.linalg.norm(two, axis=1), bounds.n2),
        (np.linalg.norm(three, axis=1), bounds.n3),
        (np.linalg.norm(one @ U.conj(), axis=1), bounds.u1),
        (np.sqrt(np.mean(psi2**2, axis=1)), bounds.m2),
    ):
        found = found.reshape(b, n)
        assert (found <= bound[:, None] * (1 + 1e-6) + 1e-7).all()
        shares.append(np.max(found / (bound[:, None] + 1e-9)))
    speed = np.linalg.norm(one, axis=1).reshape(b, n)
    assert (speed >= bounds.v[:, None] * (1 - 1e-9) - 1e-9).all()
    return np.array(shares)


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_stay_below_their_bounds_on_a_ball(name):
    sources, U, rng = sources_of(name, 16, 1)
    largest = np.zeros(5)
    for radius in RADII:
        rho = np.full(16, radius)
        bounds = ball_bounds(sources, rho, U)
        assert np.isfinite(bounds).all()
        largest = np.maximum(largest, check(bounds, sources, points_in(sources, rho, 60, rng), U, rng))
    assert (largest[:-1] > 0.3).all() and (largest[-1] > 0.5 or "paper" in name)  # the bounds are of use


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("parts", [2, 5])
def test_covers_hold_the_balls_and_their_bounds_hold(name, parts):
    sources, U, rng = sources_of(name, 8, 2)
    for radius in (0.1, 0.3, 0.8, 3.0):
        rho = np.full(8, radius)
        pieces, radii, first = cover(sources, rho, parts)
        assert len(first) == 8 and first[0] == 0 and (np.diff([*first, len(radii)]) > 0).all()
        C = points_in(sources, rho, 60, rng)
        owner = np.repeat(np.arange(8), np.diff([*first, len(radii)]))
        for k in range(8):
            mine = owner == k
            t = (C[k][:, None] - pieces.C[mine]) @ sources.inverse[k].T
            assert (np.linalg.norm(t, axis=2) <= radii[mine] * (1 + 1e-9) + 1e-12).any(axis=1).all()
        each = ball_bounds(pieces, radii, U)
        assert np.isfinite(each).all()
        check(over_cover(each, first), sources, C, U, rng)


def test_balls_of_a_cover_stay_where_the_bounds_of_the_exact_phases_hold():
    sources, U, _ = sources_of("endfire, short", 4, 3)
    chart = sources.chart
    corners = charted(chart, np.array([[1.0, chart.upper[1]], [-1.0, chart.upper[1]], [1.0, chart.lower[1]]]))
    pieces, radii, _ = cover(corners, np.full(3, 2.0), 5)
    assert np.abs(pieces.C[:, 0]).max() <= 1 and (np.abs(pieces.C[:, 1]) * np.abs(chart.Q).max() < 1).all()
    assert np.isfinite(ball_bounds(pieces, radii, U)).all()
    outside = np.array([[1.2, 0.3]])
    assert chart.analytic(outside)[0, 0] == 1.0 and chart.analytic(outside)[0, 1] < 0.3


@pytest.mark.parametrize("dimension", [2, 3])
def test_norms_sampled_over_directions(dimension):
    directions, factor = _directions(dimension)
    assert_allclose(np.linalg.norm(directions, axis=1), 1)
    rng = np.random.default_rng(dimension)
    for _ in range(50):
        g = rng.standard_normal((dimension, 7)) * 10 ** rng.uniform(-2, 1, (dimension, 1))
        unit = scenes.in_unit_ball(3000, dimension, rng)[:1000]
        for p in (4, 6):
            sampled = np.linalg.norm(directions @ g, ord=p, axis=1).max()
            assert np.linalg.norm(unit @ g, ord=p, axis=1).max() <= factor * sampled
    assert factor < 1.03


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("parts", [1, 3])
def test_inner_products_stay_below_their_bounds(name, parts):
    sources, U, rng = sources_of(name, 4, 4)
    for radius in RADII:
        rho = radius * np.array([1.0, 0.3, 0.7, 0.5])
        pieces, radii, first = cover(sources, rho, parts)
        found = couplings(pieces, radii, ball_bounds(pieces, radii, U), first, sources)
        smallest, largest = gram_limits(sources, found)
        C = points_in(sources, rho, 80, rng)
        _, a, *psi = along(sources, C, rng)
        one, two, _ = (x.reshape(4, 80, -1) for x in derivatives(a, *psi))
        a = a.reshape(4, 80, -1)
        centre = sources.a.conj() @ sources.a.T
        for j in range(4):
            for k in range(4):
                if j == k:
                    continue
                value = a[j].conj() @ a[k].T
                for x, bound in (
                    (value, found.value),
                    (a[j].conj() @ one[k].T, found.first),
                    (a[j].conj() @ two[k].T, found.second),
                    (one[j].conj() @ one[k].T, found.mixed),
                    (value - centre[j, k], found.change),
                ):
                    assert np.abs(x).max() <= bound[j, k] * (1 + 1e-9) + 1e-12
        gram = np.einsum("jnm,knm->njk", a.conj(), a)
        values = np.linalg.eigvalsh(gram)
        assert smallest - 1e-12 <= values.min() and values.max() <= largest + 1e-12
    assert (np.diag(found.value) == 0).all()
