"""Scenes of a uniform linear array, with and without noise, for the tests of methods that need such an array."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import oracles
from numpy import ndarray

from nfbench import Formulation, Solution
from nfbench.core.options import build
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField

PAPER = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "fresnel",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
THREE = {"positions": [[-35, 3.0], [10, 2.0], [30, 4.0]]}


def scene(seed: int = 0, array: dict | None = None, **changes) -> NearFieldInstance:
    manifest = PAPER | {"array": PAPER["array"] | (array or {})} | changes
    return build(NearField, manifest).draw(np.random.default_rng(seed))


def noise_free(seed: int = 0, array: dict | None = None, **changes) -> NearFieldInstance:
    """Return a scene without noise whose symbols are orthogonal, so that the covariance is A·Aᴴ."""
    instance = scene(seed, array, **changes)
    K, T = instance.sources, instance.Y.shape[1]
    S = np.exp(2j * np.pi * np.outer(np.arange(K), np.arange(T)) / T)
    A = np.array([oracles.response(instance.manifold, theta) for theta in instance.theta]).T
    return replace(instance, Y=A @ S)


def solve(formulation: Formulation, instance: NearFieldInstance) -> ndarray:
    """Return the estimate of a formulation that needs no solver, in the order of the azimuths."""

    def never(problem):
        raise AssertionError("a formulation with needs_solver = False called minimize")

    found = formulation.solve(instance, never)
    estimate = found.estimate if isinstance(found, Solution) else found
    return estimate[np.argsort(estimate[:, 0])]


def in_order(theta: ndarray) -> ndarray:
    """Return sources in the order of their azimuths."""
    return theta[np.argsort(theta[:, 0])]


def signal_subspace(Y: ndarray, sources: int) -> ndarray:
    """Return the eigenvectors of Y·Yᴴ/T with the largest eigenvalues, from a full eigenvalue decomposition."""
    return np.linalg.eigh(Y @ Y.conj().T / Y.shape[1])[1][:, ::-1][:, :sources]
