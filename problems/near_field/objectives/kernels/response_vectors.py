"""Response vectors a(θ), |a_m| = 1, and the derivatives of their phases, for the four models of the wavefront.

Lengths are in wavelengths and phases in turns, for which the reduction to one turn is exact. The phase of a_m in turns
is then the advance f = r − d_m: by how much nearer than the origin the source is to the element at q_m. It depends on
s = u·q_m, r and w = ‖q_m‖² only, where u is the unit vector towards the source.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import compiled

from .inner_products import SUMS
from .packing import EXACT, FRESNEL, PAPER, ArrayModel

__all__ = [
    "NEAR",
    "Source",
    "advance",
    "advance_slopes",
    "phase_gradient",
    "phasor",
    "phasors",
    "respond",
    "responses",
    "slopes",
    "source_at",
    "towards",
]

_CONTRACT = {"contract"}  # fused multiply-adds
_TINY = 1e-300  # the least d², so that no division by zero occurs where a source meets an element
NEAR = 1e3  # r/d from which d², a difference of squares, has lost too many digits for a direction


class Source(NamedTuple):
    """A candidate source: its direction as cosines and sines, its range in wavelengths, and its angles [rad]."""

    cos_azimuth: float
    sin_azimuth: float
    cos_elevation: float
    sin_elevation: float
    r: float
    azimuth: float
    elevation: float


# ------------------------------------------------------------------------------------------------- sine and cosine


@compiled(_CONTRACT)
def sine(g: float) -> float:
    """sin(2πg) for |g| <= 1/4: the minimax polynomial of degree 17, off by 5e-19 before rounding."""
    z = g * g
    p = 0.10064290911915101
    p = p * z - 0.7176655739661518
    p = p * z + 3.8199205370501965
    p = p * z - 15.094641230812554
    p = p * z + 42.058693910435544
    p = p * z - 76.70585975253722
    p = p * z + 81.60524927607067
    p = p * z - 41.34170224039974
    p = p * z + 6.283185307179586
    return p * g


@compiled(_CONTRACT)
def phasor(turns: float) -> tuple[float, float]:
    """cos(2πt) and sin(2πt): both are sines of triangle waves of t, cos of 1/4 − |t| and sin of 1/4 − |1/4 − |t||."""
    t = turns - np.rint(turns)  # exact, |t| <= 1/2
    quarter = 0.25 - abs(t)
    return sine(quarter), sine(math.copysign(0.25 - abs(quarter), t))


@compiled()
def phasors(turns: Float[ndarray, " n"], re: Float[ndarray, " n"], im: Float[ndarray, " n"]) -> None:
    """cos(2πt) into ``re`` and sin(2πt) into ``im``, (n,) each."""
    for m in range(len(turns)):
        re[m], im[m] = phasor(turns[m])


# ------------------------------------------------------------------------------------------------- the wavefront


@compiled(inline=True)
def advance(wavefront: int, s: float, r: float, w: float) -> float:
    """f = r − d [λ] of one element; s, r [λ], w [λ²]. SPEC.md §2 has the four d."""
    if wavefront == EXACT:  # f = (2rs − w)/(r + d), d = √(r² − 2rs + w): r − d without cancellation
        numerator = 2.0 * r * s - w
        d = math.sqrt(max(r * r - numerator, _TINY))
        return numerator / (r + d)
    if wavefront == FRESNEL:  # f = s − (w − s²)/2r
        return s - (w - s * s) * (0.5 / r)
    if wavefront == PAPER:  # f = s − w/2r: no cos²φ factor
        return s - w * (0.5 / r)
    return s  # planar: f = s


@compiled(inline=True)
def slopes(wavefront: int, s: float, r: float, w: float) -> tuple[float, float]:
    """∂f/∂s and ∂f/∂r of one element; s, r and w in any one unit of length.

    Where ∂f/∂s exceeds NEAR on an exact wavefront, the source is so near to the element that neither has digits: see
    ``towards``.
    """
    if wavefront == EXACT:  # ∂f/∂s = r/d, ∂f/∂r = 1 − (r − s)/d, again without cancellation
        numerator = 2.0 * r * s - w
        d = math.sqrt(max(r * r - numerator, _TINY))
        return r / d, (w - s * numerator / (r + d)) / ((r + d) * d)
    if wavefront == FRESNEL:  # ∂f/∂s = 1 + s/r, ∂f/∂r = (w − s²)/2r²
        return 1.0 + s / r, (w - s * s) / (2.0 * r * r)
    if wavefront == PAPER:  # ∂f/∂s = 1, ∂f/∂r = w/2r²
        return 1.0, w / (2.0 * r * r)
    return 1.0, 0.0  # planar


@compiled()
def advance_slopes(
    wavefront: int, s: Float[ndarray, "p m"], r: Float[ndarray, " p"], w: Float[ndarray, " m"]
) -> tuple[Float[ndarray, "p m"], Float[ndarray, "p m"]]:
    """∂f/∂s and ∂f/∂r of p sources and M elements, (p, M) each; s, r and w in any one unit of length."""
    by_s, by_r = np.empty_like(s), np.empty_like(s)
    for i in range(len(r)):
        for m in range(len(w)):
            by_s[i, m], by_r[i, m] = slopes(wavefront, s[i, m], r[i], w[m])
    return by_s, by_r


# ------------------------------------------------------------------------------------------------- response vectors


@compiled(_CONTRACT)
def source_at(X: Float[ndarray, "p n"], i: int, first: int, d: int, wavelength: float) -> Source:
    """The source θ = X[i, first:first+d]: [azimuth, range], or [azimuth, elevation, range] [rad, m]."""
    cos_azimuth, sin_azimuth = phasor(X[i, first] * (0.5 / math.pi))
    cos_elevation, sin_elevation, elevation = 1.0, 0.0, 0.0
    if d == 3:
        elevation = X[i, first + 1]
        cos_elevation, sin_elevation = phasor(elevation * (0.5 / math.pi))
    r = X[i, first + d - 1] / wavelength
    return Source(cos_azimuth, sin_azimuth, cos_elevation, sin_elevation, r, X[i, first], elevation)


@compiled(_CONTRACT)
def respond(array: ArrayModel, source: Source, a: Float[ndarray, "2 rows padded"], row: int) -> None:
    """a(θ) into the row of ``a``, zero beyond M: the advance of each element, then its phasor."""
    x, y = source.cos_elevation * source.cos_azimuth, source.cos_elevation * source.sin_azimuth
    z, r = source.sin_elevation, source.r
    wavefront, q = array.wavefront, array.geometry
    width = q.shape[1]
    for m in range(width):
        s = x * q[0, m] + y * q[1, m] + z * q[2, m]
        a[0, row, m] = advance(wavefront, s, r, q[3, m])
    for m in range(width):
        a[0, row, m], a[1, row, m] = phasor(a[0, row, m])
    for m in range(array.M, width):
        a[0, row, m] = a[1, row, m] = 0.0


@compiled(SUMS)
def phase_gradient(
    array: ArrayModel, source: Source, e: Float[ndarray, "2 rows padded"], gradient: Float[ndarray, " d"]
) -> None:
    """Σ_m e_m·∂t_m/∂θ into ``gradient`` [1/rad, 1/m]: t_m is the phase of a_m in turns, e row 0 of ``e``, 0 beyond M.

    With ∂u/∂φ = cosψ·[−sinφ, cosφ, 0] and ∂u/∂ψ = [−sinψ cosφ, −sinψ sinφ, cosψ].
    """
    cos_a, sin_a, cos_e, sin_e, r, _, _ = source
    x, y, z = cos_e * cos_a, cos_e * sin_a, sin_e
    wavefront, q = array.wavefront, array.geometry
    gx = gy = gz = gr = 0.0
    near = 0
    for m in range(q.shape[1]):
        s = x * q[0, m] + y * q[1, m] + z * q[2, m]
        by_s, by_r = slopes(wavefront, s, r, q[3, m])
        near += by_s > NEAR
        slope = e[0, 0, m] * by_s
        gx += slope * q[0, m]
        gy += slope * q[1, m]
        gz += slope * q[2, m]
        gr += e[0, 0, m] * by_r
    if near > 0 and wavefront == EXACT:
        gx, gy, gz, gr = _sums_near_an_element(array, source, e)
    gradient[0] = cos_e * (cos_a * gy - sin_a * gx)
    if len(gradient) == 3:
        gradient[1] = cos_e * gz - sin_e * (cos_a * gx + sin_a * gy)
    gradient[-1] = gr / array.wavelength


@compiled()
def _sums_near_an_element(
    array: ArrayModel, source: Source, e: Float[ndarray, "2 rows padded"]
) -> tuple[float, float, float, float]:
    """The sums Σ_m e_m·∂f/∂u and Σ_m e_m·∂f/∂r of an exact wavefront, where a source is near to some elements.

    For these, ∂f/∂u = (r/d)·q is replaced by (r/d)·(q − p) = −r·v, which differs by a multiple of u, so that the
    derivatives by the angles are the same; and ∂f/∂r = 1 − v·u. Both are bounded.
    """
    r, q = source.r, array.geometry
    cos_e = math.cos(source.elevation)  # sines of tiny angles keep their digits here, unlike those of ``phasor``
    x, y, z = cos_e * math.cos(source.azimuth), cos_e * math.sin(source.azimuth), math.sin(source.elevation)
    gx = gy = gz = gr = 0.0
    for m in range(array.M):
        by_s, by_r = slopes(EXACT, x * q[0, m] + y * q[1, m] + z * q[2, m], r, q[3, m])
        sx, sy, sz = by_s * q[0, m], by_s * q[1, m], by_s * q[2, m]
        if by_s > NEAR:
            vx, vy, vz = towards(x, y, z, r, q[0, m], q[1, m], q[2, m])
            sx, sy, sz, by_r = -r * vx, -r * vy, -r * vz, 1.0 - (vx * x + vy * y + vz * z)
        gx += e[0, 0, m] * sx
        gy += e[0, 0, m] * sy
        gz += e[0, 0, m] * sz
        gr += e[0, 0, m] * by_r
    return gx, gy, gz, gr


@compiled()
def towards(x: float, y: float, z: float, r: float, qx: float, qy: float, qz: float) -> tuple[float, float, float]:
    """The unit vector v = (p − q)/d from an element q to the source p = r·u, u = [x, y, z], at any distance d > 0.

    At the element itself f has a kink, and v is u: as if the source were a little farther out on its ray.
    """
    vx, vy, vz = r * x - qx, r * y - qy, r * z - qz
    largest = max(abs(vx), abs(vy), abs(vz))
    if not largest > 0.0:
        return x, y, z
    vx, vy, vz = vx / largest, vy / largest, vz / largest  # so that no square underflows
    length = math.sqrt(vx * vx + vy * vy + vz * vz)
    return vx / length, vy / length, vz / length


@compiled()
def responses(
    wavelength: float, wavefront: int, geometry: Float[ndarray, "4 padded"], M: int, X: Float[ndarray, "p d"]
) -> Complex[ndarray, "p m"]:
    """a(θ) of p candidates (p, d) [rad, m], one per row."""
    array = ArrayModel(wavelength, wavefront, geometry, M)
    A = np.empty((len(X), M), np.complex128)
    a = np.empty((2, 1, geometry.shape[1]))
    for i in range(len(X)):
        respond(array, source_at(X, i, 0, X.shape[1], wavelength), a, 0)
        for m in range(M):
            A[i, m] = complex(a[0, 0, m], a[1, 0, m])
    return A
