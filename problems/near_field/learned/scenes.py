"""The scenes on which each network is trained: an array of the paper with its box and wavefront, in line of sight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from ..channels import complex_normal
from ..placement import place_sources
from ..scenario import NearField
from ..subspace import signal_subspace

__all__ = ["SETTINGS", "SNR_DB", "Setting", "draw_scenes"]

SNR_DB = 0.0, 30.0  # uniform, the same for all sources of a scene


@final
@dataclass(frozen=True, eq=False)
class Setting:
    """The array, the box and the scenes for which a network is trained.

    name: short name of the array, as in the option ``--array`` of the training.
    array: its description in messages.
    file: name of the weights, without ending.
    keys: keys of ``[scenario]``; the SNR is drawn instead.
    near_m: largest range [m] in every second scene: few of the ranges that are uniform in the box are small.
    """

    name: str
    array: str
    file: str
    keys: Mapping[str, Any]
    near_m: float

    @property
    def scenario(self) -> NearField:
        """The scenario of the training scenes."""
        return _scenario(self)


@cache
def _scenario(setting: Setting) -> NearField:
    return NearField(**setting.keys)


_ULA = Setting(
    "ula",
    'the ULA of 128 elements at λ/4 with origin "center"',
    "ula_128_quarter",
    {
        "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
        "wavelength_m": 0.02,
        "wavefront": "paper",
        "sources": 3,
        "snapshots": 200,
        "snr_db": 20.0,
        "azimuth_deg": [-60, 60],
        "range_m": [1.27, 20.16],
        "min_separation_deg": 2.0,
    },
    near_m=4.0,
)
_UPA = Setting(
    "upa",
    'the UPA of 16 × 16 elements at λ/2 with origin "center"',
    "upa_16_half",
    {
        "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
        "wavelength_m": 0.02,
        "wavefront": "exact",
        "sources": 3,
        "snapshots": 100,
        "snr_db": 20.0,
        "azimuth_deg": [-60, 60],
        "elevation_deg": [-30, 30],
        "range_m": [0.452, 2.56],
        "min_separation_deg": 5.0,
    },
    near_m=1.0,
)

SETTINGS: dict[str, Setting] = {setting.name: setting for setting in (_ULA, _UPA)}
"""The setting of each network, by the short name of its array."""


def draw_scenes(setting: Setting, seed: int, count: int) -> tuple[Complex[ndarray, "n m k"], Float[ndarray, "n k d"]]:
    """Return the signal subspaces and the sources [rad, m] of the training scenes 0 … count − 1.

    Y = A·√snr·S + N as in the scenario, but with one generator for a whole scene, which is four times as fast. The
    first scenes do not depend on how many there are.
    """
    scenario = setting.scenario
    manifold, (lower, upper) = scenario.manifold(), scenario.box()
    K, M, T = scenario.sources, manifold.elements, scenario.snapshots
    separation = math.radians(scenario.min_separation_deg)
    subspaces = np.empty((count, M, K), dtype=np.complex128)
    sources = np.empty((count, K, len(lower)))
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        snr = 10 ** (rng.uniform(*SNR_DB) / 10)
        highest = np.array([*upper[:-1], setting.near_m if number % 2 else upper[-1]])
        theta = place_sources(rng, lower, highest, K, separation)
        S = math.sqrt(snr) * complex_normal(rng, (K, T))
        Y = manifold.response(theta).T @ S + complex_normal(rng, (M, T))
        subspaces[number], sources[number] = signal_subspace(Y, K), theta
    return subspaces, sources
