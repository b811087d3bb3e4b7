"""Scenes and arrays for the tests of the search."""

from __future__ import annotations

import numpy as np

from nfbench.core.options import build
from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
PLANE = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": WAVELENGTH,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
SPACE = PLANE | {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavefront": "exact",
    "snapshots": 100,
    "elevation_deg": [-30, 30],
    "range_m": [0.452, 2.56],
}
BOX = {2: (np.array([-1.0, 0.5]), np.array([1.0, 8.0])), 3: (np.array([-1.0, -0.5, 0.2]), np.array([1.0, 0.5, 2.0]))}


def scene(seed: int = 0, manifest: dict = PLANE, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def manifold(dimension: int, wavefront: str) -> Manifold:
    if dimension == 2:
        array = ULA(elements=33, spacing_wavelengths=0.5, origin="first")
    else:
        array = UPA(columns=6, rows=5, spacing_wavelengths=0.5, origin="center")
    return Manifold(array.place(WAVELENGTH), WAVELENGTH, wavefront, dimension == 3)
