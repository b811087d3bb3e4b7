"""The search for all sources at once: greedy on the grid, then local, then each source again given the others."""

from __future__ import annotations

from jaxtyping import Complex
from numpy import ndarray

from ..subspace import compress
from . import general, kernels
from .grid import ResponseGrid
from .local_search import LocalMinimum, search_locally

__all__ = ["search_greedily"]

SAME_LOBE = 0.3
"""The squared correlation |a_pᴴa_k|²/M² from which a grid point lies in the lobe of the source that it would replace.

A local search from there ends where the source is."""

STARTS = 3
"""First points of the greedy choice where responses have another modulus than 1.

Prewhitening and coupling can make the response of a place between two sources the one that explains most."""


def search_greedily(F: Complex[ndarray, "m c"], grid: ResponseGrid, sources: int, sweeps: int) -> LocalMinimum:
    """Return a minimizer of J = ‖(I − P_A)F‖² within the box of the grid.

    Sources are chosen one by one from the grid, each where it lowers J most given those chosen before (orthogonal least
    squares; Chen, Billings & Luo 1989), and refined together by ``search_locally``. Then each source in turn is
    chosen again given the others, as in alternating projection (Ziskind & Wax 1988), and all are refined again if the
    best point is not in the lobe of the source itself. This ends after a sweep without improvement.

    F: factor to fit, shape (M, c); finite.
    grid: array, box and candidates.
    sources: number K of sources.
    sweeps: maximum number of sweeps, in each of which every source is chosen again once.
    """
    if not grid.manifold.has_unit_modulus:
        return _search_generally(F, grid, sources, sweeps)
    packed, box = grid.manifold.packed, (grid.manifold, grid.lower, grid.upper)
    start, b = kernels.choose_greedily(*packed, grid.points, grid.table, F, sources)
    best = search_locally(F, *box, start)
    d = grid.manifold.dimension
    for _ in range(sweeps):
        before, chosen = best, best
        points, alike = kernels.choose_replacements(*packed, grid.points, grid.table, F, b, best.x)
        for k in range(sources):
            if best is not chosen:
                points, alike = kernels.choose_replacements(*packed, grid.points, grid.table, F, b, best.x)
                chosen = best
            if alike[k] >= SAME_LOBE:
                continue
            x = best.x.copy()
            x[k * d : (k + 1) * d] = grid.points[points[k]]
            trial = search_locally(F, *box, x)
            if trial.value < best.value:
                best = trial
        if not best.value < before.value * (1 - 1e-9):
            break
    return best


def _search_generally(F: Complex[ndarray, "m c"], grid: ResponseGrid, sources: int, sweeps: int) -> LocalMinimum:
    """Do the same for responses of any modulus, from the best of some greedy choices."""
    F = compress(F) if F.shape[1] > F.shape[0] else F
    manifold, box, d = grid.manifold, (grid.manifold, grid.lower, grid.upper), grid.manifold.dimension
    choices = general.choose_greedily(grid.responses, F, sources, STARTS)
    best = min((search_locally(F, *box, grid.points[chosen].ravel()) for chosen in choices), key=lambda at: at.value)
    for _ in range(sweeps):
        before = best
        for k in range(sources):
            point, alike = general.choose_replacement(grid.responses, F, manifold.response(best.x.reshape(-1, d)), k)
            if alike >= SAME_LOBE:
                continue
            x = best.x.copy()
            x[k * d : (k + 1) * d] = grid.points[point]
            trial = search_locally(F, *box, x)
            if trial.value < best.value:
                best = trial
        if not best.value < before.value * (1 - 1e-9):
            break
    return best
