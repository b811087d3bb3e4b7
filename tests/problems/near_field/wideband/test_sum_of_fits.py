"""Guards the sum of misfits over frequency bins: its value, its gradient, and the weights of the bins."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from wideband_scenes import misfit, response, scene, slopes

from nfbench.problems.near_field.objectives.conditional_fit import ConditionalFit
from nfbench.problems.near_field.objectives.factors import factor, factors, noise_weights
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.objectives.sum_of_fits import SumOfFits, together

OTHER = np.array([[0.1, 0.6]])


def parts_of(kind):
    wide = scene(3)
    box = wide.lower, wide.upper
    if kind == "rls":
        return wide, [RLS(band.Y, band.manifold, *box) for band in wide.bands], 1, np.empty((0, 2))
    if kind == "conditional":
        return wide, [ConditionalFit(band.Y, band.manifold, *box, OTHER) for band in wide.bands], 1, OTHER
    return wide, [SubspaceFit(band.Y, band.manifold, *box, sources=2) for band in wide.bands], 2, np.empty((0, 2))


@pytest.mark.parametrize("kind", ["rls", "conditional", "subspace"])
def test_value_and_gradient_are_those_of_the_plain_formula(kind):
    wide, parts, K, others = parts_of(kind)
    problem = SumOfFits(parts)

    def plain(x):
        theta = np.vstack([others, x.reshape(K, 2)])
        return sum(
            misfit(band.Y, response(band.manifold.positions, band.manifold.wavelength_m, theta)) for band in wide.bands
        )

    X = np.random.default_rng(1).uniform(problem.lower, problem.upper, (20, 2 * K))
    expected = np.array([plain(x) for x in X])
    assert_allclose(problem.evaluate(X), expected, rtol=1e-9)
    for x, value in zip(X, expected, strict=True):
        assert_allclose(problem.value(x), value, rtol=1e-9)
        J, gradient = problem.value_and_gradient(x)
        assert_allclose(J, value, rtol=1e-9)
        assert_allclose(gradient, slopes(plain, x), rtol=1e-4, atol=1e-5 * np.linalg.norm(gradient))


def test_a_part_keeps_its_own_values():
    """The sum must not be written into an array that a part returned and keeps."""
    _, parts, _, _ = parts_of("rls")
    X = np.tile([[0.2, 0.7]], (3, 1))
    before = [part.evaluate(X) for part in parts]
    SumOfFits(parts).evaluate(X)
    for part, values in zip(parts, before, strict=True):
        assert_array_equal(part.evaluate(X), values)


def test_a_single_bin_is_the_misfit_itself_and_different_boxes_are_refused():
    _, parts, _, _ = parts_of("rls")
    assert together(parts[:1]) is parts[0]
    assert isinstance(together(parts), SumOfFits)
    wide = scene(3)
    with pytest.raises(ValueError, match="parts: expected the same box"):
        SumOfFits([parts[0], RLS(wide.Y, wide.manifold, wide.lower, wide.upper * 2)])
    with pytest.raises(ValueError, match="at least one"):
        SumOfFits([])


def test_the_weights_are_the_snapshots_divided_by_the_noise():
    wide = scene(9, snapshots=400)
    Y = [wide.bands[0].Y, 3 * wide.bands[1].Y, wide.bands[2].Y[:, :100]]
    assert_allclose(noise_weights(Y, 2), [1, 1 / 9, 1 / 4], rtol=0.06)
    weighted = factors(Y, 2, "wsf")
    assert_array_equal(weighted[0], factor(Y[0], 2, "wsf"))
    assert_allclose(weighted[1], np.sqrt(noise_weights(Y, 2)[1]) * factor(Y[1], 2, "wsf"))
    for each, alone in zip(factors(Y, 2, "esf"), Y, strict=True):
        assert_array_equal(each, factor(alone, 2, "esf"))


def test_bins_without_enough_snapshots_for_their_noise_count_by_their_snapshots():
    wide = scene(9)
    assert noise_weights([wide.bands[0].Y, wide.bands[1].Y[:, :2]], 2) == [1.0, 2 / 60]
    assert noise_weights([wide.bands[0].Y, wide.bands[1].Y[:, :1]], 2) == [1.0, 1 / 60]


@pytest.mark.parametrize("objective", ["wsf", "dml"])
def test_the_minimum_does_not_depend_on_the_unit_of_the_data_of_a_bin(objective):
    """A bin whose receiver has another gain has the same SNR, and must count as before."""
    wide = scene(11)
    Y = [band.Y for band in wide.bands]
    problems = [
        SumOfFits(
            SubspaceFit(F, band.manifold, wide.lower, wide.upper, sources=2)
            for F, band in zip(factors(data, 2, objective), wide.bands, strict=True)
        )
        for data in (Y, [Y[0], 5 * Y[1], Y[2] / 7])
    ]
    X = np.random.default_rng(2).uniform(problems[0].lower, problems[0].upper, (10, 4))
    assert_allclose(*(problem.evaluate(X) for problem in problems), rtol=1e-9)
