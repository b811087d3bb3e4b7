"""The boxes that pruning leaves, grouped into regions, and their extent in the whitened coordinates of a source."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import final

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from . import kernels
from .balls import Charted
from .cells import Cells, unsheared

__all__ = ["Leaves", "prune_box", "prune_leaves"]

MOST = 50_000  # leaves


@final
@dataclass(frozen=True, eq=False)
class Leaves:
    """Boxes that together hold every point with D <= f*; region: its number for each box.

    centres and halves in the coordinates of the cells, cell: the cell that holds each box. D: at its centre. beta: its
    length. evaluations: of D, to find them.
    """

    cells: Cells
    centres: Float[ndarray, "n d"]
    halves: Float[ndarray, "n d"]
    cell: Int[ndarray, " n"]
    region: Int[ndarray, " n"]
    D: Float[ndarray, " n"]
    beta: Float[ndarray, " n"]
    evaluations: int

    @property
    def regions(self) -> int:
        return int(self.region.max()) + 1 if len(self.region) else 0

    def lower_bounds(self) -> Float[ndarray, " n"]:
        """Return a lower bound of D on each box: ∠(â, U) changes by no more than β."""
        angle = np.arcsin(np.sqrt(np.clip(self.D - kernels.ROUNDING, 0.0, 1.0))) - self.beta
        bound: ndarray = np.sin(np.maximum(angle, 0.0)) ** 2
        return bound

    def region_of(self, C: Float[ndarray, "k d"]) -> Int[ndarray, " k"]:
        """Return the region that holds each point, −1 where there is none."""
        plain = C.copy()
        plain[:, 0] -= self.cells.chart.shear * C[:, -1]
        slack = 1e-9 * self.cells.chart.width
        inside = (np.abs(plain[:, None] - self.centres) <= self.halves + slack).all(axis=2)
        return np.where(inside.any(axis=1), self.region[np.argmax(inside, axis=1)], -1)

    def distances(self, sources: Charted) -> list[Float[ndarray, " n"]]:
        """Return, for the source of each region, the largest distance ‖t‖ from it to a point of each of its boxes."""
        signs = np.array(list(product((-1.0, 1.0), repeat=sources.C.shape[1])))
        corners = self.centres[:, None] + signs * (self.halves[:, None] * kernels.WIDER)
        corners[..., 0] += self.cells.chart.shear * corners[..., -1]
        t = (corners - sources.C[self.region][:, None]) @ sources.inverse[self.region].swapaxes(1, 2)
        longest = np.sqrt(np.sum(t * t, axis=-1).max(axis=1))
        return [longest[self.region == k] for k in range(self.regions)]

    def centre(self, region: int) -> Float[ndarray, " d"]:
        """Return the middle of the box around a region, inside Θ."""
        mine = self.region == region
        low = (self.centres[mine] - self.halves[mine]).min(axis=0)
        high = (self.centres[mine] + self.halves[mine]).max(axis=0)
        chart = self.cells.chart
        return np.clip(unsheared(chart, (low + high)[None] / 2)[0], chart.lower, chart.upper)

    def connected(self) -> Leaves:
        """Return the same boxes with their connected components as regions."""
        boxes = np.ascontiguousarray(self.centres), np.ascontiguousarray(self.halves)
        return replace(self, region=kernels.components(*boxes))

    def only(self, kept: ndarray) -> Leaves:
        """Return the regions in ``kept``, numbered in this order."""
        number = np.full(self.regions, -1)
        number[kept] = np.arange(len(kept))
        mine = np.flatnonzero(number[self.region] >= 0)
        arrays = {name: getattr(self, name)[mine] for name in ("centres", "halves", "cell", "D", "beta")}
        return replace(self, **arrays, region=number[self.region[mine]])


def prune_box(cells: Cells, rows: ndarray, f: float, share: float) -> Leaves | None:
    """Return what T3 leaves of Θ at the threshold f*, in connected regions; None if that is too much."""
    n = len(cells.centres)
    found = _prune(cells, rows, (cells.centres, cells.halves, np.arange(n)), np.full(n, f), share)
    if found is None:
        return None
    centres, halves, cell, values, _, evaluations = found
    region = np.zeros(len(centres), np.int64)
    return Leaves(cells, centres, halves, cell, region, values[:, 0], values[:, 1], evaluations).connected()


def prune_leaves(leaves: Leaves, rows: ndarray, thresholds: Float[ndarray, " regions"], share: float) -> Leaves | None:
    """Return what T3 leaves of regions with a threshold each; their numbers stay, also where one falls into parts."""
    start = leaves.centres, leaves.halves, leaves.cell
    found = _prune(leaves.cells, rows, start, thresholds[leaves.region], share)
    if found is None:
        return None
    centres, halves, cell, values, origin, evaluations = found
    region, total = leaves.region[origin], leaves.evaluations + evaluations
    return Leaves(leaves.cells, centres, halves, cell, region, values[:, 0], values[:, 1], total)


def _prune(
    cells: Cells, rows: ndarray, start: tuple[ndarray, ndarray, ndarray], thresholds: ndarray, share: float
) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray, int] | None:
    chart = cells.chart
    box = np.array([chart.lower, chart.upper])
    model = (*chart.manifold.packed, rows, chart.is_sine, chart.shear, box)
    boxes = (np.ascontiguousarray(start[0]), np.ascontiguousarray(start[1]), np.ascontiguousarray(start[2]))
    found = kernels.prune(*model, boxes, (cells.F, cells.R), thresholds, share, MOST)
    return None if found[-1] < 0 else found
