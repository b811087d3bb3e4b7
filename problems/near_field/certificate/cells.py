"""T2: how far the response turns on a path inside a box, from the metric at the centre of the cell that holds the box.

The response moves on the unit sphere at the speed std_m(ψ'_m) (in the centred gauge âᴴâ' = 0), so the angle between two
responses is at most the integral of std(ψ') along any path between them. With F = (1/M)Σ_m ∇ψ∇ψᵀ at the centre of a
cell, and R_i a bound of how much std(ψ_i) changes inside the cell, a straight path from the centre of a box of
half-widths h to one of its points is at most β = √(Σ_ij |F_ij| h_i h_j) + Σ_i R_i h_i long.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Incompatible

from ..wavefronts import Manifold, Wavefront
from .chart import Chart, chart_of

__all__ = ["Cells", "cells_of", "change", "metric", "unsheared"]

LENGTH = 0.45  # largest √F_ii·h_i of a cell [rad]
MOST = 200_000  # cells
BLOCK = 512  # cells whose derivatives are held at once


@dataclass(frozen=True, eq=False)
class Cells:
    """A partition of the box of one source into n boxes, in coordinates (u − shear·κ, κ), or (φ, ψ, κ).

    centres, halves: (n, d). F: (n, d, d) and R: (n, d), the metric and its change, both in these coordinates.
    """

    chart: Chart
    centres: Float[ndarray, "n d"]
    halves: Float[ndarray, "n d"]
    F: Float[ndarray, "n d d"]
    R: Float[ndarray, "n d"]
    families: list[Any] | None = None  # what ``one_source`` derives from the cells once


def cells_of(manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> Cells:
    """Return the cells of a box [rad, m]; they are kept for the arrays and boxes used last.

    Raises Incompatible where no certificate is known for the wavefront or the ranges, or the box has too many cells.
    """
    array = manifold.positions.tobytes(), manifold.wavelength_m, manifold.wavefront, manifold.has_elevation
    return _cached_cells(*array, lower.tobytes(), upper.tobytes())


@lru_cache(maxsize=8)
def _cached_cells(
    positions: bytes, wavelength_m: float, wavefront: Wavefront, has_elevation: bool, lower: bytes, upper: bytes
) -> Cells:
    Q = np.frombuffer(positions).reshape(-1, 3)
    manifold = Manifold(Q, wavelength_m, wavefront, has_elevation)
    return _partition(chart_of(manifold, np.frombuffer(lower), np.frombuffer(upper)))


def _partition(chart: Chart) -> Cells:
    """Divide the box, and its parts again, until the metric at the centre of each says that it is small enough."""
    low, high = chart.lower.copy(), chart.upper.copy()
    ends = chart.shear * np.array([low[-1], high[-1]])
    low[0], high[0] = low[0] - ends.max(), high[0] - ends.min()
    waiting = [((low + high) / 2, (high - low) / 2)]
    done: list[tuple[ndarray, ndarray, ndarray]] = []
    while waiting:
        if len(waiting) + len(done) > MOST:
            raise Incompatible(f"certificate: expected an array and a box with at most {MOST:,} cells, got more")
        centres, halves = (np.array(side) for side in zip(*waiting, strict=True))
        waiting = []
        for first in range(0, len(centres), BLOCK):
            C, H = centres[first : first + BLOCK], halves[first : first + BLOCK]
            F = metric(chart, C, chart.shear)
            divided = np.ceil(np.sqrt(np.einsum("bii->bi", F)) * H / LENGTH).astype(int).clip(1)
            for c, h, counts, f in zip(C, H, divided, F, strict=True):
                if (counts == 1).all():
                    done.append((c, h, f))
                    continue
                grids = [c_i + h_i * ((2 * np.arange(n) + 1) / n - 1) for c_i, h_i, n in zip(c, h, counts, strict=True)]
                for part in np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, len(c)):
                    reach = h[0] / counts[0] + abs(chart.shear) * h[-1] / counts[-1]
                    at = part[0] + chart.shear * part[-1]
                    if at + reach >= chart.lower[0] and at - reach <= chart.upper[0]:
                        waiting.append((part, h / counts))
    centres, halves, F = (np.array(side) for side in zip(*done, strict=True))
    R = np.concatenate(
        [change(chart, centres[i : i + BLOCK], halves[i : i + BLOCK], chart.shear) for i in range(0, len(F), BLOCK)]
    )
    return Cells(chart, centres, halves, F, R)


def metric(chart: Chart, C: Float[ndarray, "b d"], shear: float) -> Float[ndarray, "b d d"]:
    """Return F at points C with coordinates (u − shear·κ, κ)."""
    first = chart.jets(unsheared(chart, C, shear))[1]
    first[:, -1] += shear * first[:, 0]
    F: ndarray = first @ first.swapaxes(1, 2) / first.shape[-1]
    return F


def unsheared(chart: Chart, C: Float[ndarray, "b d"], shear: float | None = None) -> Float[ndarray, "b d"]:
    """Return the coordinates (u, κ) of points (u − shear·κ, κ); by default with the shear of the chart."""
    plain = C.copy()
    plain[:, 0] += (chart.shear if shear is None else shear) * C[:, -1]
    return plain


def change(chart: Chart, C: Float[ndarray, "b d"], H: Float[ndarray, "b d"], shear: float) -> Float[ndarray, "b d"]:
    """Return R_i = Σ_j std(ψ_ij)H_j + ½Σ_jl rms(B_ijl)H_jH_l; it is 0 where the phase is linear, as if sheared."""
    if shear:
        return np.zeros_like(C)
    second = chart.jets(C)[2]
    angles, kappa = np.linalg.norm(H[:, :-1], axis=1), H[:, -1]
    bounds = np.sqrt(np.mean(chart.third(C, angles, kappa) ** 2, axis=-1)).T
    by_angle = bounds[0] * angles**2 + 2 * bounds[1] * angles * kappa + bounds[2] * kappa**2
    by_kappa = bounds[1] * angles**2 + 2 * bounds[2] * angles * kappa + bounds[3] * kappa**2
    change = np.einsum("bij,bj->bi", np.sqrt(np.mean(second**2, axis=-1)), H)
    change[:, :-1] += by_angle[:, None] / 2
    change[:, -1] += by_kappa / 2
    return change
