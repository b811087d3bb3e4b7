"""Sources are placed apart whenever there is room, and the first ones do not depend on how many follow."""

import math

import numpy as np
import pytest
from scipy.stats import kstest

from nfbench.problems.near_field.geometry import directions
from nfbench.problems.near_field.placement import place_sources

PLANE = np.array([-math.pi / 3, 1.0]), np.array([math.pi / 3, 20.0])
SPACE = np.array([-math.pi / 3, -0.5, 1.0]), np.array([math.pi / 3, 0.9, 20.0])
CIRCLE = np.array([-math.pi, 1.0]), np.array([math.pi, 2.0])


def smallest_angle(theta: np.ndarray) -> float:
    """The smallest angle between two directions [°]."""
    u = directions(theta)
    first, second = np.triu_indices(len(theta), k=1)
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(u[first] - u[second], axis=1) / 2)).min())


@pytest.mark.parametrize(
    ("box", "sources", "degrees"),
    [
        (PLANE, 8, 13.0),  # 91 of 120 degrees are needed; placed one after another, a third of the seeds find no place
        (PLANE, 9, 15.0),  # no room to spare
        (PLANE, 3, 2.0),
        (CIRCLE, 12, 30.0),  # no room to spare on the full circle
        (CIRCLE, 12, 29.0),
        (SPACE, 8, 30.0),
        (SPACE, 12, 26.0),
    ],
)
def test_a_placement_is_found_whenever_there_is_room(box, sources, degrees):
    for seed in range(60):
        theta = place_sources(np.random.default_rng(seed), *box, sources, math.radians(degrees))
        assert theta.shape == (sources, len(box[0]))
        assert ((box[0] <= theta) & (theta <= box[1])).all()
        assert smallest_angle(theta) >= degrees - 1e-9


def test_too_little_room_is_an_error_that_names_the_remedy():
    with pytest.raises(ValueError, match=r"8 sources 20° apart, found none; widen the box, or reduce"):
        place_sources(np.random.default_rng(0), *PLANE, 8, math.radians(20.0))
    with pytest.raises(ValueError, match=r"30 sources 60° apart, found none; widen the box, or reduce"):
        place_sources(np.random.default_rng(0), *SPACE, 30, math.radians(60.0))


@pytest.mark.parametrize("degrees", [0.0, 2.0, 10.0])
@pytest.mark.parametrize("box", [PLANE, SPACE])
def test_k_sources_are_the_first_k_of_more(box, degrees):
    for seed in range(20):
        more = place_sources(np.random.default_rng(seed), *box, 5, math.radians(degrees))
        for K in range(1, 5):
            fewer = place_sources(np.random.default_rng(seed), *box, K, math.radians(degrees))
            np.testing.assert_array_equal(fewer, more[:K])


def test_each_source_is_uniform_without_a_separation():
    theta = np.array([place_sources(np.random.default_rng(seed), *PLANE, 3) for seed in range(3000)])
    for k in range(3):
        for j in range(2):
            unit = (theta[:, k, j] - PLANE[0][j]) / (PLANE[1][j] - PLANE[0][j])
            assert kstest(unit, "uniform").pvalue > 0.001


def test_tight_placements_are_uniform_among_all_that_are_apart():
    """With 8 sources 13° apart, the gaps beyond 13° are those of uniform order statistics on the 29° that are left."""
    gaps = []
    for seed in range(1500):
        azimuth = np.sort(place_sources(np.random.default_rng(seed), *PLANE, 8, math.radians(14.5))[:, 0])
        gaps.append(np.degrees(azimuth[0] - PLANE[0][0]))  # of 9 equal parts of what is left: Beta(1, 8)
    assert kstest(np.array(gaps) / (120 - 7 * 14.5), "beta", args=(1, 8)).pvalue > 0.001
