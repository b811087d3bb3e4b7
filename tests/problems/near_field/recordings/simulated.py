"""A small simulated measurement, written to files as a user would have it."""

import numpy as np

from nfbench.problems.near_field.arrays import Custom
from nfbench.problems.near_field.wavefronts import Manifold

SPEED, FREQUENCY = 340.0, 1700.0  # λ = 0.2 m
WAVELENGTH = SPEED / FREQUENCY
GRID = 0.1 * (np.arange(4) - 1.5)
POSITIONS = np.array([[x, y, 0.5] for y in GRID for x in GRID])  # a plane, whose broadside is +z
ARRAY = Custom(origin="center", positions=tuple(map(tuple, POSITIONS.tolist())), broadside="+z", up="+y")
TRUTH = np.array([[0.1, 0.2, 1.0], [-0.25, -0.05, 0.95]])
BOX = {"azimuth_deg": (-50.0, 50.0), "elevation_deg": (-50.0, 50.0), "range_m": (0.3, 2.0)}
OPTIONS = {"array": ARRAY, "frequency_hz": FREQUENCY, "speed_m_s": SPEED, "sources": 2, **BOX}


def responses(points=TRUTH):
    """exp(−jk·distance), straight from the coordinates, shape (M, K)."""
    distances = np.linalg.norm(POSITIONS[:, None] - points, axis=2)
    return np.exp(-2j * np.pi / WAVELENGTH * distances)


def snapshots(count=60, noise=0.001, seed=0):
    """Snapshots (M, T) of both sources."""
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    return responses() @ normal(2, count) + noise * normal(len(POSITIONS), count)


def manifold():
    return Manifold(ARRAY.place(WAVELENGTH), WAVELENGTH, "exact", True)
