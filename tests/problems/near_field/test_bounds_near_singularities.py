"""Bounds where derivatives lose their digits or do not exist: at elements, at the poles, at endfire, at the origin.

The reference is the Fisher information in an orthonormal basis at each source, in extended precision (64 bits).
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.bounds import deterministic_bound, position_bounds, stochastic_bound
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.parameters import parameter_deviations
from nfbench.problems.near_field.wavefronts import Manifold

LONG, COMPLEX = np.longdouble, np.clongdouble
TAU = 8 * np.arctan(LONG(1))
RNG = np.random.default_rng(7)
CLOUD = RNG.normal(scale=2.0, size=(9, 3))  # an array in wavelengths of 1 m
T, SNR = 20, np.array([3.0, 10.0])
SYMBOLS = complex_normal(np.random.default_rng(1), (2, T)) * np.sqrt(SNR)[:, None]
pytestmark = pytest.mark.skipif(np.finfo(LONG).nmant < 63, reason="needs an extended precision of 64 bits")


def sources(d: int, *rows: list[float]) -> np.ndarray:
    """Sources [azimuth, elevation, range], without the elevation in the plane."""
    return np.array(rows)[:, [0, 2] if d == 2 else [0, 1, 2]]


def array(d: int, wavefront: str = "exact", *more: np.ndarray) -> Manifold:
    positions = np.vstack([CLOUD, *more])
    return Manifold(positions * [1.0, 1.0, 1.0 if d == 3 else 0.0], 1.0, wavefront, d == 3)


def frame(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.longdouble]:
    """The unit vectors along rising azimuth (and elevation), the direction u, and the range of one source."""
    azimuth, elevation, r = LONG(theta[0]), LONG(theta[1] if len(theta) == 3 else 0.0), LONG(theta[-1])
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    tangents = [[-sa, ca, LONG(0)], [-se * ca, -se * sa, ce]][: len(theta) - 1]
    return np.array(tangents), np.array([ce * ca, ce * sa, se]), r


def phases(manifold: Manifold, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The phases (M,) [turns], and their derivatives per metre along the vectors of ``frame`` (d, M)."""
    tangents, u, r = frame(theta)
    Q = manifold.positions.astype(LONG)
    s, w = Q @ u, np.sum(Q**2, axis=1)
    if manifold.wavefront == "exact":
        away = r * u - Q
        distance = np.sqrt(np.sum(away**2, axis=1))
        v = away / distance[:, None]
        return r - distance, np.array([*(-(v @ t) for t in tangents), 1 - v @ u])
    fresnel = manifold.wavefront == "fresnel"
    by_s = (1 + s / r if fresnel else np.ones_like(s)) / r
    f, by_r = (s - (w - s * s) / (2 * r), (w - s * s) / (2 * r * r)) if fresnel else (s - w / (2 * r), w / (2 * r * r))
    return f, np.array([*(by_s * (Q @ t) for t in tangents), by_r])


def inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse by Gauss and Jordan with pivoting, in the precision of the matrix."""
    n = len(matrix)
    work = np.hstack([matrix, np.eye(n, dtype=matrix.dtype)])
    for i in range(n):
        pivot = i + int(np.argmax(np.abs(work[i:, i])))
        work[[i, pivot]] = work[[pivot, i]]
        work[i] /= work[i, i]
        for j in range(n):
            if j != i:
                work[j] -= work[j, i] * work[i]
    return work[:, n:]


def expected(manifold: Manifold, theta: np.ndarray, kind: str) -> np.ndarray:
    """The standard deviations along the vectors of ``frame`` (K, d) [m]."""
    (K, d), M = theta.shape, manifold.elements
    A, D = np.empty((M, K), COMPLEX), np.empty((M, K * d), COMPLEX)
    for k, row in enumerate(theta):
        f, slopes = phases(manifold, row)
        A[:, k] = np.cos(TAU * f) + 1j * np.sin(TAU * f)
        D[:, k * d : (k + 1) * d] = (1j * TAU * slopes * A[:, k]).T
    if kind == "deterministic":
        S = SYMBOLS[:K].astype(COMPLEX)
        X = S @ S.conj().T / T
    else:
        P = np.diag(SNR[:K]).astype(COMPLEX)
        X = P @ A.conj().T @ inverse(A @ P @ A.conj().T + np.eye(M)) @ A @ P
    projected = D - A @ (inverse(A.conj().T @ A) @ (A.conj().T @ D))
    information = (D.conj().T @ projected) * np.kron(X, np.ones((d, d))).T
    scale = 1 / np.sqrt(np.diag(information).real)
    C = inverse(information.real * np.outer(scale, scale)) * np.outer(scale, scale) / (2 * T)
    return np.sqrt(np.diag(C)).reshape(K, d).astype(float)


def covariance(manifold: Manifold, theta: np.ndarray, kind: str) -> np.ndarray:
    if kind == "deterministic":
        return deterministic_bound(manifold, theta, SYMBOLS[: len(theta)])
    return stochastic_bound(manifold, theta, SNR[: len(theta)], T)


def assert_right(manifold: Manifold, theta: np.ndarray, rtol: float) -> None:
    for kind in ("stochastic", "deterministic"):
        deviations = expected(manifold, theta, kind)
        C = covariance(manifold, theta, kind)
        assert_allclose(position_bounds(C, theta), np.sqrt(np.sum(deviations**2, axis=1)), rtol=rtol)
        metres = np.ones_like(theta)
        metres[:, :-1] = theta[:, -1:]
        if theta.shape[1] == 3:
            metres[:, 0] *= np.cos(theta[:, 1])
        assert_allclose(np.sqrt(np.diag(C)).reshape(theta.shape) * metres, deviations, rtol=rtol)


def assert_infinite(manifold: Manifold, theta: np.ndarray) -> None:
    for kind in ("stochastic", "deterministic"):
        C = covariance(manifold, theta, kind)
        assert np.isinf(C).all()
        assert np.isinf(position_bounds(C, theta)).all() and np.isinf(parameter_deviations(C, theta)).all()


DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
SIDES = {"out": [0.8, 0.6, 0.0], "across": [-0.6, 0.8, 0.0], "oblique": [-0.36, 0.48, 0.8]}


@DIMENSIONS
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("distance", [1e-1, 1e-3, 1e-4, 1e-6, 1e-9, 1e-11])
@pytest.mark.parametrize("count", [1, 2])
def test_bounds_near_an_element_are_right(d, side, distance, count):
    """Also with a second source, which is near to another element."""
    theta = sources(d, [0.7, 0.4, 5.0], [-0.5, -0.3, 3.0])[:count]
    elements = [5.0 * frame(theta[0])[1] - distance * np.array(SIDES[side])]
    elements += [3.0 * frame(theta[1])[1] + distance * np.array(SIDES["across"])] if count == 2 else []
    assert_right(array(d, "exact", np.array(elements, dtype=float)), theta, rtol=max(1e-7, 3e-15 * 5.0 / distance))


@DIMENSIONS
@pytest.mark.parametrize("d_m", [0.0, 1e-15, 3e-15])
@pytest.mark.parametrize("azimuth", [0.0, 0.7, math.pi / 2, math.pi])
def test_the_bound_at_an_element_is_infinite_however_its_position_is_rounded(d, azimuth, d_m):
    theta = sources(d, [azimuth, 0.4, 5.0], [-0.5, -0.3, 3.0])
    on = 5.0 * frame(theta[0])[1] + d_m
    assert_infinite(array(d, "exact", on[None].astype(float)), theta)
    assert_infinite(array(d, "exact", on[None].astype(float)), theta[:1])
    assert np.isfinite(covariance(array(d, "exact", on[None].astype(float)), theta[1:], "stochastic")).all()


@DIMENSIONS
def test_the_bound_at_several_elements_is_infinite(d):
    theta = sources(d, [0.7, 0.4, 5.0], [-0.5, -0.3, 3.0])
    assert_infinite(array(d, "exact", *(row[-1] * frame(row)[1].astype(float) for row in theta)), theta)


@pytest.mark.parametrize("origin", ["first", "center"])
@pytest.mark.parametrize("element", [1, 7, 31])
def test_the_bound_at_an_element_of_a_line_is_infinite(origin, element):
    positions = ULA(elements=32, spacing_wavelengths=0.25, origin=origin).place(0.02)
    theta = np.array([[math.copysign(math.pi / 2, positions[element, 1]), abs(positions[element, 1])]])
    assert_infinite(Manifold(positions, 0.02, "exact", False), theta)


@DIMENSIONS
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
@pytest.mark.parametrize("distance", [0.0, 1e-3, 1e-9])
def test_approximate_wavefronts_are_smooth_at_elements(d, wavefront, distance):
    theta = sources(d, [0.7, 0.4, 5.0], [-0.5, -0.3, 3.0])
    element = (5.0 * frame(theta[0])[1]).astype(float) + np.array([0.0, distance, 0.0])
    assert_right(array(d, wavefront, element), theta, rtol=1e-7)


@DIMENSIONS
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
@pytest.mark.parametrize("r", [1.0, 1e-2, 1e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("at_origin", [False, True])
def test_bounds_at_short_range(d, wavefront, r, at_origin):
    """Towards the origin, angles lose their meaning, but positions do not; an element there has a constant phase."""
    manifold = array(d, wavefront, *([np.zeros(3)] if at_origin else []))
    theta = sources(d, [0.7, 0.4, r], [-0.5, -0.3, 3.0])
    assert_right(manifold, theta[:1], rtol=1e-7)
    assert_right(manifold, theta, rtol=max(1e-7, 3e-14 / r))  # where phases grow as 1/r, they lose digits


@DIMENSIONS
@pytest.mark.parametrize("wavefront", ["fresnel", "paper"])
def test_bounds_are_infinite_where_phases_have_no_digits(d, wavefront):
    assert_infinite(array(d, wavefront), sources(d, [0.7, 0.4, 1e-13], [-0.5, -0.3, 3.0]))


@DIMENSIONS
def test_an_element_at_the_origin_is_one_like_any_other(d):
    at_origin = array(d, "exact", np.zeros(3))
    assert_infinite(at_origin, sources(d, [0.7, 0.4, 1e-14]))
    assert_right(array(d, "exact"), sources(d, [0.7, 0.4, 1e-14]), rtol=1e-7)


@pytest.mark.parametrize("elevation", [1.5, 1.57, math.pi / 2 - 1e-9, math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
def test_bounds_at_the_poles(elevation, wavefront):
    theta = np.array([[0.3, elevation, 5.0], [-0.5, -0.3, 3.0]])
    assert_right(array(3, wavefront), theta, rtol=1e-6)
    assert_right(array(3, wavefront), theta[:1], rtol=1e-6)


def test_at_a_pole_the_azimuth_alone_is_undetermined():
    theta = np.array([[0.3, math.pi / 2, 5.0], [-0.5, -0.3, 3.0]])
    C = covariance(array(3), theta, "stochastic")
    deviations = parameter_deviations(C, theta)
    assert np.isinf(deviations[0, 0]) and np.isfinite(deviations.ravel()[1:]).all()
    # the position bound does not depend on the azimuth by which the pole is described
    turned = theta + np.array([[1.1, 0, 0], [0, 0, 0]])
    assert_allclose(
        position_bounds(covariance(array(3), turned, "stochastic"), turned), position_bounds(C, theta), rtol=1e-6
    )


@pytest.mark.parametrize("wavefront", ["exact", "fresnel"])
@pytest.mark.parametrize("origin", ["first", "center"])
@pytest.mark.parametrize("azimuth", [math.pi / 2, -math.pi / 2])
def test_the_bound_on_the_axis_of_a_line_is_infinite(wavefront, origin, azimuth):
    """No derivative is left there: a line sees neither the azimuth nor the range of a source on its axis."""
    manifold = Manifold(ULA(elements=16, spacing_wavelengths=0.5, origin=origin).place(1.0), 1.0, wavefront, False)
    for r in (9.0, 20.0, 1000.0):
        assert_infinite(manifold, np.array([[azimuth, r]]))
        assert_infinite(manifold, np.array([[0.2, 15.0], [azimuth, r]]))


@pytest.mark.parametrize("wavefront", ["exact", "fresnel", "paper"])
@pytest.mark.parametrize("degrees", [89.0, 89.9, 89.99])
def test_bounds_near_the_axis_of_a_line_are_finite_and_right(wavefront, degrees):
    manifold = Manifold(ULA(elements=16, spacing_wavelengths=0.5, origin="center").place(1.0), 1.0, wavefront, False)
    assert_right(manifold, np.array([[math.radians(degrees), 12.0]]), rtol=1e-5)


@pytest.mark.parametrize("theta", [[0.3, math.pi / 2, 5.0], [math.pi / 2, 0.2, 5.0], [-math.pi / 2, 0.0, 5.0]])
def test_the_bound_in_the_plane_of_a_planar_array_is_infinite(theta):
    """To first order, a planar array does not see that a source leaves its plane."""
    manifold = Manifold(UPA(columns=4, rows=4, spacing_wavelengths=0.5, origin="center").place(1.0), 1.0, "exact", True)
    if theta[1] == math.pi / 2:
        theta = [0.0, *theta[1:]]
    assert_infinite(manifold, np.array([theta]))
