"""Response vectors and their derivatives, compared with naive formulas, limits and symmetries."""

import math
from dataclasses import replace

import numpy as np
import oracles
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from nfbench.problems.near_field.arrays import UCA, ULA, UPA
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
WAVEFRONTS = ["exact", "fresnel", "paper", "planar"]
ARRAYS = {
    "ula": ULA(elements=32, spacing_wavelengths=0.25, origin="first"),
    "upa": UPA(columns=5, rows=4, spacing_wavelengths=0.5, origin="center"),
    "uca": UCA(elements=9, radius_wavelengths=2.0, origin="center"),
}
BOXES = {False: ([-1.1, 0.3], [1.1, 20.0]), True: ([-1.1, -0.6, 0.3], [1.1, 0.6, 20.0])}


def manifold_of(array: str, wavefront: str, has_elevation: bool) -> Manifold:
    return Manifold(ARRAYS[array].place(WAVELENGTH), WAVELENGTH, wavefront, has_elevation)


def candidates(has_elevation: bool) -> np.ndarray:
    """Return random points of the box and its corners."""
    lower, upper = map(np.array, BOXES[has_elevation])
    corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), axis=-1).reshape(-1, len(lower))
    return np.vstack([np.random.default_rng(1).uniform(lower, upper, (20, len(lower))), corners])


@pytest.mark.parametrize("has_elevation", [False, True])
@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize("wavefront", WAVEFRONTS)
def test_response_agrees_with_naive_distances(array, wavefront, has_elevation):
    manifold = manifold_of(array, wavefront, has_elevation)
    theta = candidates(has_elevation)
    a = manifold.response(theta)
    assert_allclose(a, [oracles.response(manifold, row) for row in theta], rtol=0, atol=1e-10)
    assert_allclose(np.abs(a), 1.0, rtol=1e-14)
    assert_allclose(manifold.response(theta[3]), a[3], rtol=0, atol=1e-12)  # a single point


@pytest.mark.parametrize("has_elevation", [False, True])
@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize("wavefront", WAVEFRONTS)
def test_derivatives_agree_with_finite_differences(array, wavefront, has_elevation):
    manifold = manifold_of(array, wavefront, has_elevation)
    theta = candidates(has_elevation)
    a, D = manifold.response_and_derivatives(theta)
    assert_allclose(a, manifold.response(theta), rtol=0, atol=1e-14)
    for row, derivatives in zip(theta, D, strict=True):
        steps = np.full(len(row), 1e-6)
        expected = oracles.central_difference(manifold.response, row, steps)
        assert_allclose(derivatives, expected, rtol=0, atol=1e-7 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("wavefront", WAVEFRONTS)
def test_range_derivatives_are_accurate_far_away(wavefront):
    """The derivative must have correct digits even where the response hardly depends on the range."""
    manifold = manifold_of("ula", wavefront, False)
    theta = np.array([[0.4, 3000.0]])
    _, D = manifold.response_and_derivatives(theta)
    expected = oracles.central_difference(manifold.response, theta[0], np.array([1e-7, 100.0]))
    assert_allclose(D[0, 1], expected[1], rtol=0, atol=5e-3 * np.abs(expected[1]).max())


def test_paper_wavefront_is_the_printed_ula_equation():
    """The paper has d_m = r − (m−1)δ·sinφ + (m−1)²δ²/(2r) and a_m = exp(jk(d_1 − d_m))."""
    manifold = manifold_of("ula", "paper", False)
    phi, r, delta, m = 0.7, 1.9, 0.005, np.arange(1, 33)
    d = r - (m - 1) * delta * math.sin(phi) + (m - 1) ** 2 * delta**2 / (2 * r)
    a = manifold.response(np.array([phi, r]))
    assert_allclose(a, np.exp(2j * np.pi / WAVELENGTH * (d[0] - d)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("wavefront", WAVEFRONTS)
def test_the_first_element_has_phase_zero_if_it_is_the_origin(wavefront):
    manifold = manifold_of("ula", wavefront, False)
    assert_allclose(manifold.response(candidates(False))[:, 0], 1.0, rtol=0, atol=1e-14)


def test_the_exact_wavefront_is_accurate_at_long_range():
    """At 1000 km, d_m − r loses its digits to cancellation in a naive computation, but not in the stable form."""
    manifold = manifold_of("ula", "exact", False)
    theta = np.array([0.3, 1e6])
    far = manifold.response(theta)
    series = manifold.under("fresnel").response(theta)  # its phase error is 2e-13 here
    assert_allclose(far, series, rtol=0, atol=1e-10)
    assert np.abs(oracles.response(manifold, theta) - series).max() > 1e-10  # so the test is sensitive enough


@pytest.mark.parametrize(("ratio", "order"), [("fresnel", 2), ("paper", 1), ("planar", 1)])
def test_approximate_wavefronts_tend_to_the_exact_one(ratio, order):
    """The phase error decreases as 1/r for the planar wavefront and the paper's, and as 1/r² for Fresnel's."""
    exact, near = manifold_of("ula", "exact", False), manifold_of("ula", ratio, False)

    def error(r: float) -> float:
        theta = np.array([0.6, r])
        return float(np.abs(np.angle(near.response(theta) / exact.response(theta))).max())

    assert error(20.0) / error(40.0) == pytest.approx(2**order, rel=0.03)


def test_fresnel_and_paper_agree_at_broadside_only():
    fresnel, paper = manifold_of("ula", "fresnel", False), manifold_of("ula", "paper", False)
    assert_allclose(fresnel.response(np.array([0.0, 1.0])), paper.response(np.array([0.0, 1.0])), atol=1e-14)
    assert np.abs(fresnel.response(np.array([1.0, 1.0])) - paper.response(np.array([1.0, 1.0]))).max() > 0.1


def test_elevation_zero_equals_the_plane():
    plane, space = manifold_of("upa", "exact", False), manifold_of("upa", "exact", True)
    assert_allclose(
        plane.response(np.array([[0.4, 2.0]])), space.response(np.array([[0.4, 0.0, 2.0]])), rtol=0, atol=1e-14
    )
    assert (plane.dimension, space.dimension) == (2, 3)


def test_the_response_to_a_source_at_an_element_is_finite():
    manifold = manifold_of("ula", "exact", False)
    for element in (1, 7, 31):
        theta = np.array([[math.pi / 2, manifold.positions[element, 1]]])
        a, D = manifold.response_and_derivatives(theta)
        assert np.isfinite(a).all()
        assert np.isfinite(D).all()
        assert_allclose(np.abs(a), 1.0, rtol=1e-12)


def test_under_changes_the_wavefront_and_nothing_else():
    manifold = manifold_of("ula", "exact", False)
    assert manifold.under(None) is manifold
    other = manifold.under("planar")
    assert (other.wavefront, other.wavelength_m, other.has_elevation) == ("planar", WAVELENGTH, False)
    assert other.positions is manifold.positions


@settings(deadline=None, database=None, derandomize=True, max_examples=40)
@given(
    angle=st.floats(-3.0, 3.0),
    azimuth=st.floats(-1.5, 1.5),
    elevation=st.floats(-1.2, 1.2),
    r=st.floats(0.5, 30.0),
    wavefront=st.sampled_from(WAVEFRONTS),
)
def test_rotating_array_and_source_together_changes_nothing(angle, azimuth, elevation, r, wavefront):
    Q = np.random.default_rng(3).normal(scale=0.1, size=(12, 3))
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    original = Manifold(Q, WAVELENGTH, wavefront, True)
    rotated = replace(original, positions=Q @ rotation.T)
    assert_allclose(
        rotated.response(np.array([azimuth + angle, elevation, r])),
        original.response(np.array([azimuth, elevation, r])),
        rtol=0,
        atol=1e-10,
    )


def test_cartesian_uses_the_right_handed_frame():
    quarter = math.pi / 2
    assert_allclose(
        cartesian(np.array([[0.0, 0.0, 2.0], [quarter, 0.0, 2.0], [0.3, quarter, 2.0]])),
        [[2, 0, 0], [0, 2, 0], [0, 0, 2]],
        atol=1e-15,
    )
    assert_allclose(cartesian(np.array([[math.pi / 6, 2.0]])), [[math.sqrt(3), 1.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize(("snr_db", "bounds"), [(0, [0.0220, 0.0598, 0.2271]), (10, [0.0069, 0.0188, 0.0716])])
def test_derivatives_give_the_reference_cramer_rao_bounds(snr_db, bounds):
    """A Monte Carlo simulation of estimators agrees with these reference values to within 10 %."""
    positions = ULA(elements=128, spacing_wavelengths=0.25, origin="center").place(WAVELENGTH)
    theta = np.array([[math.radians(-35), 4.0], [math.radians(5), 8.0], [math.radians(40), 12.0]])
    manifold = Manifold(positions, WAVELENGTH, "exact", False)
    assert_allclose(oracles.position_bounds(manifold, theta, snr_db, 200), bounds, rtol=0, atol=6e-5)


def test_array_shapes_are_checked_during_tests():
    from jaxtyping import TypeCheckError

    from nfbench.problems.near_field.subspace import compress

    with pytest.raises(TypeCheckError):
        compress(np.ones(3))
