"""The scenes on which the network is trained: the paper's array, box and wavefront in line of sight."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..channels import complex_normal
from ..placement import place_sources
from ..scenario import NearField
from ..subspace import signal_subspace

__all__ = ["NEAR_M", "SETTING", "SNR_DB", "draw_scenes", "training_scenario"]

SETTING: dict[str, Any] = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
    "min_separation_deg": 2.0,
}
"""The keys of ``[scenario]`` of the training scenes, apart from the SNR."""

SNR_DB = 0.0, 30.0  # uniform, the same for all sources of a scene
NEAR_M = 4.0  # largest range [m] in every second scene: few of the ranges that are uniform in the box are small


@cache
def training_scenario() -> NearField:
    """Return the scenario of the training scenes."""
    return NearField(**SETTING)


def draw_scenes(seed: int, count: int) -> tuple[Complex[ndarray, "n m k"], Float[ndarray, "n k 2"]]:
    """Return the signal subspaces and the sources [rad, m] of the training scenes 0 … count − 1.

    Y = A·√snr·S + N as in the scenario, but with one generator for a whole scene, which is four times as fast. The
    first scenes do not depend on how many there are.
    """
    scenario = training_scenario()
    manifold, (lower, upper) = scenario.manifold(), scenario.box()
    K, M, T = scenario.sources, manifold.elements, scenario.snapshots
    separation = math.radians(scenario.min_separation_deg)
    subspaces, sources = np.empty((count, M, K), dtype=np.complex128), np.empty((count, K, 2))
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        snr = 10 ** (rng.uniform(*SNR_DB) / 10)
        highest = np.array([upper[0], NEAR_M if number % 2 else upper[1]])
        theta = place_sources(rng, lower, highest, K, separation)
        S = math.sqrt(snr) * complex_normal(rng, (K, T))
        Y = manifold.response(theta).T @ S + complex_normal(rng, (M, T))
        subspaces[number], sources[number] = signal_subspace(Y, K), theta
    return subspaces, sources
