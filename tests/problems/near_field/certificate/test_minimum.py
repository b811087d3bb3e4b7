"""Values, derivatives and bounds of J and D around a configuration, against differences; T4, T5 and T6 at random."""

import math

import certificate_scenes as scenes
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from nfbench.problems.near_field.certificate.balls import ball_bounds, charted, cover, over_cover
from nfbench.problems.near_field.certificate.certify import _joint_radius, _Proof, two_sources
from nfbench.problems.near_field.certificate.couplings import couplings, gram_limits
from nfbench.problems.near_field.certificate.minimum import (
    Expansion,
    distance_expansion,
    distance_third,
    misfit_expansion,
    misfit_third,
)

SMALL_PLANE = scenes.PLANE | {"array": scenes.PLANE["array"] | {"columns": 6, "rows": 5}, "range_m": [0.06, 1.0]}
SHORT_PAPER = scenes.PAPER | {"array": scenes.PAPER["array"] | {"elements": 24, "spacing_wavelengths": 0.5}}
SCENES = {
    "line": scenes.SHORT,
    "line, paper, first": SHORT_PAPER,
    "plane": SMALL_PLANE,
    "custom": scenes.CUSTOM,
}


def sources_of(name, seed=0, shift=0.1, **changes):
    """Sources of a scene, moved at random by some of their whitened coordinates, and the subspace."""
    instance, rng = scenes.draw(SCENES[name], seed, **changes), np.random.default_rng(seed)
    chart = scenes.chart(instance)
    sources = charted(chart, chart.from_theta(instance.theta))
    moved = sources.C + (sources.S @ (shift * rng.standard_normal((*sources.C.shape, 1))))[..., 0]
    return charted(chart, chart.snapped(np.clip(moved, chart.lower, chart.upper))), scenes.subspace(instance), rng


def moved(sources, t):
    """Coordinates of the sources after steps t (…, K, d)."""
    return sources.C + (sources.S @ t[..., None])[..., 0]


def misfits(sources, U, steps):
    """J (n,) after steps (n, K, d), by QR."""
    a = scenes.responses(sources.chart, moved(sources, steps).reshape(-1, steps.shape[-1]))
    Q = np.linalg.qr(a.reshape(*steps.shape[:2], -1).swapaxes(1, 2))[0]
    return U.shape[1] - np.sum(np.abs(Q.conj().swapaxes(1, 2) @ U) ** 2, axis=(1, 2))


def one_of(sources, k, U):
    """Source k alone, and D (n,) after its steps (n, 1, d)."""
    alone = charted(sources.chart, sources.C[k : k + 1], sources.S[k : k + 1])
    return alone, lambda t: scenes.distances(U, alone.chart, moved(alone, t)[:, 0])


def hessian(f, n, h=1e-3):
    """The gradient and the Hessian of f, which takes rows (p, n), by differences of fourth order along pairs."""
    weights = {
        -2: (1 / 12, -1 / 12),
        -1: (-8 / 12, 16 / 12),
        0: (0, -30 / 12),
        1: (8 / 12, 16 / 12),
        2: (-1 / 12, -1 / 12),
    }

    def along(direction):
        values = f(np.array(list(weights))[:, None] * h * direction)
        first, second = np.array(list(weights.values())).T @ values
        return first / h, second / h**2

    E = np.eye(n)
    gradient = np.array([along(e)[0] for e in E])
    H = np.array([[(along(E[i] + E[j])[1] - along(E[i] - E[j])[1]) / 4 for j in range(n)] for i in range(n)])
    return gradient, H


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_of_the_misfit_and_the_distance(name):
    sources, U, _ = sources_of(name)
    K, d = sources.C.shape
    found = misfit_expansion(sources, U)
    gradient, H = hessian(lambda t: misfits(sources, U, t.reshape(-1, K, d)), K * d)
    assert found.value == pytest.approx(misfits(sources, U, np.zeros((1, K, d)))[0], abs=1e-12)
    assert_allclose(found.gradient, gradient, atol=1e-8)
    assert_allclose(found.hessian, H, atol=1e-6)
    for k, one in enumerate(distance_expansion(sources, U)):
        D = one_of(sources, k, U)[1]
        gradient, H = hessian(lambda t, D=D: D(t[:, None]), d)
        assert one.value == pytest.approx(D(np.zeros((1, 1, d)))[0], abs=1e-12)
        assert_allclose(one.gradient, gradient, atol=1e-8)
        assert_allclose(one.hessian, H, atol=1e-6)


def test_third_derivative_of_the_projector():
    """P''' = O + Oᴴ + 3(NXᴴ + XNᴴ − NᴴX − XᴴN), by which T6 bounds J'''."""
    rng, M, K = np.random.default_rng(1), 7, 3
    A, A1, A2, A3 = rng.standard_normal((4, M, K)) + 1j * rng.standard_normal((4, M, K))

    def projector(s):
        Q = np.linalg.qr(A + s * A1 + s**2 / 2 * A2 + s**3 / 6 * A3)[0]
        return Q @ Q.conj().T

    P, pinv = projector(0), np.linalg.pinv(A)
    away = np.eye(M) - P
    X, Y, V, Z = away @ A1 @ pinv, P @ A1 @ pinv, P @ A2 @ pinv, away @ A2 @ pinv
    N, adjoint = Z - 2 * X @ Y, X.conj().T
    Omega = away @ A3 @ pinv - 3 * X @ (V + adjoint @ X) - 3 * Z @ Y + 6 * X @ Y @ Y - 3 * X @ adjoint @ X
    half = Omega + 3 * (N @ adjoint - N.conj().T @ X)
    h = 2e-3
    values = {i: projector(i * h) for i in (-3, -2, -1, 1, 2, 3)}
    odd = {i: values[i] - values[-i] for i in (1, 2, 3)}
    third = (-13 * odd[1] + 8 * odd[2] - odd[3]) / (8 * h**3)
    assert_allclose(half + half.conj().T, third, atol=2e-4 * np.abs(third).max())


def third_differences(f, t, direction, h):
    at = {i: f(t + i * h * direction) for i in (-2, -1, 1, 2)}
    return (at[2] - 2 * at[1] + 2 * at[-1] - at[-2]) / (2 * h**3)


def pairs(sources, rho, n, rng):
    """Random steps t (n, K, d) in the balls and in Θ, and unit directions."""
    K, d = sources.C.shape
    t = np.stack([scenes.in_unit_ball(n, d, rng)[rng.permutation(n)] * r for r in rho], axis=1)
    chart = sources.chart
    for _ in range(12):
        outside = ((moved(sources, t) < chart.lower) | (moved(sources, t) > chart.upper)).any(axis=(1, 2))
        t[outside] /= 2
    t[outside] = 0
    direction = rng.standard_normal((n, K, d)) * (rng.random((n, K, 1)) < 0.6)
    direction[:, 0] += 1e-6
    return t, direction / np.linalg.norm(direction, axis=(1, 2), keepdims=True)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("snr", [0.0, 20.0])
def test_third_derivatives_stay_below_their_bounds(name, snr):
    sources, U, rng = sources_of(name, 1, 0.02, snr_db=snr)
    K = len(sources.C)
    J = misfit_expansion(sources, U).value
    D = np.array([e.value for e in distance_expansion(sources, U)])
    best = 0.0
    for radius, parts in ((0.01, 1), (0.1, 1), (0.3, 3), (0.6, 4)):
        rho = radius * rng.uniform(0.3, 1, K)
        r = math.sqrt(np.sum(rho**2))
        pieces, radii, first = cover(sources, rho, parts)
        each = ball_bounds(pieces, radii, U)
        bounds, found = over_cover(each, first), couplings(pieces, radii, each, first, sources)
        limits = gram_limits(sources, found)
        bound = misfit_third(bounds, found, limits, J, r)
        if limits[0] <= 0:
            assert bound == math.inf
            continue
        t, direction = pairs(sources, rho, 300, rng)
        third = np.abs(third_differences(lambda x: misfits(sources, U, x), t, direction, 2e-3))
        assert third.max() <= bound + 1e-4
        best = max(best, third.max() / bound)
        for k in range(K):
            alone, distance = one_of(sources, k, U)
            third = third_differences(distance, *pairs(alone, rho[k : k + 1], 200, rng), 2e-3)
            assert np.abs(third).max() <= distance_third(bounds, D, rho)[k] + 1e-4
    assert best > 0.005


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("snr", [0.0, 20.0])
def test_two_sources_in_a_ball_cost_what_t4_says(name, snr):
    sources, U, rng = sources_of(name, 2, 0.02, snr_db=snr)
    for radius in (0.02, 0.1, 0.2, 0.4):
        K = len(sources.C)
        rho = np.full(K, radius)
        bound = np.maximum(*(two_sources(sources, rho, U, parts) for parts in (1, 4)))
        for k in range(K):
            alone, _ = one_of(sources, k, U)
            a, b = (moved(alone, pairs(alone, rho[k : k + 1], 3000, rng)[0])[:, 0] for _ in range(2))
            near = a + 1e-3 * (b - a)
            for one, two in ((a, b), (a, near)):
                w = scenes.responses(alone.chart, two) - scenes.responses(alone.chart, one)
                square = np.sum(np.abs(w) ** 2, axis=1)
                ratio = 1 - np.sum(np.abs(w @ U.conj()) ** 2, axis=1)[square > 1e-10] / square[square > 1e-10]
                assert ratio.min() >= bound[k] - 1e-6
            if radius == 0.02:
                assert bound[k] > 0.5 * ratio.min()


@pytest.mark.parametrize("name", SCENES)
def test_the_misfit_is_at_least_the_weighted_sum_of_distances(name):
    sources, U, rng = sources_of(name, 3, 0.1, snr_db=0.0)
    K = len(sources.C)
    for radius in (0.05, 0.3, 0.6):
        rho = np.full(K, radius)
        pieces, radii, first = cover(sources, rho, 3)
        found = couplings(pieces, radii, ball_bounds(pieces, radii, U), first, sources)
        weights = 1 / (1 + found.value.sum(axis=1))
        t, _ = pairs(sources, rho, 1000, rng)
        C = moved(sources, t)
        D = np.stack([scenes.distances(U, sources.chart, C[:, k]) for k in range(K)], axis=1)
        assert (misfits(sources, U, t) >= D @ weights - 1e-12).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.01, 1.0), st.floats(0.0, 2.0))
def test_radii_of_t5_hold_every_configuration(seed, f, T):
    """The radii that T5 leaves, where D is as low as its bounds allow: D = max(0, D + gᵗt + ½tᵗHt − T‖t‖³/6)."""
    rng, K, d = np.random.default_rng(seed), 2, 2
    expansions = [
        Expansion(f * rng.random(), 0.3 * rng.standard_normal(d), np.diag(rng.uniform(0.2, 2, d))) for _ in range(K)
    ]
    sources, _, _ = sources_of("line", sources=2, shift=0.0)
    proof = object.__new__(_Proof)
    proof.f = f
    rho, weights = rng.uniform(0.05, 0.5, K), rng.uniform(0.5, 1, K)
    radii, joint, slack, lows = proof.shrink(sources, expansions, np.full(K, T), weights, rho)
    t = np.stack([scenes.in_unit_ball(4000, d, rng)[rng.permutation(4000)] * r for r in rho], axis=1)
    length = np.linalg.norm(t, axis=2)
    D = np.stack(
        [
            e.value + t[:, k] @ e.gradient + np.einsum("ni,ij,nj->n", t[:, k], e.hessian, t[:, k]) / 2
            for k, e in enumerate(expansions)
        ],
        axis=1,
    )
    D = np.maximum(D - T * length**3 / 6, 0.0)
    assert (lows <= D).all()
    low = D @ weights <= f
    assert (length[low] <= radii + 1e-12).all() and (np.linalg.norm(length[low], axis=1) <= joint + 1e-12).all()
    assert (D[low] <= lows + slack / weights + 1e-12).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_the_joint_radius_holds_every_choice_of_boxes(seed):
    rng, K, f = np.random.default_rng(seed), 3, 0.3
    longest, least = rng.random((K, 8)), rng.random((K, 8)) * f
    least[:, 0] = 0.0
    weights = rng.uniform(0.5, 1, K)
    r = _joint_radius(list(longest), list(least), weights, f)
    choices = np.stack(np.meshgrid(*[np.arange(8)] * K, indexing="ij"), axis=-1).reshape(-1, K)
    D, t = least[np.arange(K), choices] @ weights, np.linalg.norm(longest[np.arange(K), choices], axis=1)
    assert t[f >= D].max() <= r + 1e-12 <= np.linalg.norm(longest.max(axis=1)) * 1.8
