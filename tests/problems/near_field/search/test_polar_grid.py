"""The polar grid: its coherence, the rule of Cui & Dai for a line, and its limits."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench import Incompatible
from nfbench.core.options import build
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import polar_grid, polar_grid_size

LINE = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "fresnel",
    "sources": 1,
    "snapshots": 4,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.7, 40.0],
}
PLANE = LINE | {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-30, 30],
    "range_m": [0.4, 2.6],
}


def scene(manifest: dict, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(0))


def grid_of(instance: NearFieldInstance, coherence: float) -> np.ndarray:
    return polar_grid(instance.manifold, instance.lower, instance.upper, coherence)


def coherence_of(instance: NearFieldInstance, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    a, b = instance.manifold.response(first), instance.manifold.response(second)
    return np.abs(np.sum(a.conj() * b, axis=1)) / a.shape[1]


def test_a_line_has_the_ranges_and_the_angles_of_the_paper():
    """Z(1 − u²)/s with Z = D²/(2λβ²), here counted from the far end of the box, and uniform sines."""
    instance, coherence = scene(LINE, range_m=[0.7, 1e6]), 0.8
    grid = grid_of(instance, coherence)
    azimuth = np.unique(grid[:, 0])
    sines = np.sin(azimuth)
    assert_allclose(np.diff(sines), np.diff(sines).mean(), rtol=2e-2)
    D, wavelength = 128 * 0.005, 0.02
    beta = (-90 * math.log(coherence)) ** 0.25 / math.sqrt(math.pi)  # |G(β)| = coherence to second order
    for angle in azimuth[:: len(azimuth) // 7]:
        ranges = grid[grid[:, 0] == angle, 1]
        Z = D**2 / (2 * wavelength * beta**2) * (1 - math.sin(angle) ** 2)
        s = Z / ranges  # 0 at infinity, …
        assert_allclose(np.diff(s), np.diff(s).mean(), rtol=1e-6)
        rings = Z / 0.7
        assert math.ceil(rings) - 1 <= len(ranges) - 1 <= math.ceil(rings * 1.001)


@pytest.mark.parametrize("coherence", [0.7, 0.9, 0.97])
@pytest.mark.parametrize("manifest", [LINE, PLANE], ids=["line", "plane"])
def test_neighbours_are_about_as_coherent_as_asked(manifest, coherence):
    instance = scene(manifest)
    grid = grid_of(instance, coherence)
    same = (grid[1:, :-1] == grid[:-1, :-1]).all(axis=1)
    along_range = coherence_of(instance, grid[:-1][same], grid[1:][same])
    assert along_range.min() > coherence - 0.05 * (1 - coherence)  # never coarser
    if manifest is LINE:
        assert np.median(along_range) < coherence + 0.6 * (1 - coherence)  # three rings in some directions
    broadside = grid[np.argmin(np.abs(grid[:, :-1]).sum(axis=1))]
    for side in range(instance.manifold.dimension - 1):
        axis = np.unique(grid[:, side])
        next_to = broadside.copy()
        next_to[side] = axis[np.searchsorted(axis, broadside[side]) + 1]
        found = coherence_of(instance, broadside[None], next_to[None])[0]
        assert abs(found - coherence) < 0.3 * (1 - coherence)


def test_every_source_of_the_box_is_near_a_grid_point():
    """In the corner of a cell of the plane the coherence is that of half a step in both directions, √0.9."""
    instance = scene(LINE)
    grid = instance.manifold.response(grid_of(instance, 0.9))
    rng = np.random.default_rng(0)
    box = np.array([[*instance.lower[:-1], 1 / instance.upper[-1]], [*instance.upper[:-1], 1 / instance.lower[-1]]])
    theta = rng.uniform(*box, size=(300, 2))
    theta[:, -1] = 1 / theta[:, -1]
    best = np.abs(instance.manifold.response(theta).conj() @ grid.T).max(axis=1) / 128
    assert best.min() > math.sqrt(0.9) - 0.01


@pytest.mark.parametrize("manifest", [LINE, PLANE], ids=["line", "plane"])
def test_the_grid_fills_the_box_and_its_size_is_about_known_in_advance(manifest):
    instance = scene(manifest)
    grid = grid_of(instance, 0.8)
    assert (grid.min(axis=0) == instance.lower).all() and (grid.max(axis=0) == instance.upper).all()
    assert len(np.unique(grid, axis=0)) == len(grid)
    assert polar_grid_size(instance.manifold, instance.lower, instance.upper, 0.8) == pytest.approx(len(grid), rel=0.2)


def test_the_curvature_is_measured_from_the_centre_of_the_array():
    first, center = (scene(LINE, array=LINE["array"] | {"origin": origin}) for origin in ("first", "center"))
    assert len(grid_of(first, 0.8)) == len(grid_of(center, 0.8))


def test_the_rings_depend_on_the_wavefront():
    """The curvature of the paper's wavefront is the same in all directions; a planar wavefront has none."""
    counts = {}
    for wavefront in ("fresnel", "exact", "paper", "planar"):
        grid = grid_of(scene(LINE, wavefront=wavefront), 0.8)
        counts[wavefront] = [int(np.sum(grid[:, 0] == angle)) for angle in np.unique(grid[:, 0])]
    assert counts["fresnel"] == counts["exact"]
    assert set(counts["planar"]) == {2} and len(set(counts["paper"])) == 1
    assert max(counts["fresnel"]) <= counts["paper"][0] and min(counts["fresnel"]) <= counts["paper"][0] / 3


def test_a_grid_that_does_not_fit_in_memory_is_refused():
    instance = scene(PLANE, array=PLANE["array"] | {"spacing_wavelengths": 50.0})
    with pytest.raises(Incompatible, match=r"the polar grid would have .* points or more, expected at most 10,000,000"):
        grid_of(instance, 0.999)
    instance = scene(LINE, array=LINE["array"] | {"spacing_wavelengths": 200.0})
    with pytest.raises(Incompatible, match="the polar grid would have"):
        grid_of(instance, 0.99)
