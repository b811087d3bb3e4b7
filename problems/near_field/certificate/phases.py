"""The compiled derivatives of the phases, and the sums over the elements that bound them on a ball.

Lengths are in wavelengths, κ = λ/r, ψ = 2π·f(s, κ) with s = q·u. With η = d/r and v = w − s² the advance is

    exact      f = (2s − κw)/(1 + η)      fresnel    f = s − κv/2      paper      f = s − κw/2
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numba import types
from numpy import ndarray

from nfbench import compiled, load_kernels

from ..objectives.kernels.packing import FRESNEL, PAPER

__all__ = ["ball_sums", "phase_jets", "third_bounds", "warm_up"]

TURN = 2.0 * math.pi
SAMPLES = 8  # directions between the angles and κ


@compiled()
def _advance(wavefront: int, s: float, k: float, w: float) -> tuple[float, float, float, float, float, float]:
    """f, f_s, f_κ, f_ss, f_sκ and f_κκ of one element."""
    if wavefront == PAPER:
        return s - 0.5 * k * w, 1.0, -0.5 * w, 0.0, 0.0, 0.0
    v = w - s * s
    if wavefront == FRESNEL:
        return s - 0.5 * k * v, 1.0 + k * s, -0.5 * v, k, s, 0.0
    x = 1.0 - k * s
    n = math.sqrt(1.0 - 2.0 * k * s + k * k * w)  # η
    n_k = (k * w - s) / n
    kk = v * (n_k * (x + 2.0 * n) - n * s) / (n * (x + n)) ** 2
    return (2.0 * s - k * w) / (1.0 + n), 1.0 / n, -v / (n * (x + n)), k / n**3, (s - k * w) / n**3, kk


@compiled()
def _third(
    wavefront: int, s: float, k: float, w: float, ds: float, dk: float, k_max: float, series: Float[ndarray, "2 n"]
) -> tuple[float, float, float, float, float, float, float]:
    """Bounds of |f_s|, |f_ss|, |f_sκ|, |f_sss|, |f_ssκ|, |f_sκκ| and |f_κκκ| within ds of s and dk of κ, |κ| <= k_max.

    With |s − κw| <= ρη: f_s = 1/η, f_ss = κ/η³, f_sκ = (s − κw)/η³, f_sss = 3κ²/η⁵, f_ssκ = 1/η³ + 3κ(s − κw)/η⁵ and
    f_sκκ = 2w/η³ − 3v/η⁵, where 0 <= v <= wη². f_κκκ is bounded by its power series in z = κρ < 1.
    """
    if wavefront == PAPER:
        return 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    s_max = abs(s) + ds
    if wavefront == FRESNEL:
        return 1.0 + k_max * s_max, k_max, s_max, 0.0, 1.0, 0.0, 0.0
    rho = math.sqrt(w)
    z = k_max * rho
    if z >= 1.0:
        return math.inf, math.inf, math.inf, math.inf, math.inf, math.inf, math.inf
    square = 1.0 - 2.0 * k * s + k * k * w - 2.0 * k_max * ds - 2.0 * (s_max + k_max * w) * dk  # of η, at least
    e = math.sqrt(max(square, (1.0 - z) ** 2))
    exact, crude = 0.0, 0.0
    for n in range(series.shape[1] - 1, -1, -1):
        exact = exact * z + series[0, n]
        crude = crude * z + series[1, n]
    kkk = w * w * (exact + max(2.0 / (1.0 - z) ** 3 - crude, 0.0))
    ssk = 1.0 / e**3 + 3.0 * z / e**4
    return 1.0 / e, k_max / e**3, rho / e**2, 3.0 * k_max**2 / e**5, ssk, 2.0 * w / e**3, kkk


@compiled()
def _directions(c: Float[ndarray, " d"], is_sine: bool, u: Float[ndarray, "3 3 3"]) -> None:
    """u in u[0, 0], ∂_i u in u[0, 1 + i], ∂_ij u in u[1 + i, 1 + j], by the angles."""
    u[:] = 0.0
    if is_sine:
        u[0, 0, 1] = c[0]
        u[0, 1, 1] = 1.0
        return
    ca, sa = math.cos(c[0]), math.sin(c[0])
    ce, se = 1.0, 0.0
    if len(c) == 3:
        ce, se = math.cos(c[1]), math.sin(c[1])
    u[0, 0, 0], u[0, 0, 1], u[0, 0, 2] = ce * ca, ce * sa, se
    u[0, 1, 0], u[0, 1, 1] = -ce * sa, ce * ca
    u[1, 1, 0], u[1, 1, 1] = -ce * ca, -ce * sa
    if len(c) == 3:
        u[0, 2, 0], u[0, 2, 1], u[0, 2, 2] = -se * ca, -se * sa, ce
        u[1, 2, 0], u[1, 2, 1] = se * sa, -se * ca
        u[2, 1, 0], u[2, 1, 1] = se * sa, -se * ca
        u[2, 2, 0], u[2, 2, 1], u[2, 2, 2] = -ce * ca, -ce * sa, -se


@compiled()
def _dot(Q: Float[ndarray, "m 3"], m: int, u: Float[ndarray, " 3"]) -> float:
    return Q[m, 0] * u[0] + Q[m, 1] * u[1] + Q[m, 2] * u[2]


@compiled()
def phase_jets(
    wavefront: int, is_sine: bool, Q: Float[ndarray, "m 3"], C: Float[ndarray, "b d"], S: Float[ndarray, "b d d"]
) -> tuple[Complex[ndarray, "b m"], Float[ndarray, "b d m"], Float[ndarray, "b d d m"]]:
    """â at centres C, and the derivatives of its phases by t, θ = c + S·t, all in the centred gauge."""
    B, d = C.shape
    M = len(Q)
    a, g, h = np.empty((B, M), np.complex128), np.empty((B, d, M)), np.empty((B, d, d, M))
    u, first, second, half = np.empty((3, 3, 3)), np.empty(d), np.empty((d, d)), np.empty((d, d))
    values, scale = np.empty(M), 1.0 / math.sqrt(M)
    for b in range(B):
        _directions(C[b], is_sine, u)
        for m in range(M):
            w = Q[m, 0] ** 2 + Q[m, 1] ** 2 + Q[m, 2] ** 2
            f, f_s, f_k, f_ss, f_sk, f_kk = _advance(wavefront, _dot(Q, m, u[0, 0]), C[b, d - 1], w)
            values[m] = f
            for i in range(d - 1):
                s_i = _dot(Q, m, u[0, 1 + i])
                first[i] = f_s * s_i
                for j in range(d - 1):
                    second[i, j] = f_ss * s_i * _dot(Q, m, u[0, 1 + j]) + f_s * _dot(Q, m, u[1 + i, 1 + j])
                second[i, d - 1] = second[d - 1, i] = f_sk * s_i
            first[d - 1], second[d - 1, d - 1] = f_k, f_kk
            for i in range(d):
                total = 0.0
                for j in range(d):
                    total += S[b, j, i] * first[j]
                    half[i, j] = 0.0
                    for k in range(d):
                        half[i, j] += S[b, k, i] * second[k, j]
                g[b, i, m] = TURN * total
            for i in range(d):
                for j in range(d):
                    total = 0.0
                    for k in range(d):
                        total += half[i, k] * S[b, k, j]
                    h[b, i, j, m] = TURN * total
        mean = values.mean()
        for m in range(M):
            phase = TURN * (values[m] - mean)
            a[b, m] = scale * complex(math.cos(phase), math.sin(phase))
        for i in range(d):
            g[b, i] -= g[b, i].mean()
            for j in range(d):
                h[b, i, j] -= h[b, i, j].mean()
    return a, g, h


@compiled()
def third_bounds(
    wavefront: int,
    is_sine: bool,
    Q: Float[ndarray, "m 3"],
    slopes: Float[ndarray, "3 m"],
    series: Float[ndarray, "2 n"],
    C: Float[ndarray, "b d"],
    angle: Float[ndarray, " b"],
    kappa: Float[ndarray, "b 2"],
) -> Float[ndarray, "b 4 m"]:
    """Bounds of the third derivatives of ψ within ``angle`` and ``kappa`` of C, by how many are with respect to κ.

    kappa: the largest change of κ, and the largest |κ|.
    """
    B, d = C.shape
    bounds, u = np.empty((B, 4, len(Q))), np.empty((3, 3, 3))
    for b in range(B):
        _directions(C[b], is_sine, u)
        for m in range(len(Q)):
            w = Q[m, 0] ** 2 + Q[m, 1] ** 2 + Q[m, 2] ** 2
            one, two, three = slopes[0, m], slopes[1, m], slopes[2, m]
            f_s, f_ss, f_sk, f_sss, f_ssk, f_skk, f_kkk = _third(
                wavefront, _dot(Q, m, u[0, 0]), C[b, d - 1], w, one * angle[b], kappa[b, 0], kappa[b, 1], series
            )
            bounds[b, 0, m] = TURN * (f_sss * one**3 + 3.0 * f_ss * one * two + f_s * three)
            bounds[b, 1, m] = TURN * (f_ssk * one**2 + f_sk * two)
            bounds[b, 2, m] = TURN * f_skk * one
            bounds[b, 3, m] = TURN * f_kkk
    return bounds


@compiled()
def _third_along(third: Float[ndarray, "4 m"], x: float, y: float, cubic: Float[ndarray, " m"]) -> float:
    """The largest of a cubic form in steps x·cosα and y·sinα into ``cubic``, for each element; returns their mean.

    Between neighbouring samples of α both steps are at most their larger ends.
    """
    mean = 0.0
    for m in range(len(cubic)):
        cubic[m] = 0.0
        for i in range(SAMPLES):
            p = x * math.cos(0.5 * math.pi * i / SAMPLES)
            q = y * math.sin(0.5 * math.pi * (i + 1) / SAMPLES)
            value = ((third[0, m] * p + 3.0 * third[1, m] * q) * p + 3.0 * third[2, m] * q * q) * p + third[3, m] * q**3
            cubic[m] = max(cubic[m], value)
        mean += cubic[m] / len(cubic)
    return mean


@compiled()
def _largest_norms(g: Float[ndarray, "d m"], directions: Float[ndarray, "n d"]) -> tuple[float, float]:
    """The largest ‖g·δ‖₄ and ‖g·δ‖₆ of the directions δ, as means over the elements."""
    d, M = g.shape
    largest_four, largest_six = 0.0, 0.0
    for n in range(len(directions)):
        four, six = 0.0, 0.0
        for m in range(M):
            along = 0.0
            for i in range(d):
                along += directions[n, i] * g[i, m]
            along *= along
            four += along * along
            six += along * along * along
        largest_four, largest_six = max(largest_four, four / M), max(largest_six, six / M)
    return largest_four**0.25, largest_six ** (1.0 / 6.0)


@compiled()
def ball_sums(
    g: Float[ndarray, "b d m"],
    h: Float[ndarray, "b d d m"],
    third: Float[ndarray, "b 4 m"],
    x: Float[ndarray, " b"],
    y: Float[ndarray, " b"],
    rho: Float[ndarray, " b"],
    directions: Float[ndarray, "n d"],
) -> tuple[Float[ndarray, "b 7"], Float[ndarray, "b n n"]]:
    """What the bounds on balls of radius ρ need of the phases, as means over the elements.

    |ψ_ttt| is at most the largest of a cubic form in a step x·cosα of the angles and y·sinα of κ. Returns ‖e‖₂, ‖e‖₄
    and ‖e‖₆ of the change e of ψ' on the ball, ‖ψ_ttt‖₂, ‖p‖₄ of the bound p of ψ'', and the largest ‖g·δ‖₄ and ‖g·δ‖₆
    of the directions δ; then the moments of the entries of h, with the roots of their multiplicities.
    """
    B, d, M = g.shape
    pairs = d * (d + 1) // 2
    sums, of_h = np.zeros((B, 7)), np.zeros((B, pairs, pairs))
    cubic, square, norm, entries = np.empty(M), np.empty((d, d)), np.empty(M), np.empty(pairs)
    for b in range(B):
        mean = _third_along(third[b], x[b], y[b], cubic)
        for m in range(M):
            frobenius = 0.0  # ‖h‖ <= ‖h²‖_F^½
            for i in range(d):
                for j in range(d):
                    square[i, j] = 0.0
                    for k in range(d):
                        square[i, j] += h[b, i, k, m] * h[b, k, j, m]
                    frobenius += square[i, j] ** 2
            norm[m] = math.sqrt(math.sqrt(frobenius))
            e = rho[b] * norm[m] + 0.5 * rho[b] ** 2 * cubic[m]
            centred = e + 0.5 * rho[b] ** 2 * mean
            curved = norm[m] + rho[b] * (cubic[m] + mean)
            sums[b, 0] += e**2 / M
            sums[b, 1] += centred**4 / M
            sums[b, 2] += centred**6 / M
            sums[b, 3] += cubic[m] ** 2 / M
            sums[b, 4] += curved**4 / M
            n = 0
            for i in range(d):
                for j in range(i, d):
                    entries[n] = (1.0 if i == j else math.sqrt(2.0)) * h[b, i, j, m]
                    n += 1
            for i in range(pairs):
                for j in range(pairs):
                    of_h[b, i, j] += entries[i] * entries[j] / M
        sums[b, 5], sums[b, 6] = _largest_norms(g[b], directions)
        sums[b, 0], sums[b, 3] = math.sqrt(sums[b, 0]), math.sqrt(sums[b, 3])
        sums[b, 1], sums[b, 4] = sums[b, 1] ** 0.25, sums[b, 4] ** 0.25
        sums[b, 2] = sums[b, 2] ** (1.0 / 6.0)
    return sums, of_h


_1, _2, _3, _4 = (types.Array(types.float64, n, "C") for n in (1, 2, 3, 4))
_MODEL = (types.int64, types.boolean, types.Array(types.float64, 2, "C"))
_SIGNATURES: list[tuple[Any, tuple[Any, ...]]] = [
    (phase_jets, (*_MODEL, _2, _3)),
    (third_bounds, (*_MODEL, _2, _2, _2, _1, _2)),
    (ball_sums, (_3, _4, _3, _1, _1, _1, _2)),
]


@cache
def warm_up() -> None:
    """Load the kernels from the cache, or compile them and say so on stderr."""
    load_kernels(_SIGNATURES, "compiling the derivatives of phases (once per machine, some 10 s)")
