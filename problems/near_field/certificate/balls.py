"""Bounds of the derivatives of a response on a ball around a source, in coordinates t in which its metric is nearly 1.

θ = c + S·t with SᵀFS = 1, F the metric at c; where the response hardly depends on a direction, a unit step in t is
limited to REACH widths of the box. All derivatives are along straight lines of unit speed in t, in the centred gauge:

    â' = jψ'â,    â'' = (jψ'' − ψ'²)â,    â''' = (jψ''' − 3ψ'ψ'' − jψ'³)â
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from . import phases
from .chart import Chart

__all__ = ["BallBounds", "Charted", "ball_bounds", "charted", "cover", "matrix_monomials", "over_cover", "whitening"]

DIRECTIONS = 12  # of a plane in which norms are sampled; of space about as finely
REACH = 7.0  # largest unit step in t, in widths of the box


@dataclass(frozen=True, eq=False)
class Charted:
    """Sources at centres C with their whitened coordinates, and the derivatives of their responses at t = 0.

    S: (b, d, d). a: (b, M) of unit norm. g: (b, d, M) and h: (b, d, d, M), the derivatives of the phases by t.
    """

    chart: Chart
    C: Float[ndarray, "b d"]
    S: Float[ndarray, "b d d"]
    a: Complex[ndarray, "b m"]
    g: Float[ndarray, "b d m"]
    h: Float[ndarray, "b d d m"]

    @cached_property
    def first(self) -> Complex[ndarray, "b d m"]:
        """∂_i â = jψ_i â."""
        derivative: ndarray = 1j * self.g * self.a[:, None]
        return derivative

    @cached_property
    def second(self) -> Complex[ndarray, "b d d m"]:
        """∂_ij â = (jψ_ij − ψ_i ψ_j)â."""
        derivative: ndarray = (1j * self.h - self.g[:, :, None] * self.g[:, None]) * self.a[:, None, None]
        return derivative

    @cached_property
    def inverse(self) -> Float[ndarray, "b d d"]:
        """S⁻¹, from the coordinates to t."""
        inverse: ndarray = np.linalg.inv(self.S)
        return inverse

    @cached_property
    def steps(self) -> tuple[Float[ndarray, " b"], Float[ndarray, " b"], Float[ndarray, " b"]]:
        """x and y, how much a unit step in t changes the angles and κ at most; and c: cx·cosα, cy·sinα bound them."""
        angles = np.linalg.svd(self.S[:, :-1], compute_uv=False)[:, 0]
        kappa = np.linalg.norm(self.S[:, -1], axis=1)
        both = np.concatenate([self.S[:, :-1] / angles[:, None, None], self.S[:, -1:] / kappa[:, None, None]], axis=1)
        return angles, kappa, np.linalg.svd(both, compute_uv=False)[:, 0]


class BallBounds(NamedTuple):
    """Bounds on a ball of radius ρ, for all directions of unit speed, (b,) each.

    n1, n2, n3: of ‖â'‖, ‖â''‖, ‖â'''‖. v: lower bound of ‖â'‖. m2: of the root mean square of ψ''. u1: of ‖Uᴴâ'‖.
    """

    n1: Float[ndarray, " b"]
    v: Float[ndarray, " b"]
    m2: Float[ndarray, " b"]
    n2: Float[ndarray, " b"]
    n3: Float[ndarray, " b"]
    u1: Float[ndarray, " b"]


def whitening(chart: Chart, C: Float[ndarray, "b d"]) -> Float[ndarray, "b d d"]:
    """Return S with SᵀFS = 1 at centres C, where a unit step does not exceed REACH widths of the box."""
    scaled = chart.jets(C)[1] * chart.width[:, None]
    values, V = np.linalg.eigh(scaled @ scaled.swapaxes(1, 2) / scaled.shape[-1])
    steps = 1 / np.sqrt(np.maximum(values, REACH**-2))
    S: ndarray = chart.width[:, None] * V * steps[:, None]
    return S


def charted(chart: Chart, C: Float[ndarray, "b d"], S: Float[ndarray, "b d d"] | None = None) -> Charted:
    """Return sources at centres C, in the whitened coordinates of their own metric unless S is given."""
    S = whitening(chart, C) if S is None else S
    return Charted(chart, C, S, *chart.jets(C, S))


def ball_bounds(sources: Charted, rho: Float[ndarray, " b"], U: Complex[ndarray, "m k"]) -> BallBounds:
    """Return the bounds on balls of radius ρ around the centres."""
    g, (angles, kappa, stretch) = sources.g, sources.steps
    third = sources.chart.third(sources.C, rho * angles, rho * kappa)
    directions, excess = _directions(g.shape[1])
    sums, of_h = phases.ball_sums(g, sources.h, third, stretch * angles, stretch * kappa, rho, directions)
    e2, e4, e6, cubic, p2, g4, g6 = sums.T
    F = np.linalg.eigvalsh(g @ g.swapaxes(1, 2) / g.shape[-1])
    n1 = np.sqrt(F[:, -1]) + e2
    v = np.sqrt(np.maximum(F[:, 0], 0.0)) - e2
    m2 = np.sqrt(_largest(of_h)) + rho * cubic
    l4, l6 = excess * g4 + e4, excess * g6 + e6
    n2 = np.sqrt(l4**4 + m2**2)
    n3 = np.sqrt((l6**3 + cubic) ** 2 + 9 * l4**2 * p2**2)
    along = sources.first @ U.conj()  # (b, d, K)
    gram = (along @ along.conj().swapaxes(1, 2)).real
    curved = np.linalg.norm((sources.second @ U.conj()).reshape(len(rho), -1), axis=1)
    u1 = np.sqrt(_largest(gram)) + rho * curved + rho**2 / 2 * n3
    return BallBounds(n1, v, m2, n2, n3, u1)


def cover(sources: Charted, rho: Float[ndarray, " k"], parts: int) -> tuple[Charted, Float[ndarray, " b"], list[int]]:
    """Return smaller balls that together hold each ball as far as it lies in Θ, their radii, and the first of each.

    They surround the cubes of a grid with ``parts`` cubes along each axis of t. A ball whose centre is where the bounds
    of the phases do not hold is moved, and larger by as much.
    """
    chart, d = sources.chart, sources.C.shape[1]
    if parts == 1:
        return sources, rho, list(range(len(rho)))
    axis = (2 * np.arange(parts) + 1) / parts - 1
    cubes = np.stack(np.meshgrid(*[axis] * d, indexing="ij"), axis=-1).reshape(-1, d)
    nearest = np.maximum(np.abs(cubes) - 1 / parts, 0.0)
    cubes = cubes[np.sum(nearest**2, axis=1) < 1]
    centres: list[ndarray] = []
    matrices, radii, first = [], [], []
    for c, S, inverse, r in zip(sources.C, sources.S, sources.inverse, rho, strict=True):
        moved = c + (r * cubes) @ S.T
        reach = np.abs(S).sum(axis=1) * r / parts
        mine = moved[((moved + reach >= chart.lower) & (moved - reach <= chart.upper)).all(axis=1)]
        placed = chart.analytic(mine)
        first.append(sum(len(part) for part in centres))
        centres.append(placed)
        matrices.append(np.tile(S, (len(mine), 1, 1)))
        radii.append(r / parts * np.sqrt(d) + np.linalg.norm((placed - mine) @ inverse.T, axis=1))
    return charted(chart, np.concatenate(centres), np.concatenate(matrices)), np.concatenate(radii), first


def over_cover(bounds: BallBounds, first: list[int]) -> BallBounds:
    """Return the bounds on balls from those on the balls that cover them."""
    largest = [np.maximum.reduceat(bound, first) for bound in bounds]
    return BallBounds(*largest)._replace(v=np.minimum.reduceat(bounds.v, first))


@cache
def _directions(d: int) -> tuple[Float[ndarray, "n d"], float]:
    """Return unit vectors δ_i and a factor c: no norm is larger at a unit vector than c times its largest at the δ_i.

    In the plane a unit vector between two that are Δ apart is aδ_1 + bδ_2 with a + b <= 1/cos(Δ/2). In space they point
    to a grid of spacing s on the faces of the cube [−1, 1]³. A point p of a face is a convex combination of the
    corners v_i of its square, so N(p) <= max N(δ_i)·Σλ_i‖v_i‖; interpolation of ‖v‖, whose second derivatives are at
    most 1, is too high by s²/8 for each of the two axes at most, and ‖p‖ >= 1.
    """
    if d == 2:
        angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        return np.column_stack([np.cos(angle), np.sin(angle)]), float(1 / np.cos(np.pi / DIRECTIONS / 2))
    axis = np.linspace(-1, 1, 2 * DIRECTIONS // 4 + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    faces = [np.roll(np.column_stack([np.ones(len(x)), x, y]), turn, axis=1) for turn in range(3)]
    points = np.unique(np.concatenate(faces), axis=0)
    return points / np.linalg.norm(points, axis=1, keepdims=True), float(1 + (axis[1] - axis[0]) ** 2 / 4)


def matrix_monomials(h: ndarray) -> ndarray:
    """The entries (b, n, m) of symmetric matrices (b, d, d, m), with a norm equal to Frobenius'."""
    d = h.shape[1]
    return np.stack([h[:, i, j] * (1.0 if i == j else np.sqrt(2)) for i in range(d) for j in range(i, d)], axis=1)


def _largest(moments: Float[ndarray, "b n n"]) -> Float[ndarray, " b"]:
    largest: ndarray = np.maximum(np.linalg.eigvalsh(moments)[:, -1], 0.0)
    return largest
