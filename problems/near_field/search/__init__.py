"""The fast search for all sources of a scene at once, and the standard errors of what it finds."""

from __future__ import annotations

from .bands import BandFit, covariance_of_bands, search_bands_greedily, search_bands_locally
from .error_bars import covariance, error_columns, standard_errors
from .greedy import search_greedily
from .grid import ResponseGrid, grid_size, resolution_grid, response_grid
from .kernels import warm_up
from .local_search import LocalMinimum, resolution, search_locally, unit_of
from .polar import polar_grid, polar_grid_size

__all__ = [
    "BandFit",
    "LocalMinimum",
    "ResponseGrid",
    "covariance",
    "covariance_of_bands",
    "error_columns",
    "grid_size",
    "polar_grid",
    "polar_grid_size",
    "resolution",
    "resolution_grid",
    "response_grid",
    "search_bands_greedily",
    "search_bands_locally",
    "search_greedily",
    "search_locally",
    "standard_errors",
    "unit_of",
    "warm_up",
]
