"""The facts about a landscape are those of functions whose minima, basins and curvature are known."""

import math

import numpy as np
import pytest

from nfbench import Problem
from nfbench.analysis import find_minima, landscape_facts
from nfbench.analysis.landscape import chao1, condition


class Given(Problem):
    """A function of a point on the box [lower, upper], with a gradient if one is given."""

    def __init__(self, value, lower, upper, gradient=None):
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        self._value, self._gradient = value, gradient
        self.has_gradient = gradient is not None

    def evaluate(self, X):
        return np.array([self._value(x) for x in X], dtype=float)

    def value_and_gradient(self, x):
        return float(self._value(x)), np.asarray(self._gradient(x), dtype=float)


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    "gradient", [None, lambda x: 2 * np.array([9.0, 1.0]) * (x - 0.2)], ids=["values", "gradients"]
)
def test_a_bowl_has_one_minimum_and_its_condition(gradient):
    bowl = Given(lambda x: 9 * (x[0] - 0.2) ** 2 + (x[1] - 0.2) ** 2, [-1, -1], [1, 1], gradient)
    facts = landscape_facts(bowl, 30, rng())
    assert facts["minima"] == facts["minima_values"] == facts["minima_chao1"] == 1
    assert facts["global_share"] == facts["global_share_high"] == 1 and 0.85 < facts["global_share_low"] < 1
    assert facts["condition"] == pytest.approx(9, rel=1e-4) and facts["best"] == pytest.approx(0, abs=1e-9)
    assert facts["fdc"] > 0.7 and facts["dimension"] == 2


def test_the_condition_is_measured_in_widths_of_the_box():
    bowl = Given(lambda x: x[0] ** 2 + x[1] ** 2, [-1, -10], [1, 10], lambda x: 2 * x)
    assert condition(bowl, np.zeros(2)) == pytest.approx(100, rel=1e-6)


def test_two_equal_valleys_are_both_global_and_the_shares_of_basins_are_their_widths():
    # the crest at 0.5 divides [-2, 2] into 62.5 % and 37.5 %
    def value(x):
        return min((x[0] + 1) ** 2, 4 * (x[0] - 1.25) ** 2) + 0.0

    def slope(x):
        return [2 * (x[0] + 1)] if (x[0] + 1) ** 2 < 4 * (x[0] - 1.25) ** 2 else [8 * (x[0] - 1.25)]

    found = find_minima(Given(value, [-2], [2], slope), 200, rng(1))
    assert sorted(found.places.ravel()) == pytest.approx([-1, 1.25], abs=1e-3)
    assert found.best.all() and found.counts.sum() == 200 and found.counts.min() > 40
    facts = landscape_facts(Given(value, [-2], [2], slope), 200, rng(1))
    assert (facts["minima"], facts["minima_values"], facts["global_share"]) == (2, 1, 1.0)


def test_the_minima_of_a_wave_are_counted():
    wave = Given(lambda x: -math.cos(2 * math.pi * x[0]) + 0.1 * x[0] ** 2, [-2.4, ], [2.4, ],
                 lambda x: [2 * math.pi * math.sin(2 * math.pi * x[0]) + 0.2 * x[0]])  # fmt: skip
    facts = landscape_facts(wave, 300, rng(2))
    assert facts["minima"] == 5 and facts["minima_values"] == 3 and facts["minima_chao1"] == 5


def test_minima_on_a_face_count_and_their_coordinate_has_no_curvature():
    slope = Given(lambda x: x[0] + (x[1] - 0.5) ** 2, [0, 0], [1, 1], lambda x: [1.0, 2 * (x[1] - 0.5)])
    facts = landscape_facts(slope, 20, rng())
    assert facts["minima"] == 1 and facts["condition"] == pytest.approx(1)
    corner = Given(lambda x: x[0] + x[1], [0, 0], [1, 1], lambda x: [1.0, 1.0])
    assert math.isnan(landscape_facts(corner, 20, rng())["condition"])


def test_a_minimum_that_only_the_known_point_leads_to_has_a_share_of_0_and_is_not_counted():
    def value(x):
        return x[0] ** 2 - 5 * math.exp(-(((x[0] - 0.7) / 1e-3) ** 2))

    def gradient(x):
        return [2 * x[0] + 10 * (x[0] - 0.7) / 1e-6 * math.exp(-(((x[0] - 0.7) / 1e-3) ** 2))]

    needle = Given(value, [-1], [1], gradient)
    facts = landscape_facts(needle, 20, rng(3), known=np.array([[0.7]]))
    assert (
        facts["best"] == pytest.approx(0.49 - 5, abs=1e-3) and facts["global_share"] == facts["global_share_low"] == 0
    )
    assert facts["minima"] == 1
    assert landscape_facts(needle, 20, rng(3))["global_share"] == 1


def test_the_fitness_distance_correlation_is_negative_where_values_mislead():
    def value(x):  # the basin at 0 is narrow, and elsewhere the values fall away from it
        return -3.0 + 300 * abs(x[0]) if abs(x[0]) < 0.01 else 1.0 - abs(x[0])

    facts = landscape_facts(Given(value, [-1], [1]), 60, rng(4), known=np.array([[0.0]]))
    assert facts["best"] == pytest.approx(-3, abs=1e-2) and facts["fdc"] < -0.2


@pytest.mark.parametrize(
    ("counts", "expected"), [([4, 1, 1, 2, 0], 4 + 2 / 4), ([1, 1, 1], 3 + 3), ([5, 5], 2), ([2, 2, 1], 3)]
)
def test_chao1(counts, expected):
    assert chao1(np.array(counts)) == expected  # S + f1·(f1 − 1)/(2·(f2 + 1)), Chao 1984


def test_a_multistart_depends_on_its_generator_only():
    bowl = Given(lambda x: math.sin(9 * x[0]) + x[0] ** 2, [-2], [2])
    first, second, other = (landscape_facts(bowl, 20, rng(seed)) for seed in (5, 5, 6))
    assert first == second and first["fdc"] != other["fdc"]
