"""The phases of a response, their derivatives, and the bounds of their third derivatives, against plain formulas."""

import certificate_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench import Incompatible
from nfbench.core.options import build
from nfbench.problems.near_field.certificate import chart as chart_module
from nfbench.problems.near_field.scenario import NearField

ULA = scenes.SHORT | {"array": {"kind": "ula", "elements": 12, "spacing_wavelengths": 0.5, "origin": "center"}}
FIRST = ULA | {"array": ULA["array"] | {"origin": "first"}}
UPA = scenes.PLANE | {"array": scenes.PLANE["array"] | {"columns": 4, "rows": 3}, "range_m": [0.06, 2.0]}
GEOMETRIES = {
    "centre": ULA | {"range_m": [0.07, 2.0]},
    "first": FIRST | {"range_m": [0.2, 4.0]},
    "endfire": ULA | {"range_m": [0.07, 2.0], "azimuth_deg": [-90, 90]},
    "both sides": ULA | {"range_m": [0.07, 2.0], "azimuth_deg": [-150, 150]},
    "plane in 2-D": UPA | {"elevation_deg": None, "sources": 2},
    "plane": UPA,
    "custom": scenes.CUSTOM | {"range_m": [0.2, 2.0]},
    "custom, 3-D": scenes.CUSTOM | {"range_m": [0.2, 2.0], "elevation_deg": [-90, 90]},
}
CASES = [(name, wavefront) for name in GEOMETRIES for wavefront in ("exact", "fresnel", "paper")]


def chart_of(name, wavefront="exact", **changes):
    scenario = build(NearField, GEOMETRIES[name] | {"wavefront": wavefront} | changes)
    return chart_module.chart_of(scenario.manifold(), *scenario.box())


def differences(f, c, steps, step):
    """The first, second and third derivative of f along ``steps`` (n, d) at c (n, d), in extended precision."""
    c, h = c.astype(np.longdouble), np.longdouble(step)
    at = {i: f(c + i * h * steps) for i in (-2, -1, 0, 1, 2)}
    first = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)
    second = (16 * (at[1] + at[-1]) - 30 * at[0] - (at[2] + at[-2])) / (12 * h**2)
    third = (at[2] - 2 * at[1] + 2 * at[-1] - at[-2]) / (2 * h**3)
    return [d.astype(float) for d in (first, second, third)]


@pytest.mark.parametrize(("name", "wavefront"), CASES)
def test_responses_and_derivatives(name, wavefront):
    chart, rng = chart_of(name, wavefront), np.random.default_rng(1)
    C = scenes.random_coordinates(chart, 20, rng)
    S = rng.standard_normal((20, chart.dimension, chart.dimension)) * chart.width[:, None]
    a, g, h = chart.jets(C, S)
    assert_allclose(a, scenes.responses(chart, C), atol=1e-12)
    for _ in range(4):
        t = rng.standard_normal((20, chart.dimension))
        along = (S @ t[:, :, None])[:, :, 0]
        first, second, _ = differences(lambda c: scenes.phases(chart, c), C, along, 1e-4)
        scale = np.abs(second).max()
        assert_allclose(np.einsum("bim,bi->bm", g, t), first, atol=1e-7 * np.abs(first).max())
        assert_allclose(np.einsum("bijm,bi,bj->bm", h, t, t), second, atol=1e-6 * scale + 1e-7)


@pytest.mark.parametrize(("name", "wavefront"), CASES)
def test_third_derivatives_stay_below_their_bounds(name, wavefront):
    chart, rng, n = chart_of(name, wavefront), np.random.default_rng(2), 400
    C, X = scenes.random_coordinates(chart, n, rng), scenes.random_coordinates(chart, n, rng)
    share = rng.random((n, 1)) ** 2
    X = C + share * (X - C)  # the bounds hold within the distance of X
    angles = np.linalg.norm((X - C)[:, :-1], axis=1)
    bounds = chart.third(C, angles, np.abs(X - C)[:, -1])
    assert np.isfinite(bounds).all()
    steps = rng.standard_normal((n, chart.dimension)) * chart.width
    steps[: n // 4, :-1] = 0  # along κ only
    steps[n // 4 : n // 2, -1] = 0  # along the angles only
    p, q = np.linalg.norm(steps[:, :-1], axis=1)[:, None], np.abs(steps[:, -1:])
    bound = bounds[:, 0] * p**3 + 3 * bounds[:, 1] * p**2 * q + 3 * bounds[:, 2] * p * q**2 + bounds[:, 3] * q**3
    third = differences(lambda c: scenes.advances(chart, c), X, steps, 3e-4)[2]
    assert (np.abs(third) <= bound * (1 + 1e-6) + 1e-4).all()
    if wavefront == "exact":
        assert np.max(np.abs(third) / (bound + 1e-3)) > 0.3


def test_coefficients_of_the_power_series():
    exact, crude = chart_module._series()
    x = np.concatenate([np.linspace(-1, 1, 20_001), np.cos(np.random.default_rng(3).uniform(0, np.pi, 20_000))])
    before, C = np.ones_like(x), -x
    for n in range(2, chart_module.TERMS + 1):
        before, C = C, (x * (2 * n - 3) * C - (n - 3) * before) / n  # Gegenbauer's C_n^(−1/2)
        if n < 4:
            continue
        largest = np.abs(C).max()
        factor = (n - 1) * (n - 2) * (n - 3)
        assert largest <= exact[n - 4] / factor <= largest * 1.01 + 1e-7
        assert exact[n - 4] <= crude[n - 4]


def test_the_sphere_of_directions_turns_no_faster_than_the_slopes_say():
    chart, rng = chart_of("custom, 3-D", "paper"), np.random.default_rng(4)
    C = scenes.random_coordinates(chart, 3000, rng)
    C[:1000, 1] = np.pi / 2  # the poles, where the second and third derivatives are largest
    C[:, -1] = 0.01
    steps = rng.standard_normal((3000, 3))
    steps[:, -1] = 0
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    for order, found in enumerate(differences(lambda c: scenes.advances(chart, c), C, steps, 1e-3)):
        ratio = np.abs(found) / (2 * np.pi * chart._slopes[order])
        assert 0.9 < ratio.max() < 1 + 1e-4


def test_bounds_of_phases_are_known_only_for_ranges_beyond_the_elements():
    with pytest.raises(Incompatible, match="range_m"):
        chart_of("centre", range_m=[0.05, 2.0])
    with pytest.raises(Incompatible, match="wavefront"):
        chart_of("centre", "planar")
    with pytest.raises(Incompatible, match="positions"):
        chart_of("first", "paper", array=FIRST["array"] | {"spacing_wavelengths": 100.0})


def test_coordinates_next_to_an_edge_are_on_it():
    chart = chart_of("endfire")
    inside = chart.lower + 1e-13 * chart.width, chart.upper - 1e-13 * chart.width, (chart.lower + chart.upper) / 2
    snapped = chart.snapped(np.array(inside))
    assert (snapped == [chart.lower, chart.upper, inside[2]]).all()
    theta = chart.to_theta(snapped)
    assert (chart.from_theta(theta)[:2] == snapped[:2]).all()
