"""Scenes and helpers for the tests of the estimators on the polar grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import oracles
from numpy import ndarray

from nfbench.core.options import build
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField

LINE = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
SMALL = LINE | {
    "array": {"kind": "ula", "elements": 32, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavefront": "exact",
    "snapshots": 10,
    "range_m": [0.4, 5.0],
}
SPACE = SMALL | {
    "array": {"kind": "upa", "columns": 6, "rows": 6, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-40, 40],
    "range_m": [0.1, 0.8],
}


def scene(seed: int = 0, manifest: dict = SMALL, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def responses(instance: NearFieldInstance, theta: ndarray) -> ndarray:
    """Return the responses of sources, one per column, by the printed formulas."""
    return np.array([oracles.response(instance.manifold, each) for each in theta]).T


_known: dict[tuple[bytes, ...], ndarray] = {}


def dictionary(instance: NearFieldInstance, grid: ndarray) -> ndarray:
    """Return the responses of a grid, and remember them."""
    key = instance.manifold.positions.tobytes(), instance.manifold.wavefront.encode(), grid.tobytes()
    if key not in _known:
        _known[key] = responses(instance, grid)
    return _known[key]


def noise_free(instance: NearFieldInstance) -> NearFieldInstance:
    """Return the scene without noise, with symbols of the same power that are orthogonal."""
    K, T = instance.sources, instance.Y.shape[1]
    S = np.exp(2j * np.pi * np.outer(np.arange(K), np.arange(T)) / T)
    return replace(instance, Y=responses(instance, instance.theta) @ S)


def solve(formulation, instance: NearFieldInstance) -> ndarray:
    def never(problem):
        raise AssertionError("a formulation with needs_solver = False called minimize")

    found = formulation.solve(instance, never)
    return getattr(found, "estimate", found)


def in_order(theta: ndarray) -> ndarray:
    """Return sources in the order of their azimuths."""
    return theta[np.argsort(theta[:, 0])]


HOSTILE = {  # manifests of scenes that an estimator must survive
    "one snapshot": SMALL | {"snapshots": 1},
    "K = M − 1": SMALL | {"array": SMALL["array"] | {"elements": 8}, "sources": 7, "snapshots": 20},
    "coincident": SMALL | {"sources": 2, "positions": [[10, 1.0], [10, 1.0]]},
    "endfire": SMALL | {"azimuth_deg": [-90, 90], "sources": 2, "positions": [[90, 1.0], [-90, 2.0]]},
    "weak": SMALL | {"snr_db": -60.0},
    "at an edge": SMALL | {"sources": 2, "positions": [[60, 0.4], [-60, 5.0]]},
    "planar": SMALL | {"wavefront": "planar"},
    "on an element": SMALL
    | {"range_m": [0.05, 2.0], "azimuth_deg": [-90, 90], "sources": 1, "positions": [[90, 0.155]]},
}


def coherent(instance: NearFieldInstance) -> NearFieldInstance:
    """Return the scene with sources that send the same symbols."""
    rng = np.random.default_rng(0)
    symbols = np.outer(np.arange(1, instance.sources + 1) * 10j, rng.normal(size=instance.Y.shape[1]))
    noise = rng.normal(size=instance.Y.shape) + 1j * rng.normal(size=instance.Y.shape)
    return replace(instance, Y=responses(instance, instance.theta) @ symbols + noise)
