"""The scalar formulas of the wavefronts, which every kernel inlines, against the printed distances."""

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.objectives import kernels
from nfbench.problems.near_field.objectives.kernels.response_vectors import advance, slopes

EVERY_WAVEFRONT = pytest.mark.parametrize("wavefront", kernels.WAVEFRONTS)
RNG = np.random.default_rng(0)
ELEMENTS = RNG.normal(scale=3.0, size=(20, 3))
SOURCES = RNG.uniform([-1.2, -0.6, 12.0], [1.2, 0.6, 900.0], (20, 3))


def arguments(theta: np.ndarray, q: np.ndarray) -> tuple[float, float, float]:
    """s, r and w."""
    return float(oracles.position(theta) / theta[-1] @ q), float(theta[-1]), float(q @ q)


def test_sine_and_cosine_of_up_to_1e5_radians():
    kernels.warm_up()
    rng = np.random.default_rng(0)
    eighths = np.arange(-40, 41) / 8
    turns = np.concatenate([rng.uniform(-1, 1, 20_000), rng.uniform(-16_000, 16_000, 20_000), eighths, eighths + 1e-9])
    cosine, sine = np.empty_like(turns), np.empty_like(turns)
    kernels.phasors(turns, cosine, sine)
    pi = np.longdouble("3.14159265358979323846264338327950288")
    phase = 2 * pi * (turns.astype(np.longdouble) - np.rint(turns))
    assert np.abs(cosine - np.cos(phase)).max() <= 3e-16
    assert np.abs(sine - np.sin(phase)).max() <= 3e-16


@EVERY_WAVEFRONT
def test_the_advance_is_how_much_nearer_the_source_is(wavefront):
    for theta, q in zip(SOURCES, ELEMENTS, strict=True):
        value = advance.py_func(kernels.WAVEFRONTS[wavefront], *arguments(theta, q))
        assert value == pytest.approx(theta[-1] - oracles.distance(wavefront, theta, q), abs=1e-11)


@EVERY_WAVEFRONT
def test_the_slopes_are_the_derivatives_of_the_advance(wavefront):
    number = kernels.WAVEFRONTS[wavefront]
    for theta, q in zip(SOURCES, ELEMENTS, strict=True):
        s, r, w = arguments(theta, q)
        expected = oracles.central_difference(
            lambda v, w=w: advance.py_func(number, v[0], v[1], w), np.array([s, r]), np.array([1e-4, 1e-3])
        )
        assert_allclose(slopes.py_func(number, s, r, w), expected, rtol=1e-6, atol=1e-9)


@EVERY_WAVEFRONT
def test_the_slopes_of_arrays_are_those_of_their_entries_in_any_unit_of_length(wavefront):
    kernels.warm_up()
    number, unit = kernels.WAVEFRONTS[wavefront], 0.25  # a power of two: no rounding
    s = np.array([[arguments(theta, q)[0] for q in ELEMENTS] for theta in SOURCES])
    r, w = SOURCES[:, -1], np.sum(ELEMENTS**2, axis=1)
    by_s, by_r = kernels.advance_slopes(number, s, r, w)
    for i, m in np.ndindex(s.shape):
        assert (by_s[i, m], by_r[i, m]) == slopes.py_func(number, s[i, m], r[i], w[m])
    scaled = kernels.advance_slopes(number, s * unit, r * unit, w * unit**2)
    assert_allclose(scaled, (by_s, by_r), rtol=0, atol=0)
