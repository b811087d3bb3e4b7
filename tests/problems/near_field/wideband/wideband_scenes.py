"""Scenes of several frequency bins, and the plain formulas with which they are compared."""

from __future__ import annotations

import numpy as np

from nfbench.core.options import build
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField

WIDEBAND = {
    "array": {"kind": "ula", "elements": 24, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 60,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.3, 1.2],
    "min_separation_deg": 12.0,
    "bins": 3,
    "bandwidth_relative": 0.3,
}
SPACE = WIDEBAND | {
    "array": {"kind": "upa", "columns": 8, "rows": 8, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-30, 30],
    "range_m": [0.2, 0.8],
    "bins": 2,
}
SPARSE = WIDEBAND | {
    "array": {"kind": "ula", "elements": 16, "spacing_wavelengths": 2.0, "origin": "center"},
    "snr_db": 10.0,
    "range_m": [1.0, 8.0],
    "min_separation_deg": 3.0,
    "bins": 5,
}


def scene(seed: int = 0, manifest: dict = WIDEBAND, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def response(positions: np.ndarray, wavelength: float, theta: np.ndarray) -> np.ndarray:
    """Return A (M, K) of exact spherical waves from sources [azimuth, range]."""
    azimuth, r = np.asarray(theta).reshape(-1, 2).T
    points = r[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(r)], axis=1)
    d = np.linalg.norm(points[None] - positions[:, None], axis=-1)
    return np.exp(2j * np.pi / wavelength * (r - d))


def misfit(F: np.ndarray, A: np.ndarray) -> float:
    """Return ‖(I − P_A)F‖²."""
    return float(np.linalg.norm(F - A @ np.linalg.lstsq(A, F)[0]) ** 2)


def slopes(function, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Return the central differences of a function, the index of x last."""
    columns = [(function(x + h) - function(x - h)) / (2 * step) for h in step * np.eye(len(x))]
    return np.stack(columns, axis=-1)


def assert_same_covariance(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Compare covariances in units of the expected standard deviations."""
    deviations = np.sqrt(np.diag(expected))
    scale = np.outer(deviations, deviations)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=tolerance)
